"""Torques that a program asks for: no more comes out than came in, and what is certified is not cut."""

from itertools import accumulate
from math import inf

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canhaptic.control.balance import Certificate, residual
from canhaptic.control.damping import DamperVelocity
from canhaptic.control.passivity import LoopProperties
from canhaptic.control.passivity.asked_torque import GuardedProgram, UnguardedProgram
from canhaptic.control.passivity.guarded import GuardedParameters

T, MASS = 1e-3, 0.25
ASKED = st.lists(st.floats(-50.0, 50.0) | st.sampled_from([0.0, 1e300, -1e300]), min_size=2, max_size=60)


def ran(controller, asked, delay, velocity, push=0.0, position=0.0):
    """The balances of a run on a free mass that a hand pushes with a constant force; exact between two SYNCs."""
    under_way, balances, torque = [0.0] * delay, [], 0.0
    for request in asked:
        controller.ask(request)
        balance = controller.step(position, torque)
        balances.append(balance)
        under_way.append(balance.torque)
        torque = under_way.pop(0)
        force = torque + push
        position += velocity * T + 0.5 * force / MASS * T * T
        velocity += force / MASS * T
    return balances


def guarded(delay=0, **given_parameters):
    loop = LoopProperties(
        sample_time=T, delay=delay, moving_mass=0.2, device_damping_bound=0.0, torque_limit=40.0, torque_quantum=0.01
    )
    return GuardedProgram(GuardedParameters(**{"hand_push": 10.0, **given_parameters}), loop)


@given(asked=ASKED, delay=st.integers(0, 2), velocity=st.floats(-1.0, 1.0), push=st.floats(-10.0, 10.0))
def test_no_program_gets_out_more_than_came_in(asked, delay, velocity, push):
    balances = ran(guarded(delay, hand_force=10.0), asked, delay, velocity, push)
    assert min(accumulate(balance.h_i for balance in balances)) >= -1e-13
    before = 0.0
    for balance in balances:
        assert abs(residual(balance, before)) <= 1e-12 * max(1.0, abs(before))
        before = balance.h_s
        assert abs(balance.torque) <= 40.0


def test_without_a_guard_it_does():
    loop = LoopProperties(sample_time=T)
    balances = ran(UnguardedProgram(DamperVelocity(), loop), [2.0] * 20, 0, 0.5)
    assert sum(balance.h_i for balance in balances) < -0.01
    assert {balance.certificate for balance in balances[1:]} == {Certificate.NONE}


def test_what_came_in_can_be_given_back_as_it_was_asked_for():
    balances = ran(guarded(), [0.0] + [-5.0] * 30 + [-4.0] * 10, 0, 0.5)
    assert [balance.torque for balance in balances[1:]] == [-5.0] * 30 + [-4.0] * 10
    assert balances[-1].h_s < max(balance.h_s for balance in balances)


@pytest.mark.parametrize(("size", "kept"), [(None, inf), (0.01, 0.01)])
def test_the_tank_is_as_large_as_it_was_declared(size, kept):
    balances = ran(guarded(earned_energy=size), [-5.0] * 20, 0, 1.0)
    came_in = sum(balance.h_i for balance in balances)
    assert came_in > 0.05
    assert balances[-1].h_s == pytest.approx(min(came_in, kept), rel=0.2)


def test_the_velocity_is_that_of_a_line_through_the_last_counts():
    controller = guarded()
    found = [controller.velocity(0.3 * T * k, 1 if k else 0) for k in range(50)]
    assert found[0] == 0.0
    assert found[-1] == pytest.approx(0.3)
    assert controller.velocity(0.3 * T * 53, 4) == pytest.approx(0.3)


def test_where_the_axis_is_at_the_start_makes_no_difference():
    asked = [0.0, 2.0, -3.0, 4.0, 1.0] * 6
    torques = [[each.torque for each in ran(guarded(1, hand_force=2.0), asked, 1, 0.1, 2.0, at)] for at in (0.0, 4.0)]
    assert torques[1] == pytest.approx(torques[0], abs=0.011)
    assert max(map(abs, torques[0])) > 0.1


@pytest.mark.parametrize("position", [0.0, 3.0])
def test_the_first_position_begins_the_account_and_asks_for_no_torque(position):
    first, second = ran(guarded(hand_force=2.0, energy_allowance=0.01), [2.0, 2.0], 0, 0.0, position=position)
    assert (first.torque, first.h_i) == (0.0, 0.0)
    assert second.torque == pytest.approx(2.0, abs=0.02)
