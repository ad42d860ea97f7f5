"""What the pages behind README count and list is what there is."""

import json
import re

from canhaptic.cli.main import COMMANDS
from canhaptic.control.environments import ENVIRONMENTS
from canhaptic.control.passivity import ALGORITHMS
from canhaptic.sim.bus.faulty_bus import BusEffects
from tests.docs.documents import ROOT

DOCS = ROOT / "docs"
NUMBERS = {9: "nine", 13: "Thirteen"}
OF_FAULTS = {"drop_burst", "reorder_delay", "direction", "ids", "during", "foreign_ids", "bring_up", "buses"}
"""Keys of `simulation.bus` that say which frames a fault meets, when and how."""


def page(name: str) -> str:
    """The text of a page of the documentation."""
    return (DOCS / name).read_text(encoding="utf-8")


def test_the_readme_is_one_look_and_names_user_hardware_and_result_first() -> None:
    lines = (ROOT / "README.md").read_text(encoding="utf-8").splitlines()
    assert len(lines) <= 85
    first = "\n".join(lines[:25])
    for word in ("build haptic devices", "CiA 402", "touch.gif", "make demo", "canhaptic touch"):
        assert word in first


def test_every_command_has_a_row() -> None:
    rows = re.findall(r"^\| `canhaptic ([\w-]+)", page("commands.md"), re.MULTILINE)
    assert sorted(rows) == sorted(COMMANDS)


def test_the_algorithms_and_environments_are_counted_and_named() -> None:
    first, _, _ = page("rendered.md").partition("\n\nAxes may")
    counted = f"{NUMBERS[len(ALGORITHMS)]} algorithms render any of {NUMBERS[len(ENVIRONMENTS)]} environments"
    assert counted in first
    assert set(ALGORITHMS) <= set(re.findall(r"`(\w+)`", first))


def test_the_faults_of_a_bus_are_those_of_the_model() -> None:
    listed = page("simulated.md").split("`simulation.bus`:")[1].split("seeded")[0]
    assert set(re.findall(r"`(\w+)`", listed)) == set(BusEffects.model_fields) - OF_FAULTS


def test_the_runs_of_the_passivity_sweep_are_those_of_its_rows() -> None:
    rows = json.loads((ROOT / "docs" / "results" / "passivity_sweep.json").read_text(encoding="utf-8"))["rows"]
    least = [row for row in rows if row["row"].endswith("least true sum(h_i)")]
    runs = sum(int(re.findall(r"(\d+) runs", row["row"])[0]) for row in least)
    assert f"`guarded`, {runs} runs of walls" in page("figures.md")
    assert {row["value"] for row in least} == {0.0}  # "the same at every rate"
