"""What a scene says of its admittance displays: the properties of each, the mass to feel, and every refusal."""

from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any, cast

import pytest

from canhaptic.control.admittance.port import AdmittanceProperties
from canhaptic.control.motion_checks import MassAsked, MassFelt
from canhaptic.errors import InputError, ParameterError
from canhaptic.lab.loop.axis_loop import require_single_axes
from canhaptic.scene.displays import (
    display_faults,
    display_properties,
    mass_felt,
)
from canhaptic.scene.load import load_scene
from canhaptic.scene.models import AxisScene, Scene
from canhaptic.scene.parts import controller_of

CONFIGS = Path(__file__).resolve().parents[2] / "configs"


@lru_cache
def loaded(name: str) -> Scene:
    return load_scene(CONFIGS / name)


def display(of: dict[str, Any] | None = None, **axis: Any) -> AxisScene:
    """The axis of `virtual_mass.yaml` with other values of its display, or of itself; None takes one out."""
    [plain] = loaded("admittance/virtual_mass.yaml").axes
    given = plain.parameters
    assert given.admittance is not None
    changed = given.admittance.model_copy(update=of or {})
    values = {name: getattr(given, name) for name in given.model_fields_set} | {"admittance": changed} | axis
    parameters = type(given).model_construct(**{k: v for k, v in values.items() if v is not None or k == "admittance"})
    return replace(plain, parameters=parameters)


def test_the_properties_of_a_display_are_those_of_its_axis() -> None:
    found = display_properties(display({"velocity_counts": 2e5}))
    assert found == AdmittanceProperties(
        sample_time=1e-3, jitter=0.0, delay=1, sampling="point", latency=0, filter=0.0, force_slew=5e3,
        handle_acceleration=80.0, force_error=0.05, encoder_count=1e-6, speed_quantum=5e-6, speed_limit=1.0,
        acceleration_limit=50.0, torque_limit=200.0, position_low=-0.2, position_high=0.2,
    )  # fmt: skip
    assert display_properties(display()).speed_quantum == pytest.approx(1e-6)
    assert display_properties(display({"mode": "position"})).speed_quantum == pytest.approx(1e-3)  # a count per hold


def test_a_display_without_limits_of_its_position_has_room_everywhere() -> None:
    found = display_properties(display({"position_low": None, "position_high": None}))
    assert (found.position_low, found.position_high) == (-1e9, 1e9)
    below = display_properties(display({"position_high": None}))
    assert (below.position_low, below.position_high) == (-0.2, 1e9)


@pytest.mark.parametrize(
    ("of", "axis", "words"),
    [
        ({"acceleration_limit": None}, {}, "handle: admittance.acceleration_limit: missing"),
        ({}, {"speed_limit": None}, "handle: speed_limit: missing"),
        ({"acceleration_limit": None}, {"speed_limit": None}, "handle: admittance.acceleration_limit, speed_limit: m"),
        ({}, {"admittance": None}, "handle: has no `admittance`"),
    ],
)
def test_a_display_without_its_limits_is_refused(of: dict[str, Any], axis: dict[str, Any], words: str) -> None:
    with pytest.raises(ParameterError, match=words):
        display_properties(display(of, **axis))


def felt_on(axis: AxisScene) -> MassFelt | None:
    return mass_felt(axis, replace(loaded("admittance/virtual_mass.yaml"), axes=(axis,)).ports[0])


def test_the_mass_to_feel_has_room_between_the_nearest_of_walls_and_limits() -> None:
    felt = felt_on(display())
    assert felt is not None
    assert felt.asked == MassAsked(mass=3.0, stiffness=0.0, low=-0.1, high=0.2, sample_time=1e-3, count=1e-6)
    near = felt_on(display({"position_low": -0.05, "position_high": 0.01}))
    assert near is not None
    assert (near.asked.low, near.asked.high) == (-0.05, 0.01)


