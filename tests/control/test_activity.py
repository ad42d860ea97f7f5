"""When a port had given out energy for certain, at the motor and at the handle."""

from dataclasses import replace
from math import inf

from hypothesis import given
from hypothesis import strategies as st

from canhaptic.control.axis_meter import IDEAL, Accuracy
from canhaptic.control.verdict import ACTIVE_AT_HANDLE, ACTIVE_AT_MOTOR
from canhaptic.meters import ActiveLimits, Activity, active_limits

BOUNDED = Accuracy(largest_speed=2.0, device_damping_bound=0.5, device_friction_bound=3.0)


def test_the_most_that_a_device_dissipates_is_that_of_its_largest_speed_and_unknown_where_one_bound_is_missing() -> (
    None
):
    assert BOUNDED.most_dissipated == (0.5 * 2.0 + 3.0) * 2.0
    assert replace(BOUNDED, device_damping_bound=None).most_dissipated == inf
    assert replace(BOUNDED, device_friction_bound=None).most_dissipated == inf
    assert replace(BOUNDED, largest_speed=inf).most_dissipated == inf
    assert active_limits([BOUNDED, BOUNDED], 0.0).power == 2.0 * BOUNDED.most_dissipated


def test_an_estimate_has_no_floor_and_an_allowance_lowers_it() -> None:
    estimated = Accuracy(late=1e-3)
    assert estimated.is_estimate
    assert active_limits([IDEAL, estimated], 0.0).floor == -inf
    assert not replace(estimated, late_speed=1.0).is_estimate
    assert active_limits([replace(estimated, late_speed=1.0)], 0.5).floor == -(0.5 + 1e-9)


@given(st.lists(st.floats(-1.0, 1.0), min_size=1, max_size=30), st.floats(0.0, 0.5), st.floats(0.0, 20.0))
def test_the_first_hold_below_the_floor_is_kept_at_motor_and_handle(
    sums: list[float], allowance: float, power: float
) -> None:
    activity = Activity(ActiveLimits(-allowance, power, 1e-2))
    below = [k for k, most in enumerate(sums) if most < -allowance]
    at_handle = [k for k, most in enumerate(sums) if most + power * (k + 1) * 1e-2 < -allowance]
    for deadline, most in enumerate(sums):
        activity.take(most, deadline)
    assert activity.since == (below[0] if below else None)
    assert activity.at_handle_since == (at_handle[0] if at_handle else None)
    assert activity.active == ACTIVE_AT_MOTOR * bool(below) + ACTIVE_AT_HANDLE * bool(at_handle)
