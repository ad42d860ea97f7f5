"""Holds as they are on a rig: jitter, a late torque, a lagging current, limits, a hand that pushes.

Each hole is shown first, where it is not declared, and then gone where it is.
"""

import random
from typing import Any

import pytest

from canhaptic.control.environments.damper_wall import DamperWall
from canhaptic.control.environments.spring_damper_wall import SpringDamperWall
from canhaptic.control.passivity import LoopProperties, build_controller
from canhaptic.control.passivity.guarded import GuardedParameters
from canhaptic.errors import ParameterError
from tests.adversary.late_axis import climb

ROUNDING = 1e-9  # [J]


def made(sample_time: float, delay: int, stiffness: float, damping: float, own: Any, known: Any) -> Any:
    loop = LoopProperties(
        **{"sample_time": sample_time, "delay": delay, "moving_mass": 0.25, "device_damping_bound": 0.0, **known}
    )
    wall = SpringDamperWall(stiffness=stiffness, damping=damping)
    return build_controller(wall, "guarded", GuardedParameters(**own), loop)


def worst(
    sample_time: float,
    delay: int,
    wall: tuple[float, float],
    *,
    own: Any,
    known: Any,
    seeds: Any = (1, 3),
    **how: Any,
):
    """Returns the least true sum that a few searches find, and the most that was booked beyond it [J]."""
    found = [
        climb(lambda: made(sample_time, delay, *wall, own, known), random.Random(seed), sample_time, delay, **how)
        for seed in seeds
    ]
    return min(least for least, _ in found), max(beyond for _, beyond in found)


HOLES = {
    "jitter": ({"jitter": 0.1}, {"sync_jitter": 0.1}, 1e-2, 0, (1e5, 0.0)),
    "late torque": ({"window": 3e-4}, {"torque_window": 3e-4}, 1e-3, 0, (1e4, 0.0)),
    "current loop": ({"lag": 3e-4}, {"current_lag": 3e-4}, 1e-3, 0, (1e4, 0.0)),
    "current loop, one sample late": ({"lag": 3e-4}, {"current_lag": 3e-4}, 1e-3, 1, (1e4, 0.0)),
    "a lag of three holds": ({"lag": 3e-2}, {"current_lag": 3e-2}, 1e-2, 1, (1e4, 5.0)),
    "all together": (
        {"jitter": 0.05, "window": 2e-4, "lag": 2e-4},
        {"sync_jitter": 0.05, "torque_window": 2e-4, "current_lag": 2e-4}, 1e-3, 1, (1e4, 5.0),
    ),
}  # fmt: skip


@pytest.mark.slow_but("all together")
@pytest.mark.parametrize("hole", HOLES)
def test_what_is_declared_of_the_holds_is_certified(hole: str) -> None:
    how, declared, sample_time, delay, wall = HOLES[hole]
    own = {"hand_force": 5.0}
    open_, booked = worst(sample_time, delay, wall, own=own, known={}, seeds=(1,), pull=5.0, push=30.0, **how)
    assert open_ < -1e-4
    closed, beyond = worst(sample_time, delay, wall, own=own, known=declared, pull=5.0, push=30.0, **how)
    assert closed >= -ROUNDING
    assert beyond <= ROUNDING
    if hole != "jitter":  # a jittering hold is booked exactly
        assert booked > 1e-4


def test_a_rising_torque_is_kept_to_the_rate_of_the_limiter_and_to_its_power() -> None:
    known = {"torque_rate_limit": 100.0, "torque_limit": 3.0, "power_limit": 0.05}
    controller, position, held, last = made(1e-3, 0, 1e4, 0.0, {"hand_force": 0.0}, known), 0.001, 0.0, 0.0
    sizes = []
    for step in range(80):
        last, held = held, controller.step(position, held).torque
        assert abs(held) <= abs(last) + 0.1 + 1e-12
        sizes.append(abs(held))
        position += -2e-4 if step < 40 else 1e-4
    assert max(sizes) == 3.0
    assert sizes[-1] <= 0.05 / 0.1 + 1e-12