def test_no_mass_is_felt_along_an_axis_that_renders_none() -> None:
    ball = loaded("admittance/cup_and_ball.yaml")
    assert mass_felt(ball.axes[0], ball.ports[0]) is None
    path, arm = loaded("admittance/guided_path.yaml"), loaded("admittance/two_link_arm.yaml")
    assert mass_felt(path.axes[0], path.ports[0]) is None  # a path, though along the axes
    assert mass_felt(arm.axes[0], arm.ports[0]) is None  # a mass, though not along the axes
    straight = arm.ports[0]._replace(kinematics=path.ports[0].kinematics)
    felt = [mass_felt(axis, straight) for axis in arm.axes]
    network: Any = arm.groups[0].network.parameters
    assert [each.asked.mass for each in felt if each is not None] == [network.mass] * 2


def faults(axis: AxisScene, *, rpdo: str = "synchronous", is_real: bool = False) -> list[tuple[str, str]]:
    bus = loaded("admittance/virtual_mass.yaml").bus.model_copy(update={"rpdo": rpdo})
    return list(display_faults(axis, bus, is_real=is_real))


def test_a_simulated_display_has_no_fault_and_each_that_is_made_is_named() -> None:
    plain = display()
    assert faults(plain) == []
    assert [key for key, _ in faults(display(admittance=None))] == [""]
    [(key, text)] = faults(plain, rpdo="event")
    assert (key, "rpdo: event" in text) == ("admittance", True)
    [(_, text)] = faults(replace(plain, simulated_drive=cast(Any, object())))
    assert "moves a simulated mechanism" in text
    assert plain.simulation is not None
    [(_, text)] = faults(replace(plain, simulation=replace(plain.simulation, admittance=None)))
    assert "simulation.admittance is missing" in text
    assert faults(replace(plain, simulation=None)) == []


REAL = {"position_low": -0.2, "position_high": 0.2, "acceleration_limit": 50.0}


def real(of: dict[str, Any] | None = None, **axis: Any) -> AxisScene:
    """A display that may move on a real interface, with changes."""
    plain = display().parameters.admittance
    assert plain is not None
    force = plain.force.model_copy(update={"frozen_after": 50})
    return replace(display({"force": force, **(of or {})}, **axis), simulation=None)


@pytest.mark.parametrize(
    ("of", "axis", "names"),
    [
        ({}, {}, ""),
        ({"position_low": None}, {}, "admittance.position_low"),
        ({"position_high": None, "acceleration_limit": None}, {}, "admittance.position_high, admittance.acc"),
        ({}, {"speed_limit": None}, "speed_limit"),
        ({}, {"watchdog": False}, "watchdog: true"),
    ],
)
def test_what_a_real_display_needs_is_named_where_it_is_missing(of: dict[str, Any], axis: dict[str, Any], names: str):
    found = faults(real(of, **axis), is_real=True)
    if not names:
        assert found == []
        return
    [(key, text)] = found
    assert key == "admittance"
    assert text.startswith(names)
    assert text.endswith("an admittance display on a real interface does not move without, add it")
    assert faults(real(of, **axis), is_real=False) == []


def test_a_sensor_of_a_real_display_must_be_able_to_count_as_frozen() -> None:
    [(_, text)] = faults(replace(display(), simulation=None), is_real=True)
    assert text.startswith("admittance.force.frozen_after: missing")


def test_a_command_for_torque_axes_names_a_port_that_is_none() -> None:
    require_single_axes(loaded("demo.yaml"), "arena")
    for name, port in (("admittance/two_axes.yaml", "x"), ("xy_box.yaml", "stage")):
        with pytest.raises(InputError, match=f"{port}: is no torque axis by itself; arena judges"):
            require_single_axes(loaded(name), "arena")


def test_a_group_is_of_one_kind() -> None:
    scene = loaded("admittance/guided_path.yaml")
    assert controller_of(scene, scene.ports[0]) is not None
    last = scene.axes[1]
    other = replace(last, parameters=last.parameters.model_copy(update={"admittance": None}))
    with pytest.raises(ParameterError, match="'stage' renders on x, an admittance display, and on y; expected axes"):
        controller_of(scene, replace(scene, axes=(scene.axes[0], other)).ports[0])
