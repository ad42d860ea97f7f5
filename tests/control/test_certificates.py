"""The three bounds against worst users found independently: closed forms, brute force and simulated attack."""

import math
from dataclasses import astuple, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from canhaptic.control.certificates.certified_torque import Declared, torque_for_any_hand
from canhaptic.control.certificates.scalar_bounds import (
    NO_RESPONSE,
    WINDOW,
    displacement_response,
    hand_force_bound,
    hold_timing,
    next_displacement,
    renderable_by_device_damping,
    renderable_by_hand_force,
    renderable_by_hand_speed,
    start_speed,
)
from tests.adversary.users import Mass
from tests.drawn import examples

positive = st.floats(1e-6, 1e3)


def displacements(mass, damping, sample_time, velocity, torques, hand):
    """Displacements of successive holds, hand force by quarters of a hold."""
    parts = len(hand) // len(torques)
    body = Mass(mass, damping, sample_time / parts, 0.0)
    body.velocity = velocity
    ends = [0.0]
    for hold, torque in enumerate(torques):
        for part in range(parts):
            body.advance(torque + hand[hold * parts + part])
        ends.append(body.position)
    return np.diff(ends)


@settings(max_examples=examples(200))
@given(
    mass=st.floats(0.05, 2.0),
    under=st.floats(0.3, 1.0),
    damping=st.floats(0.0, 20.0),
    known=st.tuples(st.floats(0.0, 1.0), st.floats(1.0, 3.0)),
    rate=st.sampled_from([40.0, 100.0, 1e3, 1e4]),
    velocity=st.floats(-2.0, 2.0),
    torques=st.tuples(st.floats(-30.0, 30.0), st.floats(0.0, 30.0)),
    hand=st.lists(st.floats(-200.0, 20.0), min_size=8, max_size=8),
)
def test_no_hand_within_its_force_moves_the_axis_further_than_the_reach(
    mass, under, damping, known, rate, velocity, torques, hand
):
    response = displacement_response(1.0 / rate, under * mass, 20.0, known[0] * damping, known[1] * damping)
    first, second = displacements(mass, damping, 1.0 / rate, velocity, torques, hand)
    assert second <= next_displacement(float(first), *torques, response, response.hand) + 1e-12  # type: ignore[call-arg]


def test_the_reach_is_attained_by_the_hand_that_pulls_with_all_its_force():
    response = displacement_response(1e-2, 0.25, 20.0, 5.0, 5.0)
    first, second = displacements(0.25, 5.0, 1e-2, -3.0, (4.0, 7.0), [20.0] * 8)
    assert first < 0.0
    bound = next_displacement(float(first), 4.0, 7.0, response, response.hand)
    assert second == pytest.approx(bound, rel=1e-12)


def test_without_damping_the_reach_has_the_known_coefficients():
    response = displacement_response(1e-3, 0.25, 20.0)
    assert astuple(response)[:4] == pytest.approx((1.0, 2e-6, 2e-6, 8e-5))
    assert (response.swing, response.growth) == (1.0, 1.0)


@pytest.mark.parametrize("y", [0.9e-3, 1.1e-3])
def test_the_series_for_light_damping_joins_the_closed_form(y):
    response = displacement_response(1.0, 1.0, 1.0, y, y)
    assert response.during == pytest.approx((y - 1.0 + math.exp(-y)) / y**2, rel=1e-9)
    assert response.hand == pytest.approx(-math.expm1(-y) / y, rel=1e-9)


@given(budget=positive, base=st.floats(-10.0, 10.0), gain=positive)
def test_the_hand_force_bound_uses_up_the_budget_and_no_more(budget, base, gain):
    torque = hand_force_bound(budget, base, gain)
    taken = torque * (base + gain * torque)
    assert taken == pytest.approx(budget, rel=1e-6, abs=1e-9 * torque * (abs(base) + gain * torque))


@given(budget=st.floats(-1e3, 0.0), base=st.floats(-10.0, 10.0), gain=positive)
def test_without_a_budget_only_a_certain_inward_motion_allows_torque(budget, base, gain):
    torque = hand_force_bound(budget, base, gain)
    assert torque >= 0.0
    assert torque * (base + gain * torque) <= 1e-9 * torque * abs(base)
    if base >= 0.0:
        assert torque == 0.0


@given(
    energy=positive,
    damping=positive,
    under_way=st.floats(0.0, 10.0),
    moves=st.tuples(st.floats(-1.0, 1.0), st.floats(-1.0, 1.0)),
)
def test_under_the_device_damping_bound_no_motion_takes_more_than_there_is(energy, damping, under_way, moves):
    sample_time = 1e-2
    if 4.0 * damping * energy / sample_time < under_way**2:
        return
    known = Declared(sample_time, 1, 0, False, NO_RESPONSE, damping, 0.0, 0.0)
    torque = torque_for_any_hand(known, energy - sample_time * under_way**2 / (4.0 * damping))
    left = energy - under_way * moves[0] - torque * moves[1] + damping / sample_time * (moves[0] ** 2 + moves[1] ** 2)
    assert left >= -1e-9 * (energy + (under_way + torque))


@pytest.mark.parametrize(("delay", "share"), [(0, 2.0), (1, 6.0)])
def test_the_stiffness_that_a_hand_force_can_hold_is_the_known_one(delay, share):
    response = displacement_response(1e-2, 0.25, 5.0)
    expected = 0.25 / (share * 1e-4) * 10.0 / 15.0
    assert renderable_by_hand_force(response, delay, 10.0) == pytest.approx(expected)


