"""Every row of `check` has the unit of its key, and says so when the scene requests more than its limit."""

from dataclasses import replace
from math import isfinite
from pathlib import Path
from typing import get_type_hints

import pytest

from canhaptic.axis_units import damping_unit, stiffness_unit
from canhaptic.cli.check import _hint_table
from canhaptic.cli.main import main
from canhaptic.control.environments import ENVIRONMENTS
from canhaptic.control.passivity import LoopProperties
from canhaptic.errors import InputError
from canhaptic.quantities import LIMITS
from canhaptic.registry import load
from canhaptic.scene.hints import Hint, hints_of
from canhaptic.scene.load import load_scene
from canhaptic.scene.models import Scene
from canhaptic.units import Quantity, parts_of
from tests.docs.documents import ROOT

SCENES = sorted((ROOT / "configs").rglob("*.yaml"))
FAST = ("demo", "rotary_knob", "stiff_wall")
scenes = pytest.mark.parametrize(
    "path",
    [p if p.stem in FAST else pytest.param(p, marks=pytest.mark.slow) for p in SCENES],
    ids=lambda path: path.stem,
)


def scene_in(path: Path) -> Scene:
    try:
        return load_scene(path)
    except InputError:
        pytest.skip("no scene by itself")


def requesting(scene: Scene, hint: Hint, value: float) -> Scene:
    """The scene with another value of the key that a limit is compared with."""
    section, _, name = LIMITS[hint.quantity].key.partition(".")
    axes, groups = list(scene.axes), list(scene.groups)
    place = next(place for place, axis in enumerate(axes) if axis.parameters.name == hint.axis)
    group = next((of for of in groups if of.name == axes[place].group), None)
    if section == "passivity":
        axes[place] = replace(axes[place], loop=axes[place].loop.model_copy(update={name: value}))
    elif group is None:
        part = axes[place].environment
        changed = part._replace(parameters=part.parameters.model_copy(update={name: value}))
        axes[place] = replace(axes[place], environment=changed)
    else:
        part = group.network
        changed = part._replace(parameters=part.parameters.model_copy(update={name: value}))
        groups[groups.index(group)] = replace(group, network=changed)
    return replace(scene, axes=tuple(axes), groups=tuple(groups))


@pytest.mark.parametrize("name", [name for name, limit in LIMITS.items() if limit.key])
def test_a_limit_has_the_unit_of_the_key_that_it_is_compared_with(name: str) -> None:
    section, _, key = LIMITS[name].key.partition(".")
    models = (
        [LoopProperties] if section == "passivity" else [load(ENVIRONMENTS, of, "environment") for of in ENVIRONMENTS]
    )
    hints = [get_type_hints(model, include_extras=True).get(key) for model in models]
    units = {
        (part.unit.linear, part.unit.rotary) for hint in hints for part in parts_of(hint) if isinstance(part, Quantity)
    }
    assert units
    assert units == {(LIMITS[name].unit_on("m"), LIMITS[name].unit_on("rad"))}


@scenes
def test_each_limit_of_a_scene_is_seen_to_be_exceeded_in_turn(path: Path) -> None:
    scene = scene_in(path)
    for hint in hints_of(scene):
        unit = scene.axis(hint.axis).parameters.unit
        assert hint.unit == LIMITS[hint.quantity].unit_on(unit)
        if hint.requested is None or hint.limit is None or not isfinite(hint.limit):
            continue
        assert hint.unit in (stiffness_unit(unit), damping_unit(unit), "1")
        raised = hints_of(requesting(scene, hint, 1.1 * hint.limit + 1e-3))
        [found] = [of for of in raised if (of.axis, of.what) == (hint.axis, hint.what)]
        assert found.requested == 1.1 * hint.limit + 1e-3
        assert found.exceeded
        shown = str(_hint_table([found], 1, texts=False).rows[0][3])
        assert ("EXCEEDED" if found.concerns else "exceeded") in shown
        lowered = hints_of(requesting(scene, hint, 0.0))
        assert not any(of.exceeded for of in lowered if (of.axis, of.what) == (hint.axis, hint.what))


@pytest.mark.parametrize(("quantity", "certificate"), [("stiffness_held", ""), ("stiffness_certified", "hand force")])
def test_a_wall_stiffer_than_what_is_held_exceeds_a_limit_of_stiffness(quantity: str, certificate: str) -> None:
    declared = ["passivity.moving_mass=0.05", "passivity.hand_force=0", "environment.stiffness=10000"]
    found = hints_of(load_scene("demo", declared))
    hints = [hint for hint in found if (hint.quantity, hint.certificate) == (quantity, certificate)]
    assert [(hint.unit, hint.requested, hint.exceeded) for hint in hints] == [("N/m", 10000.0, True)]
    assert hints[0].limit == pytest.approx(0.05 / 6.0e-6)  # m / 6 T^2, with one hold of delay


def test_check_names_the_limit_that_is_exceeded(capsys: pytest.CaptureFixture[str]) -> None:
    main(["check", "demo", "--set", "passivity.moving_mass=0.05", "--set", "environment.stiffness=10000"])
    shown = capsys.readouterr().out
    assert "exceeds no limit" not in shown
    assert "stiffest wall held at a push of 5 N" in shown
