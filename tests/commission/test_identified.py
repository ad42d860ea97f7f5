"""Mass and friction: what each estimate needs, and the error that it states, on motions made here."""

from collections.abc import Callable

import numpy as np
import pytest

from canhaptic.commission.mass_and_friction import (
    Dynamics,
    FrictionCurve,
    estimate,
    estimate_lateness,
    friction_curve,
    mass_within,
)
from canhaptic.commission.session import doublet, reversals, sweep
from canhaptic.commission.torque_tests import declared_of

TIME = 1e-3
MASS = 0.25


def moved(torques: np.ndarray, mass: float = MASS, speed: float = 0.0) -> np.ndarray:
    """Positions of a free mass under held torques, in closed form."""
    speeds = speed + np.concatenate([[0.0], np.cumsum(torques)]) * TIME / mass
    steps = TIME * (speeds[:-1] + 0.5 * torques * TIME / mass)
    return np.concatenate([[0.0], np.cumsum(steps)])


def applied(torques: np.ndarray) -> np.ndarray:
    return np.concatenate([[0.0], torques])


def pushed(speeds: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Positions and torques of a free mass that has these speeds at the SYNCs."""
    torques = MASS * np.diff(speeds) / TIME
    steps = 0.5 * TIME * (speeds[:-1] + speeds[1:])
    return np.concatenate([[0.0], np.cumsum(steps)]), applied(torques)


def test_a_range_of_speed_counts_only_where_the_axis_moved_in_both_directions() -> None:
    """Fast it moves towards small positions alone: friction there and a constant load look the same."""
    slow = 0.1 * np.sin(np.arange(4000) * 2.0 * np.pi / 250.0)
    fast = -0.5 + 0.1 * np.sin(np.arange(2000) * 2.0 * np.pi / 170.0)
    curve = friction_curve(*pushed(np.concatenate([slow, fast])), TIME, 20)
    assert curve is not None
    assert curve.speeds.max() < 0.3
    assert curve.mass == pytest.approx(MASS, rel=1e-3)


def test_an_axis_that_steps_back_within_every_window_moves_neither_way() -> None:
    speeds = 0.2 * np.sin(np.arange(2000) * 2.0 * np.pi / 500.0)
    positions, torques = pushed(speeds)
    assert friction_curve(positions, torques, TIME, 4) is not None
    positions[3::4] += 2.0 * TIME * speeds[3::4]
    assert friction_curve(positions, torques, TIME, 4) is None


def test_windows_of_a_few_samples_serve_as_well() -> None:
    torques = np.array(reversals(1.0, 36, 16))
    late = estimate_lateness(moved(torques), applied(torques), TIME, 3)
    assert late is not None
    assert late[0] == pytest.approx(0.0, abs=1e-6)


def test_a_short_fast_motion_does_not_cost_the_windows_of_the_others() -> None:
    """The motion that each part of a window needs is relative to the fastest tenth of the windows."""
    torques = np.concatenate([np.array(reversals(1.0, 36, 32)), np.array(doublet(20.0, 8))])
    late = estimate_lateness(moved(torques), applied(torques), TIME, 12)
    assert late is not None
    assert late[0] == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("speed", [0.0, 3.0])
def test_the_mass_of_a_shake_is_found_at_rest_and_on_an_axis_that_never_turns(speed: float) -> None:
    signs = np.random.default_rng(1).choice([-1.0, 1.0], 64)
    torques = np.concatenate([doublet(float(sign), 6) for sign in signs])
    found = mass_within(moved(torques, speed=speed), applied(torques), TIME, 6)
    assert found is not None
    assert found[0] == pytest.approx(MASS, rel=1e-3)


def scatter(of: Callable[[np.ndarray], tuple[float, float] | None], positions: np.ndarray) -> float:
    """Deviation of a mass over many noises, relative to the one that it states."""
    noise = np.random.default_rng(5)
    found = [of(positions + noise.normal(0.0, 2e-6, len(positions))) for _ in range(60)]
    masses, errors = np.array([each for each in found if each is not None]).T
    return float(masses.std() / errors.mean())


def test_windows_that_overlap_state_at_least_the_deviation_that_the_mass_has_and_at_most_twice_as_much() -> None:
    signs = np.random.default_rng(1).choice([-1.0, 1.0], 24)
    torques = np.concatenate([doublet(float(sign), 8) for sign in signs])
    assert 0.5 < scatter(lambda q: mass_within(q, applied(torques), TIME, 12), moved(torques)) < 1.0


def test_the_rest_is_the_effective_value_of_what_is_not_explained() -> None:
    torques, half = np.array(sweep(1.0, 2.0, 8.0, 4.0, TIME)), 20
    noise = np.random.default_rng(2).normal(0.0, 0.05, len(torques))
    found = estimate(moved(torques), applied(torques + noise), TIME, half)
    assert found is not None
    rising = (np.arange(half) + 0.5) / half**2
    assert found.residual == pytest.approx(0.05 * np.sqrt(2.0 * (rising**2).sum()), rel=0.1)


def curve(frictions: tuple[float, ...], errors: tuple[float, ...]) -> FrictionCurve:
    speeds = np.arange(1.0, len(frictions) + 1.0)
    return FrictionCurve(0.25, 0.01, speeds, np.array(frictions), np.array(errors))


def test_friction_falls_at_its_end_where_the_last_range_is_surely_below_all_others() -> None:
    assert curve((1.0, 0.9, 0.6), (0.05, 0.05, 0.05)).falls_at_its_end(2.0)
    assert not curve((1.0, 0.9, 0.6), (0.1, 0.1, 0.1)).falls_at_its_end(2.0)
    assert not curve((1.0, 0.6, 0.9), (0.01, 0.01, 0.01)).falls_at_its_end(2.0)
    assert curve((1.0, 0.9), (0.1, 0.1)).falls_at_its_end(2.0)  # too few to tell


def test_least_friction_is_that_of_the_worst_range_without_damping_and_doubt() -> None:
    assert curve((1.0, 0.7, 0.9), (0.1, 0.05, 0.3)).least(0.05, 2.0) == pytest.approx(0.15)
    assert curve((0.1, 0.1, 0.1), (0.1, 0.1, 0.1)).least(0.0, 2.0) == 0.0


def test_of_each_interval_the_safe_end_is_declared_with_its_margin() -> None:
    found = Dynamics(0.25, 0.01, 0.16, 0.03, 0.3, 0.02, 0.0, 0.0)
    flat = curve((0.9, 0.9, 0.9), (0.05, 0.05, 0.05))
    assert declared_of(found, flat) == pytest.approx(
        {
            "moving_mass": 0.9 * 0.23,
            "device_damping_bound": 2.0 * 0.22,
            "device_friction_bound": 2.0 * 0.34,
            "device_damping": 0.5 * 0.1,
            "device_friction": 0.5 * flat.least(0.1, 2.0),
        }
    )  # fmt: skip
    assert "device_friction" not in declared_of(found, None)
