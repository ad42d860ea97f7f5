"""Lost samples, the energy before a contact and the surplus of a hold, against sums and searches written anew."""

import math
import random

import pytest

from canhaptic.control.certificates.scalar_bounds import (
    displacement_response,
    hand_force_bound,
    hold_timing,
    start_energy,
)
from canhaptic.control.environments.damper_wall import DamperWall
from canhaptic.control.environments.spring_damper_wall import SpringDamperWall
from canhaptic.control.multi_axis.group_account import Gap, farthest, uncertainty_of
from canhaptic.control.passivity import LoopProperties
from canhaptic.control.passivity.guarded import Guarded, GuardedParameters
from canhaptic.control.passivity.stepped import (
    Axis,
    AxisMemory,
    Commands,
    Hold,
    HoldAccount,
    HoldSettings,
    begin,
    open_hold,
    settle,
    surplus_after,
)

T, MASS, PULL = 1e-3, 0.25, 5.0


def least_sum(gap: Gap, hold: int, farthest_one: float) -> float:
    """The least displacement in all holds if one goes so far: before and after it each falls back as far as it can."""
    first = gap.start - gap.position_uncertainty
    falls = gap.step + gap.lost * max(0.0, first)
    total = sum(first - k * falls for k in range(1, hold))
    for later in range(gap.holds - hold + 1):
        kept = (1.0 - gap.lost) ** later if farthest_one > 0.0 else 1.0
        total += farthest_one * kept - later * gap.step
    return total


@pytest.mark.parametrize("lost", [0.0, 0.1])
def test_the_farthest_hold_of_a_gap_leaves_no_less_than_was_moved_in_all(lost: float) -> None:
    for seed in range(60):
        draw = random.Random(seed)
        holds = draw.choice([2, 3, 6])
        gap = Gap(
            holds, draw.uniform(-1e-4, 1e-4), draw.uniform(-3e-5, 3e-5), draw.choice([0.0, 1e-6]),
            draw.choice([0.0, 2e-6]), draw.uniform(0.0, 1e-5), lost,
        )  # fmt: skip
        mirrored = gap._replace(moved=-gap.moved, start=-gap.start)
        for hold in range(1, holds):
            found = farthest(gap, 1.0, hold, along=False)
            assert least_sum(gap, hold, found) == pytest.approx(gap.moved + gap.error, abs=1e-15), seed
            assert farthest(mirrored, -1.0, hold, along=False) == found
            first = gap.start + gap.position_uncertainty
            reach = first + hold * (gap.step + lost * max(0.0, -first))
            assert farthest(gap, 1.0, hold, along=True) == pytest.approx(reach, abs=1e-18)
            assert farthest(mirrored, -1.0, hold, along=True) == pytest.approx(reach, abs=1e-18)


def test_what_a_torque_more_or_less_in_a_lost_hold_gives_out_is_its_difference_over_the_farthest_way() -> None:
    gap = Gap(3, 4e-5, 1e-5, 1e-6, 2e-6, 1e-5, 0.1)
    for torque in (-3.0, -0.5, 0.0, 0.5, 3.0):
        for last in (-1.0, 0.0, 1.0, torque):
            more = torque - last
            sign = 1.0 if more > 0.0 else -1.0
            expected = abs(more) * farthest(gap, sign, 2, along=torque * sign > 0.0)
            assert uncertainty_of(gap, 2, torque, last) == pytest.approx(expected, abs=1e-18)


@pytest.mark.parametrize("delay", [0, 1, 2])
@pytest.mark.parametrize("window", [0.0, 2e-4])
def test_a_contact_needs_what_the_most_dangerous_force_on_the_way_in_lacks(delay: int, window: float) -> None:
    response = displacement_response(T, MASS, PULL, 0.2, 0.5, timing=hold_timing(T, 0.01, window, 5e-5))
    stiffness = 0.1 / ((delay + 1) * (delay + 2) * response.during)

    def lacking(force: float) -> float:
        moved = energy = 0.0
        for _ in range(delay + 1):
            moved = response.growth * moved + (response.before + response.during) * force + response.hand
            energy += force * moved
        tail = response.share * moved + (response.tail_before + response.tail_during) * force
        tail += response.tail_hand * response.hand
        return energy + force * tail - force**2 / (2.0 * stiffness)

    low, high = 0.0, 1e3
    for _ in range(200):
        one, two = low + (high - low) / 3.0, high - (high - low) / 3.0
        low, high = (one, high) if lacking(one) < lacking(two) else (low, two)
    assert start_energy(response, delay, stiffness) == pytest.approx(lacking(low), rel=1e-6)
    assert lacking(low) > 0.0
    assert start_energy(response, delay, 1e12) == math.inf
    assert start_energy(displacement_response(T, MASS, 0.0), delay, 1e12) == 0.0


@pytest.mark.parametrize("gain", [0.0, 2e-6])
def test_the_largest_share_of_an_inward_motion_is_without_end_only_without_a_gain(gain: float) -> None:
    assert (hand_force_bound(1e-3, -1e-4, gain) == math.inf) is (gain == 0.0)
    assert (hand_force_bound(0.0, 0.0, gain) == math.inf) is (gain == 0.0)


