"""Force against motion: what may be true passes, and what cannot be true does not."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from canhaptic.control.admittance.momentum_check import Disagreement, MomentumCheck, MovedHold, momentum_check
from canhaptic.control.admittance.port import AdmittanceProperties
from canhaptic.control.admittance.velocity_loop import GuardedAdmittanceParameters, loop_settings
from canhaptic.errors import ForceContradictedError
from tools.displays.direct import run
from tools.displays.random_display import random_display, with_true_bounds

TIME, MASS, GAIN, SPREAD = 1e-3, 2.0, 600.0, 0.1
PROPERTIES = AdmittanceProperties(
    sample_time=TIME, sampling="mean", force_slew=5e3, handle_acceleration=20.0, force_error=0.05, encoder_count=1e-6,
    speed_limit=1.0, acceleration_limit=50.0, torque_limit=200.0,
)  # fmt: skip
DECLARED = GuardedAdmittanceParameters(
    drive_mass=MASS, loop_gain=GAIN, spread=SPREAD, drive_friction=0.5, drive_damping=3.0
)


def check_of(**changes: Any) -> MomentumCheck:
    declared = DECLARED.model_copy(
        update={k: v for k, v in changes.items() if k in GuardedAdmittanceParameters.model_fields}
    )
    known = PROPERTIES.model_copy(update={k: v for k, v in changes.items() if k in AdmittanceProperties.model_fields})
    found = momentum_check(declared, known, loop_settings(declared, known))
    assert found is not None
    return found


def first_found(
    check: MomentumCheck, force: Callable[[float], float], velocity: Callable[[float], float],
    command: Callable[[float], float], holds: int = 200,
) -> Disagreement | None:  # fmt: skip
    """The first disagreement of a motion, its force known as the mean over each hold."""
    check.begin(0.0, force(0.0), 0.0)
    lead = 0.0
    for k in range(holds):
        parts = (np.arange(16) + 0.5) / 16.0 * TIME + k * TIME
        moved = TIME * float(np.mean([velocity(t) for t in parts]))
        asked = command(k * TIME)
        lead += asked * TIME - moved
        shown = float(np.mean([force(t) for t in parts]))
        found = check.take(MovedHold(moved, asked, 0.0, lead), shown)
        if found is not None:
            return found
    return None


def always(value: float) -> Callable[[float], float]:
    return lambda _time: value


def line(begin: float, slope: float) -> Callable[[float], float]:
    return lambda time: begin + slope * time


def at_rest(_time: float) -> float:
    return 0.0


def test_at_rest_no_more_than_what_is_declared_passes() -> None:
    half = 0.03
    turned = TIME**2 / (6.0 * half)
    most = 0.05 + 5e3 * turned + 0.5 + 3.0 * 0.25 * 20.0 * TIME
    most += GAIN * (20.0 * turned + 1e-6 / half) + 2.0 * MASS * 1e-6 / half**2
    for sign in (1.0, -1.0):
        assert first_found(check_of(), always(0.999 * sign * most), at_rest, at_rest) is None
        found = first_found(check_of(), always(1.001 * sign * most), at_rest, at_rest)
        assert found is not None
        assert (found.low, found.high) == pytest.approx((-most, most))
        assert found.over == pytest.approx(2.0 * half)
        assert "between" in found.text()
    jitter = 0.02
    loose = check_of(jitter=jitter)
    assert first_found(loose, always(most + 0.9 * jitter * TIME / half * 2.0 * most), at_rest, at_rest) is None
    assert first_found(check_of(jitter=jitter), always(1.01 * most), at_rest, at_rest) is not None


@pytest.mark.parametrize("part", [-1.0, 1.0])
def test_an_accelerated_mass_and_a_yielding_loop_explain_their_force(part: float) -> None:
    """A drive that yields by a slip under a force, while it is accelerated: mass and gain anywhere in their range."""
    slow, pull = 0.02, 3.0  # slip [m/s], acceleration [m/s^2]
    for mass in (MASS, MASS * (1.0 - SPREAD)):
        for gain in (GAIN, GAIN * (1.0 - SPREAD)):
            right = part * (mass * pull + gain * slow)
            motion = line(part * slow, part * pull), line(0.5 * part * pull * TIME, part * pull)
            assert first_found(check_of(), always(right), *motion, holds=120) is None
            assert first_found(check_of(), always(right + 6.0), *motion, holds=120) is not None
            assert first_found(check_of(), always(right - 6.0), *motion, holds=120) is not None


def test_an_integral_that_holds_explains_a_force_at_rest() -> None:
    check, integral = check_of(integral_gain=6e3), 6e3
    check.begin(0.0, 0.0, 0.0)
    for _ in range(90):  # 12 N held at rest by a lead of -2 mm
        assert check.take(MovedHold(0.0, 0.0, 0.0, -12.0 / integral), 12.0) is None
    assert any(check.take(MovedHold(0.0, 0.0, 0.0, -12.0 / integral), 16.0) for _ in range(90))


def test_a_force_that_comes_late_is_compared_with_its_own_hold() -> None:
    late, begin = check_of(latency=3, drive_mass=1e-3), 0.045

    def force(time: float) -> float:
        return 30.0 if time > begin else 0.0

    def velocity(time: float) -> float:
        return 30.0 / GAIN if time > begin else 0.0

    assert first_found(late, lambda t: force(t - 3.0 * TIME), velocity, at_rest) is None
    far = check_of(drive_mass=1e-3)
    assert first_found(far, lambda t: force(t - 12.0 * TIME), velocity, at_rest) is not None


def test_nothing_is_said_where_the_torque_may_be_at_its_limit_or_a_command_was_lost() -> None:
    fast = 0.4  # 240 N of a loop that gives 200 N
    assert first_found(check_of(), always(30.0), at_rest, always(fast)) is None
    assert first_found(check_of(torque_limit=1e4), always(30.0), at_rest, always(fast)) is not None
    check = check_of()
    check.begin(0.0, 0.0, 0.0)
    assert not any(check.take(MovedHold(0.0, 0.0, 0.02, 0.0), 11.0) for _ in range(100))
    assert any(check.take(MovedHold(0.0, 0.0, 0.0, 0.0), 11.0) for _ in range(100))


def test_without_a_declared_friction_nothing_is_compared() -> None:
    loop = loop_settings(DECLARED, PROPERTIES)
    assert momentum_check(DECLARED.model_copy(update={"drive_friction": None}), PROPERTIES, loop) is None
    uneven = PROPERTIES.model_copy(update={"jitter": 0.01})
    assert momentum_check(DECLARED, uneven, replace(loop, integral=1.0)) is None


def compared(seed: int, cycles: int, **sensor: float) -> str:
    """ "" where a random display with true declarations ran on; else why it did not."""
    display = random_display(seed, "guarded")
    found = with_true_bounds(display, cycles)
    parameters: Any = display.parameters
    if found is None or (parameters.integral_gain and display.properties.jitter):
        return ""
    friction = {"drive_friction": 4.0 if display.effects else 0.0, "drive_damping": display.plant.damping}
    parameters = found[0].parameters
    simulation = display.simulation
    changed = simulation.sensor.model_copy(update=sensor)
    display = replace(
        found[0], parameters=parameters.model_copy(update=friction),
        simulation=simulation.model_copy(update={"sensor": changed}),
    )  # fmt: skip
    try:
        run(display, cycles)
    except ForceContradictedError as error:
        return str(error)
    return ""


@pytest.mark.slow
def test_true_declarations_are_never_contradicted_and_an_offset_is() -> None:
    for seed in (3, 12):
        assert compared(seed, 200) == ""
        assert "on average" in compared(seed, 200, fault_offset=60.0, fault_at=0.05)