def test_the_stiffness_that_device_damping_can_hold_is_colgates():
    assert renderable_by_device_damping(0.25, 1e-3, 0) == pytest.approx(500.0)
    assert renderable_by_device_damping(0.25, 1e-3, 1) == pytest.approx(250.0)


def test_the_stiffness_that_a_hand_speed_can_hold_stores_what_the_longest_path_takes():
    stiffness = renderable_by_hand_speed(0.5, 1e-3, 0, 8.0)
    assert 8.0**2 / (2.0 * stiffness) == pytest.approx(8.0 * 0.5 * 1e-3)


@pytest.mark.parametrize("delay", [0, 1])
def test_above_the_start_speed_a_contact_starts_from_zero_energy(delay):
    for friction in (0.1, 50.0):  # of which the axis loses next to nothing, or a fifth, of its speed in a hold
        response = displacement_response(1e-3, 0.25, 10.0, 0.0, friction)
        speed = start_speed(response, 1e-3, delay)
        assert friction > 1.0 or speed == pytest.approx((1 + delay) * 10.0 * 1e-3 / 0.25, rel=2e-3)
        assert speed * 1e-3 * response.retained ** (1 + delay) == pytest.approx((1 + delay) * response.hand)
        displacement = -1.001 * speed * 1e-3
        for _ in range(delay):
            displacement = next_displacement(displacement, 0.0, 0.0, response, response.hand)
        base = next_displacement(displacement, 0.0, 0.0, response, response.hand)
        assert hand_force_bound(0.0, base, response.during) > 0.0
    assert start_speed(replace(response, retained=0.0), 1e-3, delay) == math.inf


def test_holds_that_jitter_and_late_torques_lengthen_every_response():
    timing, mass, damping = hold_timing(1e-3, 0.02, 1e-4, 8e-5), 0.25, 40.0
    longest, theta = 1.02e-3, 1.8e-4
    found = displacement_response(1e-3, mass, 5.0, 0.0, damping, 9.0, timing)
    share = theta / 0.98e-3
    assert found.retained == pytest.approx(math.exp(-damping * longest / mass) * 0.98 / 1.02)
    assert (found.hand, found.push) == pytest.approx((5.0 * longest**2 / mass, 9.0 * longest**2 / mass))
    assert (found.growth, found.share, found.behind) == pytest.approx((1.02 / 0.98, share, share))
    assert (found.late, found.tail_before) == pytest.approx((2.0 * share, 0.5 * theta * longest / mass))
    assert found.tail_during == pytest.approx(theta**2 / mass)
    assert found.tail_hand * found.hand == pytest.approx(theta * (0.5 * longest + theta) / mass * 5.0)
    much = displacement_response(1e-3, mass, 5.0, 0.0, 3000.0, timing=hold_timing(1e-3, 0.0, 8e-4, 0.0))
    assert (much.late, much.behind, much.push) == (1.0, much.retained, math.inf)
    ideal = displacement_response(1e-3, mass, 5.0)
    assert (ideal.growth, ideal.late, ideal.tail_during, ideal.tail_hand) == (1.0, 0.0, 0.0, 0.0)


def test_without_a_hand_the_start_speed_is_what_the_longest_window_leaves_unsure():
    assert start_speed(displacement_response(1e-3, 0.25, 0.0), 1e-3, 0, 1e-5) == pytest.approx(1e-5 / WINDOW / 1e-3)


def test_friction_lengthens_the_way_back_inside_a_hold():
    """y / (1 - e^-y): 1 without friction, and y where nothing is left of the speed."""
    y = [0.0, 1e-9, 1.0, 200.0]
    found = [displacement_response(1e-3, 0.25, 5.0, 0.0, 0.25 * each / 1e-3).swing for each in y]
    assert found == pytest.approx([1.0, 1.0, 1.0 / (1.0 - math.exp(-1.0)), 200.0])


def test_a_stiffness_at_no_torque_is_without_limit():
    assert renderable_by_hand_force(displacement_response(1e-3, 0.25, 5.0), 1, 0.0) == math.inf


def test_with_a_coarse_encoder_the_start_speed_no_longer_falls_with_the_rate():
    count, force = 1e-4, 5.0
    speeds = [start_speed(displacement_response(1.0 / rate, 0.25, force), 1.0 / rate, 0, count) for rate in (4e3, 8e3)]
    assert speeds == pytest.approx([math.sqrt(2.0 * count * force / 0.25)] * 2, rel=0.15)


def test_a_torque_that_pulls_in_counts_as_none_in_the_hold_before_and_in_its_own():
    response = displacement_response(1e-3, 0.25, 10.0)
    free = next_displacement(-1e-5, 0.0, 0.0, response, response.hand)
    assert next_displacement(-1e-5, -0.5, -0.5, response, response.hand) == free


def test_what_comes_late_of_a_torque_at_rest_counts_with_the_stiffness_that_a_hand_force_can_hold():
    response = displacement_response(1e-3, 0.25, 5.0, timing=hold_timing(1e-3, 0.0, 2e-4, 0.0))
    assert renderable_by_hand_force(response, 0, 8.0) < renderable_by_hand_force(
        displacement_response(1e-3, 0.25, 5.0), 0, 8.0
    )
    stiffness = renderable_by_hand_speed(0.5, 1e-3, 1, 8.0)
    assert 8.0**2 / (2.0 * stiffness) == pytest.approx(2.0 * 8.0 * 0.5 * 1e-3)
