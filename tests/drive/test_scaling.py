"""Counts and per mille against SI, by hand-computed values and by properties."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canhaptic.drive.profile.scaling import AxisScaling, torque_limit_per_mille
from canhaptic.errors import ParameterError


@given(start=st.integers(-(2**31), 2**31 - 1), steps=st.lists(st.integers(-(2**30), 2**30), max_size=30))
def test_a_position_counter_that_wraps_goes_on(start: int, steps: list[int]) -> None:
    scaling = AxisScaling(counts_per_unit=1.0, rated_torque=1.0)
    true = start
    assert scaling.position(start) == true
    for step in steps:
        true += step
        wrapped = (true + 2**31) % 2**32 - 2**31
        assert scaling.position(wrapped) == true


def test_a_reset_takes_the_next_position_as_it_comes() -> None:
    scaling = AxisScaling(counts_per_unit=1000.0, rated_torque=1.0)
    scaling.position(2**31 - 1)
    assert scaling.position(-(2**31)) == pytest.approx(2**31 / 1000.0)
    scaling.reset()
    assert scaling.position(-1000) == pytest.approx(-1.0)


@pytest.mark.parametrize(("torque", "per_mille"), [(0.0, 0), (2.5, 1000), (-2.5, -1000), (0.00124, 0), (0.00126, 1)])
def test_a_torque_becomes_the_nearest_per_mille_of_the_rated_torque(torque: float, per_mille: int) -> None:
    assert AxisScaling(1.0, rated_torque=2.5).torque_per_mille(torque, -9.0, 9.0) == per_mille


@given(
    torque=st.floats(-1e3, 1e3),
    rated=st.floats(1e-2, 1e3),
    limits=st.tuples(st.floats(0.0, 1e3), st.floats(0.0, 1e3)),
    direction=st.sampled_from([1, -1]),
)
def test_rounding_never_takes_a_torque_beyond_its_limits(torque, rated, limits, direction) -> None:
    scaling, (low, high) = AxisScaling(1.0, rated, direction), (-limits[0], limits[1])
    torque = min(max(torque, low), high)
    sent = scaling.torque(scaling.torque_per_mille(torque, low, high))
    hair = 2e-9 * scaling.torque_quantum + 1e-15 * abs(torque)
    assert low - hair <= sent <= high + hair
    assert abs(sent - torque) < scaling.torque_quantum + hair


@pytest.mark.parametrize("direction", [1, -1])
def test_a_torque_at_its_limit_is_rounded_toward_zero_only_where_it_must(direction: int) -> None:
    scaling = AxisScaling(1.0, 10.0, direction)
    assert scaling.torque_per_mille(3.006, -3.006, 3.006) == 300 * direction
    assert scaling.torque_per_mille(-3.006, -3.006, 3.006) == -300 * direction
    assert scaling.torque_per_mille(3.004, -3.006, 3.006) == 300 * direction
    assert scaling.torque_per_mille(2.996, -3.006, 3.006) == 300 * direction


def test_a_limit_of_whole_per_mille_is_reached() -> None:
    for rated in (7.3, 1.27, 10.0, 0.11):
        scaling = AxisScaling(1.0, rated)
        limits = [n / 1000.0 * rated for n in range(2000)]
        assert [scaling.torque_per_mille(limit, -limit, limit) for limit in limits] == list(range(2000))
        assert [scaling.torque_per_mille(-limit, -limit, limit) for limit in limits] == [-n for n in range(2000)]


@given(st.floats(1e-3, 1e4), st.sampled_from([1, -1]))
def test_the_largest_torque_fits_the_object(rated: float, direction: int) -> None:
    scaling = AxisScaling(1.0, rated, direction)
    limit = scaling.largest_torque
    assert scaling.torque_per_mille(limit, -limit, limit) == 32767 * direction
    assert scaling.torque_per_mille(-limit, -limit, limit) == -32767 * direction


@given(st.integers(-32768, 32767), st.floats(1e-3, 1e4), st.sampled_from([1, -1]))
def test_every_per_mille_survives_the_way_there_and_back(per_mille: int, rated: float, direction: int) -> None:
    scaling = AxisScaling(1.0, rated, direction)
    assert scaling.torque_per_mille(scaling.torque(per_mille), -math.inf, math.inf) == per_mille
    assert math.copysign(1, scaling.torque(per_mille)) == math.copysign(1, per_mille * direction) or per_mille == 0


@given(st.floats(1e-3, 1e4), st.floats(1e-3, 1e4))
def test_the_drives_limit_never_exceeds_the_configured_one(limit: float, rated: float) -> None:
    per_mille = torque_limit_per_mille(limit, rated)
    assert per_mille * rated / 1000.0 <= limit * (1.0 + 1e-6)
    assert (per_mille + 1) * rated / 1000.0 > limit * (1.0 - 1e-6)


def test_a_limit_that_is_a_whole_number_of_per_mille_is_kept() -> None:
    assert [torque_limit_per_mille(n / 1000.0 * 7.3, 7.3) for n in range(1, 2000)] == list(range(1, 2000))


@pytest.mark.parametrize("wrong", [0.0, -1.0, math.nan, math.inf])
def test_a_factor_that_is_not_positive_and_finite_is_refused(wrong: float) -> None:
    with pytest.raises(ParameterError, match="counts_per_unit"):
        AxisScaling(wrong, 1.0)
    with pytest.raises(ParameterError, match="rated_torque"):
        AxisScaling(1.0, wrong)
