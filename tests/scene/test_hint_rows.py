"""Every row of `check` has the unit of its quantity, and says so when the scene requests more than its limit."""

from pathlib import Path

import pytest

from canhaptic.axis_units import damping_unit, stiffness_unit
from canhaptic.cli.main import main
from canhaptic.scene.hints import hints_of
from canhaptic.scene.load import load_scene
from tests.docs.documents import ROOT

SCENES = sorted((ROOT / "configs").rglob("*.yaml"))


FAST = ("demo", "rotary_knob", "stiff_wall")


@pytest.mark.parametrize(
    "path",
    [p if p.stem in FAST else pytest.param(p, marks=pytest.mark.slow) for p in SCENES],
    ids=lambda path: path.stem,
)
def test_a_value_to_compare_with_is_of_the_unit_of_its_limit(path: Path) -> None:
    try:
        scene = load_scene(path)
    except Exception:
        pytest.skip("no scene by itself")
    for axis in scene.axes:
        parameters, unit = axis.environment.parameters, axis.parameters.unit
        requested = {
            stiffness_unit(unit): getattr(parameters, "stiffness", None),
            damping_unit(unit): getattr(parameters, "damping", None),
        }
        for hint in hints_of(scene):
            if hint.axis == axis.parameters.name and hint.asked is not None and not axis.group:
                assert hint.asked == requested.get(hint.unit, hint.asked), hint.what


@pytest.mark.parametrize("what", ["stiffest wall held at a push", "stiffness, certified by hand force"])
def test_a_wall_stiffer_than_what_is_held_exceeds_a_limit_of_stiffness(what: str) -> None:
    declared = ["passivity.moving_mass=0.05", "passivity.hand_force=0", "environment.stiffness=10000"]
    hints = [hint for hint in hints_of(load_scene("demo", declared)) if hint.what.startswith(what)]
    assert [(hint.unit, hint.asked, hint.exceeded) for hint in hints] == [("N/m", 10000.0, True)]
    assert hints[0].limit == pytest.approx(0.05 / 6.0e-6)  # m / 6 T^2, with one hold of delay


def test_check_names_the_limit_that_is_exceeded(capsys: pytest.CaptureFixture[str]) -> None:
    main(["check", "demo", "--set", "passivity.moving_mass=0.05", "--set", "environment.stiffness=10000"])
    shown = capsys.readouterr().out
    assert "exceeds no limit" not in shown
    assert "stiffest wall held at a push of 5 N" in shown