@pytest.mark.slow
@pytest.mark.parametrize("delay", [0, 1])
def test_no_torque_sticks_beyond_what_is_certified_for_the_push(delay: int) -> None:
    """A hand that never pulls out pushes with up to 60 N: declared as 0 N, and not at all, and as it is."""
    how: dict[str, Any] = {"pull": 0.0, "push": 60.0}
    wall = (1e3, 50.0)
    assert worst(1e-2, delay, wall, own={"hand_push": 0.0}, known={}, **how)[0] < -1e-3
    assert worst(1e-2, delay, wall, own={}, known={}, **how)[0] >= -ROUNDING
    assert worst(1e-2, delay, wall, own={"hand_push": 60.0}, known={}, **how)[0] >= -ROUNDING


@pytest.mark.parametrize("side", ["below", "above"])
def test_without_a_push_declared_a_damper_does_not_hold_the_hand_back(side: str) -> None:
    out = 1.0 if side == "below" else -1.0
    loop = LoopProperties(sample_time=1e-3, moving_mass=0.25, device_damping_bound=0.0)
    for push, sticks in ((None, False), (0.0, True)):
        parameters = GuardedParameters(hand_push=push, energy_allowance=1e-2)
        controller = build_controller(DamperWall(damping=20.0, side=side), "guarded", parameters, loop)
        torques, held = [], 0.0
        for step in range(40):  # in, and out again
            position = -out * 1e-4 * (step if step < 20 else 40 - step)
            held = controller.step(position, held).torque
            torques.append(out * held)
        assert max(torques) > 0.0
        assert (min(torques) < 0.0) is sticks


def test_the_hand_force_needs_an_upper_bound_of_the_damping() -> None:
    with pytest.raises(ParameterError, match="without device_damping_bound"):
        made(1e-3, 0, 1e3, 0.0, {}, {"device_damping_bound": None})
    made(1e-3, 0, 1e3, 0.0, {"hand_force": None}, {"device_damping_bound": None, "device_damping": 1.0})


def test_dry_friction_pushes_with_the_hand() -> None:
    declared = made(1e-3, 0, 1e4, 0.0, {"hand_force": 3.0}, {"device_friction_bound": 2.0})
    stronger = made(1e-3, 0, 1e4, 0.0, {"hand_force": 5.0}, {})
    position, held = 1e-3, 0.0
    for _ in range(60):
        torques = [controller.step(position, held).torque for controller in (declared, stronger)]
        assert torques[0] == torques[1]
        held, position = torques[0], position - 1e-4
    assert held > 1.0


def test_a_window_as_long_as_a_hold_is_refused() -> None:
    with pytest.raises(ParameterError, match="torque_window: got 0"):
        made(1e-3, 0, 1e3, 0.0, {}, {"torque_window": 1e-3})


def test_an_ideal_declaration_changes_no_bit() -> None:
    known = {"sync_jitter": 0.0, "torque_window": 0.0, "current_lag": 0.0}
    pair = [made(1e-3, 1, 5e3, 5.0, {"hand_force": 2.0}, each) for each in ({}, known)]
    rng, position, held = random.Random(1), 2e-3, 0.0
    for _ in range(300):
        first, second = (controller.step(position, held) for controller in pair)
        assert first == second
        held, position = first.torque, position + rng.uniform(-2e-4, 1.6e-4)


@pytest.mark.parametrize("delay", [0, 1])
def test_a_hold_that_lasted_longer_counts_by_its_last_sample_time(delay: int) -> None:
    """Three sample times of a slow motion inwards are no fast one: taken for that they certify too much."""
    torques = []
    for hold_length in (1.0, 3.0):
        controller, held = made(1e-2, delay, 1e4, 0.0, {"hand_force": 5.0}, {}), 0.0
        controller.step(1e-3, held)
        controller.note_skipped_syncs(hold_length)
        torques.append(controller.step(-5e-3, held).torque)
        assert controller.step(-11e-3, held).torque > 0.0  # the next hold is one of the usual length
    assert torques[0] > 2.0 * torques[1]
