"""The limiter and the link policy on their own, dense near the limits."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canhaptic.drive.safety.limiter import TorqueLimiter
from canhaptic.drive.safety.link_policy import STOP_TABLE, LinkPolicy, StopReason
from canhaptic.errors import ControlError, ParameterError, RigError

LIMIT, SAMPLE_TIME, RATE, POWER = 5.0, 1e-3, 1000.0, 2.0
STEP = RATE * SAMPLE_TIME
HAIR = 1.0 + 1e-12
TINY = 5e-324
at_limits = [LIMIT, math.nextafter(LIMIT, 9.0), math.nextafter(LIMIT, 0.0), STEP, 1.1, 0.0, 1e300, TINY, POWER]
near = st.one_of(st.floats(-20, 20), st.sampled_from(at_limits + [-value for value in at_limits]))


def rises_by(torque: float, last: float) -> float:
    """How much of a torque is new: all of it when the last one acted the other way."""
    return abs(torque) - (abs(last) if torque * last > 0.0 else 0.0)


@given(st.lists(st.tuples(near, near), min_size=1, max_size=20))
def test_every_torque_obeys_magnitude_rate_and_power_at_once(commands: list[tuple[float, float]]) -> None:
    limiter, last = TorqueLimiter(LIMIT, SAMPLE_TIME, RATE, POWER), 0.0
    for torque, velocity in commands:
        limited = limiter.limit(torque, velocity)
        assert abs(limited) <= LIMIT
        assert rises_by(limited, last) <= STEP * HAIR
        assert limited * velocity <= POWER * HAIR
        assert (limited == torque) == (limiter.low <= torque <= limiter.high)
        assert limited * torque >= 0.0
        assert abs(limited) <= abs(torque)
        assert limiter.low <= limited <= limiter.high
        last = limited


@given(near, near, near)
def test_a_torque_that_was_cut_is_the_largest_that_the_limits_leave(first: float, torque: float, velocity: float):
    limiter = TorqueLimiter(LIMIT, SAMPLE_TIME, RATE, POWER)
    last = limiter.limit(first, 0.0)
    limited = limiter.limit(torque, velocity)
    if limited != torque:
        more = limited + math.copysign(1e-9 * max(1.0, abs(limited)), torque)
        too_fast = rises_by(more, last) > STEP
        assert abs(more) > LIMIT or too_fast or more * velocity > POWER


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_reversal_falls_to_zero_at_once_and_rises_on_the_other_side_by_the_rate(sign: float) -> None:
    limiter = TorqueLimiter(20.0, SAMPLE_TIME, RATE)
    while limiter.last != sign * 10.0:
        limiter.limit(sign * 10.0, 0.0)
    assert [limiter.limit(-sign * 9.0, 0.0) for _ in range(3)] == [-sign, -2.0 * sign, -3.0 * sign]


@pytest.mark.parametrize("wrong", [0.0, -1.0, math.nan])
@pytest.mark.parametrize("place", range(4))
def test_a_limit_that_would_limit_nothing_is_refused(place: int, wrong: float) -> None:
    values = [LIMIT, SAMPLE_TIME, RATE, POWER]
    values[place] = wrong
    with pytest.raises(ParameterError, match=str(wrong)):
        TorqueLimiter(*values)


def test_a_limit_that_is_not_given_limits_nothing() -> None:
    limiter = TorqueLimiter(LIMIT, SAMPLE_TIME)
    assert limiter.limit(LIMIT, 1e9) == LIMIT
    assert limiter.limit(-LIMIT, 1e9) == -LIMIT


@pytest.mark.parametrize(
    ("torque", "velocity", "limited"),
    [(9.0, 0.0, 1.0), (0.9, 0.0, 0.9), (1.0, 4.0, 0.5), (1.0, -4.0, 1.0), (-9.0, 0.0, -1.0)],
)
def test_only_the_limit_that_is_exceeded_cuts(torque: float, velocity: float, limited: float) -> None:
    limiter = TorqueLimiter(LIMIT, SAMPLE_TIME, RATE, POWER)
    assert limiter.limit(torque, velocity) == pytest.approx(limited)


def test_the_rate_limit_never_delays_a_fall_to_zero() -> None:
    limiter = TorqueLimiter(LIMIT, SAMPLE_TIME, RATE)
    for _ in range(10):
        limiter.limit(LIMIT, 0.0)
    assert limiter.last == LIMIT
    assert limiter.limit(0.0, 0.0) == 0.0


@pytest.mark.parametrize("wrong", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("what", ["torque", "velocity"])
def test_a_torque_or_velocity_that_is_not_finite_is_no_torque(what: str, wrong: float) -> None:
    limiter = TorqueLimiter(LIMIT, SAMPLE_TIME)
    limiter.limit(1.0, 0.0)
    with pytest.raises(ControlError, match=f"{what} .*{wrong}"):
        limiter.limit(*((wrong, 0.0) if what == "torque" else (1.0, wrong)))
    assert limiter.last == 0.0


def test_the_policy_holds_and_lets_go_as_its_table_says() -> None:
    policy = LinkPolicy(hold_cycles=2, stop_cycles=6, loss_limit=0.1, rate=1000.0)
    seen = []
    for _ in range(7):
        policy.on_missed()
        seen.append(policy.is_held)
    assert seen == [True, True, False, False, False, False, False]
    policy.on_tpdo()
    assert (policy.is_held, policy.missed, policy.missed_total) == (True, 0, 7)
    assert policy.success_rate() == pytest.approx(1 / 8)


def test_every_reason_that_is_raised_has_words_a_remedy_and_an_exception_of_its_own() -> None:
    assert set(STOP_TABLE) == set(StopReason) - {StopReason.NONE, StopReason.OPERATOR}
    assert all(rule.meaning and rule.remedy and issubclass(rule.error, RigError) for rule in STOP_TABLE.values())
    assert len({rule.error for rule in STOP_TABLE.values()}) == len(STOP_TABLE)