def test_the_surplus_after_a_hold_is_what_was_created_less_what_was_recovered_and_paid() -> None:
    for seed in range(80):
        draw = random.Random(seed)
        before, h_pas = draw.uniform(-1.0, 2.0), draw.uniform(-1.0, 1.0)
        gen, deficit, leak = (draw.choice([0.0, draw.uniform(0.0, 1.0)]) for _ in range(3))
        hold = Hold(0.0, 0.0, 0.0, h_pas, T, 0.0, 0.0, 0)
        surplus, paid = surplus_after(Axis(h_dis=before), hold, HoldAccount(0, 0.0, gen, deficit, leak))
        owed = before + gen + deficit - h_pas
        assert paid == pytest.approx(min(leak, max(0.0, owed)))
        assert surplus == pytest.approx(owed - paid)


def test_a_hold_is_settled_without_giving_up_what_the_certificates_need() -> None:
    for seed in range(300):
        draw = random.Random(seed)
        stored, surplus, lost = draw.uniform(-1.0, 2.0), draw.uniform(-0.5, 1.0), draw.uniform(-0.5, 1.0)
        ceiling, slack = draw.uniform(0.0, 1.5), draw.uniform(-0.5, 1.5)
        slack = min(slack, stored)
        h_s, rest, h_r, deficit, leak, paid = settle(stored, surplus, lost, ceiling, slack)
        assert h_s == pytest.approx(stored - h_r + deficit - leak, abs=1e-12)
        assert rest == pytest.approx(surplus + deficit - paid, abs=1e-12)
        free, owed = max(0.0, slack), max(0.0, surplus)
        assert h_r == pytest.approx(max(0.0, min(lost, free)))
        after = stored - h_r
        assert deficit == pytest.approx(max(0.0, -after))
        above = max(0.0, after - ceiling) if after >= 0.0 else 0.0
        assert leak == pytest.approx(min(above, owed + free - h_r), abs=1e-12)
        assert paid == pytest.approx(min(leak, owed))


def test_a_torque_that_was_cut_has_as_much_less_of_its_damper_in_it() -> None:
    """What the damper of a wall dissipates in a hold is its part of the torque applied, times the displacement."""
    lost = []
    for share in (1.0, 0.25):
        loop = LoopProperties(sample_time=T, delay=0, moving_mass=MASS, device_damping_bound=0.2)
        wall = SpringDamperWall(stiffness=500.0, damping=4.0, position=0.0)
        one, torque = Guarded(wall, GuardedParameters(hand_force=0.0), loop), 0.0
        for place in (1e-4, -1e-3, -2e-3):
            torque = one.step(place, torque).torque
        lost.append(one.step(-2.2e-3, share * torque).h_r)
    assert lost[0] > 1e-5
    assert lost[1] == pytest.approx(0.25 * lost[0])


def test_the_timing_of_holds_is_what_is_declared_of_them() -> None:
    timing = hold_timing(T, 0.02, 1e-4, 5e-5)
    assert (timing.shortest, timing.longest) == pytest.approx((0.98 * T, 1.02 * T))
    assert timing.late == pytest.approx(1.5e-4)
    assert timing.left == pytest.approx(math.exp(-(0.98e-3 - 1e-4) / 5e-5))
    assert hold_timing(T, 0.02, 1e-4, 0.0).left == 0.0


def test_beyond_half_a_time_constant_the_torque_before_counts_as_without_damping() -> None:
    for damping, is_damped in ((0.4 * MASS / T, True), (0.6 * MASS / T, False), (1.4 * MASS / T, False)):
        before = displacement_response(T, MASS, PULL, damping, damping).before
        undamped = pytest.approx(0.5 * T * T / MASS)
        assert (before < 0.95 * 0.5 * T * T / MASS) if is_damped else (before == undamped)


def test_over_lost_samples_no_effort_inside_a_torque_is_known() -> None:
    loop = LoopProperties(sample_time=T, delay=0, moving_mass=MASS, device_damping_bound=0.2)
    one = Guarded(DamperWall(damping=20.0, position=0.0), GuardedParameters(hand_force=0.0), loop)
    torque = 0.0
    for place in (1e-4, -1e-4, -2e-4):
        torque = one.step(place, torque).torque
    one.sample_lost()
    balance = one.step(-4e-4, torque)
    assert torque > 0.5
    assert (balance.h_pas, balance.h_r) == (0.0, 0.0)


@pytest.mark.parametrize("tolerance", [0.0, 1e-6])
def test_the_velocity_of_a_hold_is_its_own_or_that_of_a_window(tolerance: float) -> None:
    settings = HoldSettings(T, 0, math.inf, tolerance, 8 if tolerance else 0, 4)
    axis, memory = Axis(), AxisMemory([0.0] * (9 if tolerance else 0), Commands([0.0], [0.0], [0.0]))
    begin(axis, memory, 0.0)
    for place in (0.4e-6, 0.8e-6, 1.0e-6):
        found = open_hold(settings, axis, memory, place, 0.0)
    assert found.velocity == pytest.approx(1.0e-6 / (3 * T) if tolerance else 0.2e-6 / T)
