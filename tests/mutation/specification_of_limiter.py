"""What `canhaptic.drive.safety.limiter` must do, as properties on numbers that binary floating point holds exactly."""

import itertools
import math
from types import ModuleType
from typing import Any

import pytest

from canhaptic.errors import ControlError, ParameterError

LIMIT, SAMPLE_TIME, RATE, STEP, POWER = 4.0, 1.0 / 1024.0, 1024.0, 1.0, 2.0
LASTS = (0.0, 0.25, 1.0, 3.5, 4.0, -0.25, -1.0, -3.5, -4.0)
TORQUES = (0.0, 0.25, 0.5, 1.0, 1.25, 2.0, 3.5, 4.0, 4.25, 64.0)
VELOCITIES = (0.0, 5e-324, 0.25, 0.5, 1.0, 2.0, 8.0, 1024.0)
NOT_FINITE = (math.nan, math.inf, -math.inf)


def both_signs(values: tuple[float, ...]) -> list[float]:
    """The values and their negatives."""
    return sorted({sign * value for value in values for sign in (1.0, -1.0)})


CASES = list(itertools.product(LASTS, both_signs(TORQUES), both_signs(VELOCITIES)))


def rise(torque: float, last: float) -> float:
    """How much of a torque is new: all of it when the last one acted the other way, nothing when it only falls."""
    return abs(torque) - (abs(last) if torque * last > 0.0 else 0.0)


def breaks(torque: float, last: float, velocity: float) -> int:
    """Which limits a torque breaks, as one bit each."""
    too_much, too_fast, too_strong = abs(torque) > LIMIT, rise(torque, last) > STEP, torque * velocity > POWER
    return 1 * too_much | 2 * too_fast | 4 * too_strong


def judge(module: ModuleType) -> None:
    """Raises when the module is no limiter."""
    _every_case(module)
    _sequence(module)
    _absent_limits(module)
    _not_finite(module)
    _refusals(module)
    _dry_run(module)


def _every_case(module: ModuleType) -> None:
    limiter = module.TorqueLimiter(LIMIT, SAMPLE_TIME, RATE, POWER)
    for last, torque, velocity in CASES:
        limiter.last = last
        limited = limiter.limit(torque, velocity)
        expected = breaks(torque, last, velocity)
        assert limiter.last == limited
        assert breaks(limited, last, velocity) == 0  # all limits at once
        assert (limited == torque) is (expected == 0)
        assert limited * torque >= 0.0  # never the other way
        if expected:  # never less than the limits leave
            assert breaks(limited + math.copysign(2.0**-40, torque), last, velocity)
        _bounds(limiter, last, velocity)


def _bounds(limiter: Any, last: float, velocity: float) -> None:
    assert limiter.low <= 0.0 <= limiter.high
    for bound, outward in ((limiter.low, -(2.0**-40)), (limiter.high, 2.0**-40)):
        assert breaks(bound, last, velocity) == 0
        assert breaks(bound + outward, last, velocity)


def _sequence(module: ModuleType) -> None:
    limiter = module.TorqueLimiter(LIMIT, SAMPLE_TIME, RATE, POWER)
    assert (limiter.last, limiter.low, limiter.high) == (0, 0, 0)
    asked = (9.0, 9.0, 9.0, 9.0, 9.0, 0.5, 0.5, -9.0, -9.0, 9.0, 0.0)
    assert [limiter.limit(torque, 0.0) for torque in asked] == [1, 2, 3, 4, 4, 0.5, 0.5, -1, -2, 1, 0]
    limiter.limit(9.0, 0.0)
    limiter.reset()
    assert (limiter.last, limiter.low, limiter.high) == (0, 0, 0)


def _absent_limits(module: ModuleType) -> None:
    for rate, power, given in ((None, None, 1), (RATE, None, 3), (None, POWER, 5)):
        limiter = module.TorqueLimiter(LIMIT, SAMPLE_TIME, rate, power)
        for last, torque, velocity in CASES[::7]:
            limiter.last = last
            limited = limiter.limit(torque, velocity)
            expected = breaks(torque, last, velocity) & given
            assert limiter.last == limited
            assert (limited == torque) is (expected == 0)
            for bound, outward in ((limiter.low, -(2.0**-40)), (limiter.high, 2.0**-40)):
                assert breaks(bound, last, velocity) & given == 0
                assert breaks(bound + outward, last, velocity) & given


def _not_finite(module: ModuleType) -> None:
    wrong_torque = [(wrong, 0.0) for wrong in NOT_FINITE]
    wrong_velocity = [(1.0, wrong) for wrong in NOT_FINITE]
    for limits in ((), (RATE, POWER)):
        for torque, velocity in wrong_torque + wrong_velocity:
            limiter = module.TorqueLimiter(LIMIT, SAMPLE_TIME, *limits)
            limiter.limit(1.0, 0.0)
            with pytest.raises(ControlError, match=f"torque of {torque} at a velocity of {velocity},"):
                limiter.limit(torque, velocity)
            assert (limiter.last, limiter.low, limiter.high) == (0.0, 0.0, 0.0)


def _refusals(module: ModuleType) -> None:
    good = (LIMIT, SAMPLE_TIME, RATE, POWER)
    for place, wrong in itertools.product(range(4), (0.0, -0.5, -5.0, math.nan)):
        with pytest.raises(ParameterError, match=f"got {wrong},"):
            module.TorqueLimiter(*good[:place], wrong, *good[place + 1 :])


def _dry_run(module: ModuleType) -> None:
    dry = module.DryRunLimiter(LIMIT, SAMPLE_TIME, RATE, POWER)
    assert (dry.last, dry.low, dry.high, dry.withheld) == (0, 0, 0, 0)
    for torque, withheld in ((0.5, 0.5), (-0.75, 0.75), (0.25, 0.75), (9.0, 1.0), (9.0, 1.0)):
        assert dry.limit(torque, 0.0) == 0.0  # and the next begins from no torque
        assert (dry.last, dry.low, dry.high, dry.withheld) == (0, 0, 0, withheld)
    assert dry.limit(1.0, 8.0) == 0.0
    assert dry.withheld == 1.0
    dry.reset()
    assert (dry.withheld, dry.last) == (0, 0)
    for value in NOT_FINITE:
        with pytest.raises(ControlError):
            dry.limit(value, 0.0)
        with pytest.raises(ControlError):
            dry.limit(0.0, value)
    assert dry.withheld == 0.0
