"""What README counts and lists is what there is."""

import json
import re

from canhaptic.cli.main import _COMMANDS
from canhaptic.control.environments import ENVIRONMENTS
from canhaptic.control.passivity import ALGORITHMS
from canhaptic.sim.bus.bus_effects import BusEffects
from tests.docs.documents import ROOT

README = (ROOT / "README.md").read_text(encoding="utf-8")
NUMBERS = {9: "nine", 13: "Thirteen"}


def section(title: str) -> str:
    """The text below a heading, to the next of its kind."""
    return README.split(f"\n## {title}\n")[1].split("\n## ")[0]


def test_every_command_has_a_row() -> None:
    rows = re.findall(r"^\| `canhaptic ([\w-]+)", section("Commands"), re.MULTILINE)
    assert sorted(rows) == sorted(_COMMANDS)


def test_the_algorithms_and_environments_are_counted_and_named() -> None:
    first, _, _ = section("What it renders").partition("\n\nAxes may")
    counted = f"{NUMBERS[len(ALGORITHMS)]} algorithms render any of {NUMBERS[len(ENVIRONMENTS)]} environments"
    assert counted in first
    assert set(ALGORITHMS) <= set(re.findall(r"`(\w+)`", first))


def test_the_faults_of_a_bus_are_those_of_the_model() -> None:
    listed = section("What is simulated").split("`simulation.bus`:")[1].split("seeded")[0]
    assert set(re.findall(r"`(\w+)`", listed)) <= set(BusEffects.model_fields)


def test_the_runs_of_the_passivity_sweep_are_those_of_its_rows() -> None:
    rows = json.loads((ROOT / "docs" / "results" / "passivity_sweep.json").read_text(encoding="utf-8"))["rows"]
    least = [row for row in rows if row["row"].endswith("least true sum(h_i)")]
    runs = sum(int(re.findall(r"(\d+) runs", row["row"])[0]) for row in least)
    assert f"`guarded`, {runs} runs of walls" in README
    assert {row["value"] for row in least} == {0.0}  # "the same at every rate"
