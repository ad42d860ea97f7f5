"""`canhaptic design` of admittance displays: the lightest mass that every hand feels as asked."""

import json
from pathlib import Path

import pytest

from canhaptic.cli.main import main
from canhaptic.errors import CheckFailedError
from canhaptic.lab.batch.scalar import run_scalar
from canhaptic.lab.studies.design import search
from canhaptic.lab.studies.design.search import design_masses
from canhaptic.scene.load import load_scene

SCENES = Path(__file__).parents[3] / "configs" / "admittance"
NODE = SCENES / "force_node.yaml"


@pytest.mark.slow
def test_the_mass_is_felt_as_asked_and_a_lighter_one_is_not(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(search, "_MASSES", (9, 3))
    monkeypatch.setattr(search, "_MASS_DURATION", 1.0)
    assert main(["design", str(NODE), "--margin", "0", "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    found = result["displays"]["handle"]
    low, high = found["mass_felt.share"]
    assert 0.95 <= low <= high <= 1.05
    assert found["least_interaction"] >= -1e-3
    assert found["mass"] < 1.1 * found["never_acts"]
    assert f"mass: {found['mass']:g} kg" in result["yaml"]["handle"]
    lighter = load_scene(NODE, [f"environment.mass={0.5 * found['mass']} kg"])
    assert run_scalar(lighter, 1000, ["mass_felt.share"])["mass_felt.share"] > 1.05


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "overrides", "status", "words"),
    [
        ("cup_and_ball", [], 2, "expected virtual_mass to design for"),
        ("guided_path", [], 2, "expected virtual_mass to design for"),
        ("force_node", ["simulation.user=null"], 2, "no hand"),
        ("force_node", ["axes.0.speed_limit=0.02 m/s"], 1, "no mass is felt as asked"),
    ],
)
def test_what_cannot_be_designed_for_is_refused_in_words(
    name: str, overrides: list[str], status: int, words: str, capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.setattr(search, "_MASSES", (2,))
    monkeypatch.setattr(search, "_MASS_DURATION", 0.3)
    changes = [word for override in overrides for word in ("--set", override)]
    assert main(["design", str(SCENES / f"{name}.yaml"), *changes]) == status
    assert words in capsys.readouterr().err


def test_masses_that_no_run_is_long_enough_to_feel_are_refused_in_words(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(search, "_MASSES", (2,))
    monkeypatch.setattr(search, "_MASS_DURATION", 0.02)
    with pytest.raises(CheckFailedError, match="no mass is felt as asked by every hand"):
        design_masses(load_scene(NODE), 0.0, 0.3)


@pytest.mark.slow
def test_progress_counts_up_to_what_is_said_at_most(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(search, "_MASSES", (3,))
    monkeypatch.setattr(search, "_MASS_DURATION", 0.5)
    seen: list[tuple[int, int]] = []
    design_masses(load_scene(NODE), 0.0, 0.3, lambda tried, most: seen.append((tried, most)))
    tried = [count for count, _ in seen]
    assert tried == sorted(tried)
    assert tried[0] < tried[-1] <= 4
    assert {most for _, most in seen} == {4}
