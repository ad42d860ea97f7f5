"""What the pages behind README count and list is what there is."""

import json
import re
from pathlib import Path

import pytest

from canhaptic.cli.main import COMMANDS, main
from canhaptic.control.environments import ENVIRONMENTS
from canhaptic.control.passivity import ALGORITHMS
from tests.docs.documents import ROOT, blocks

DOCS = ROOT / "docs"
NUMBERS = {9: "nine", 13: "Thirteen"}


def page(name: str) -> str:
    """The text of a page of the documentation."""
    return (DOCS / name).read_text(encoding="utf-8")


def test_the_readme_is_one_look_and_shows_for_whom_how_and_what() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    assert len(text.splitlines()) <= 70
    for word in ("build haptic devices", "CiA 402", "pip install", "canhaptic run", "rig.svg", "check-eds"):
        assert word in text
    python = next(block.text for block in blocks(ROOT / "README.md") if block.language == "python")
    assert len(python.split("\n")) <= 7
    assert len(re.findall(r"(?<!!)\[[^\]]*\]\(", text)) <= 5


def test_every_command_has_a_row() -> None:
    rows = re.findall(r"^\| `canhaptic ([\w-]+)", page("commands.md"), re.MULTILINE)
    assert sorted(set(rows)) == sorted(COMMANDS)


def test_the_algorithms_and_environments_are_counted_and_the_algorithms_named() -> None:
    text = " ".join((ROOT / "README.md").read_text(encoding="utf-8").split())
    assert f"{NUMBERS[len(ALGORITHMS)]} algorithms render {NUMBERS[len(ENVIRONMENTS)]} environments" in text
    assert set(ALGORITHMS) <= set(re.findall(r"`(\w+)`", page("algorithms.md")))


def test_the_runs_of_the_passivity_sweep_are_those_of_its_rows() -> None:
    rows = json.loads((ROOT / "docs" / "results" / "passivity_sweep.json").read_text(encoding="utf-8"))["rows"]
    least = [row for row in rows if row["row"].endswith("least true sum(h_i)")]
    runs = sum(int(re.findall(r"(\d+) runs", row["row"])[0]) for row in least)
    assert f"`guarded`, {runs} runs of walls" in page("figures.md")
    assert {row["value"] for row in least} == {0.0}  # "the same at every rate"


def test_the_attack_gets_nothing_where_all_is_declared() -> None:
    rows = json.loads((ROOT / "docs" / "results" / "attack.json").read_text(encoding="utf-8"))["rows"]
    declared = [row for row in rows if row["row"].endswith(": declared")]
    assert len(declared) > 8
    assert min(row["value"] for row in declared) > -1e-15  # [J], the last digit of a sum of joules


def test_one_claim_of_all_is_not_seen() -> None:
    rows = json.loads((ROOT / "docs" / "results" / "claims.json").read_text(encoding="utf-8"))["rows"]
    assert [row["row"] for row in rows if not row["met"]] == [
        "passivity_observer: wins back what it observes, energy short at the end"
    ]


def test_the_tutorial_shows_the_verdict_of_a_check_as_it_is(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = tmp_path / "twin.yaml"
    assert main(["new", str(ROOT / "eds" / "cia402_servo.eds"), "--simulate", "--out", str(scene)]) == 0
    capsys.readouterr()
    assert main(["check", str(scene)]) == 0
    words = " ".join(capsys.readouterr().out.split())
    shown = next(line for line in page("tutorials/your_own_drive.md").splitlines() if line.startswith("Simulation: "))
    assert words.startswith(shown)


def test_the_scripts_are_counted() -> None:
    scripts = len(list((ROOT / "examples").glob("*.py")))
    assert scripts == 14
    assert "Fourteen scripts by task" in page("from_python.md")
