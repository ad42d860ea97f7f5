"""Certificates of torques that come late or are lost, against their formulas written anew and solved by bisection."""

import math

import pytest

from canhaptic.control.certificates.certified_torque import (
    Declared,
    LateMotion,
    TorqueBound,
    bound_memory,
    budget_for_any_hand,
    free_of_late_torques,
    largest_of_late_torques,
    taken_under_way,
    torque_by_late_reach,
)
from canhaptic.control.certificates.scalar_bounds import displacement_response, hold_timing
from canhaptic.kernels import list_of_zeros
from tests.control.late_formulas import (
    ANY,
    CASES,
    HELD_ON,
    MASS,
    SENT,
    Case,
    Motion,
    T,
    case_of,
    hand_of,
    hold,
    largest,
    largest_acting,
    same,
    tail,
    under_way,
)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_what_torques_under_way_take_is_the_least_of_four_bounds_in_every_hold(sign: float) -> None:
    for seed in CASES:
        case = case_of(seed)
        holds = case.known.delay + case.known.losses
        for speed in {0.0, case.known.hand_speed}:
            for which in (ANY, SENT, HELD_ON):
                count = holds if which == ANY else min(1, case.known.delay)
                total, worst, motion = taken_under_way(case.known, case.bound, case.memory, sign, speed, count, which)
                expected = under_way(case, sign, speed, count, which)
                assert same(total, expected[0]), seed
                assert same(worst, expected[1]), seed
                assert all(same(a, b) for a, b in zip(motion, expected[2], strict=True)), seed


def test_torques_under_way_may_need_more_than_they_take_in_the_end() -> None:
    """An older torque runs on while the axis goes inward, and the next one then takes energy in."""
    timing = hold_timing(T, 0.0, 3e-4, 0.0)
    response = displacement_response(T, MASS, 5.0, timing=timing)
    known = Declared(T, 2, 0, True, response, 0.0, 0.0, 0.0, timing.late, timing.late / T, timing.left)
    bound = TorqueBound(displacement=-1e-4, torque=3.0, most=3.0, highest=3.0, lowest=3.0)
    total, worst, _ = taken_under_way(
        known, bound, bound_memory(known, [0.0, 2.0, 0.0], list_of_zeros), 1.0, 0.0, 2, ANY
    )
    first = taken_under_way(known, bound, bound_memory(known, [0.0, 2.0, 0.0], list_of_zeros), 1.0, 0.0, 1, ANY)[0]
    assert worst == first > 0.0 > total


def squares(case: Case, holds: int) -> float:
    """Sum of n^2 (T + theta) over the holds, and the tail of what acted before, for torques along either direction."""
    known = case.known
    found = known.late * max(0.0, case.bound.highest - known.friction, -case.bound.lowest - known.friction) ** 2
    for number in range(1, holds + 1):
        most = max(0.0, *largest_acting(case, 1.0, number), *largest_acting(case, -1.0, number))
        found += (known.sample_time + known.late) * max(0.0, most - known.friction) ** 2
    return found


def left_for_all(case: Case, energy: float, holds: int) -> float:
    needed = squares(case, holds)
    if needed == 0.0:
        return energy
    return energy - needed / (4.0 * case.known.damping) if case.known.damping > 0.0 else -math.inf


def certain_dissipation(case: Case) -> float:
    return min(case.bound.certain, case.bound.dissipated)


def test_a_hand_of_which_nothing_is_known_takes_the_squares_of_all_torques_beyond_friction() -> None:
    for seed in CASES:
        case = case_of(seed)
        for holds in (case.known.delay, case.known.delay + case.known.losses):
            found = budget_for_any_hand(case.known, case.bound, case.memory, case.energy, holds)
            assert same(found, left_for_all(case, case.energy, holds)), seed


def test_free_is_what_torques_under_way_in_both_directions_leave_by_the_better_of_two_ways() -> None:
    for seed in range(400):
        case = case_of(seed)
        known, holds, ways = case.known, case.known.delay + case.known.losses, [0.0]
        if known.by_hand_force or known.hand_speed > 0.0:
            left = case.energy + case.bound.dissipated
            ways.append(left - sum(under_way(case, sign, known.hand_speed, holds, ANY)[1] for sign in (1.0, -1.0)))
        if known.damping > 0.0 or known.friction > 0.0:
            ways.append(left_for_all(case, case.energy + certain_dissipation(case), holds))
        assert same(free_of_late_torques(known, case.bound, case.memory, case.energy), max(ways)), seed


def takes(case: Case, motion: Motion, torque: float, hand: float, friction: float) -> float:
    """What a torque takes by A, or by B, in the next hold and in its tail."""
    law = "A" if friction == 0.0 else "B"
    following, taken = hold(case, motion, torque, torque, hand, 0.0, law)
    net = max(0.0, following.highest - friction)
    return taken + (net * tail(case, following, following.highest, hand) if case.known.late else 0.0)


@pytest.mark.slow_but("1.0")
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_largest_torque_takes_all_that_is_left_by_the_best_of_the_certificates(sign: float) -> None:
    """Without losses. Below the older torques, while the axis moves inward, some of what is left is not used."""
    tight = 0
    for seed in range(250):
        case = case_of(seed, losses=(0,))
        known = case.known
        by_all, for_all, by_force = largest_of_late_torques(known, case.bound, case.memory, sign, case.energy)
        left = max(0.0, left_for_all(case, case.energy + certain_dissipation(case), known.delay))
        longest = known.sample_time + known.late
        assert same(for_all, known.friction + math.sqrt(4.0 * known.damping * left / longest)), seed
        expected, is_tight = for_all, True
        if known.by_hand_force:
            best, is_tight = best_of(case, sign, 0.0)
            expected = max(expected, best)
        assert within(by_force, expected, is_tight=is_tight), seed
        tight += is_tight
        if known.hand_speed > 0.0:
            best, also_tight = best_of(case, sign, known.hand_speed)
            assert within(by_all, max(expected, best), is_tight=is_tight and also_tight), seed
        else:
            assert by_all == by_force
    assert tight > 150


def within(found: float, expected: float, *, is_tight: bool) -> bool:
    return found <= expected * (1.0 + 1e-6) + 1e-9 and (found >= expected * (1.0 - 1e-6) - 1e-9 or not is_tight)


def best_of(case: Case, sign: float, speed: float) -> tuple[float, bool]:
    """The largest torque for a hand of bounded force, speed, or both, and whether it is the exact one."""
    known, hand = case.known, hand_of(case, sign)
    against = under_way(case, -sign, speed, known.delay, ANY)[1]
    given, _, motion = under_way(case, sign, speed, known.delay, ANY)
    budget = case.energy + case.bound.dissipated - against - given
    older, longest = max(0.0, motion.highest - known.friction), known.sample_time + known.late
    found, is_tight = [known.friction], True
    if hand < math.inf and budget < 0.0:
        return math.inf, False  # a debt: `test_late_sum` has it
    if hand < math.inf:
        for friction in {0.0, known.friction}:
            found.append(largest(lambda torque, f=friction: takes(case, motion, torque, hand, f), budget))
        is_tight = max(found) >= motion.highest or motion.moved >= 0.0
    if budget > 0.0 and known.damping > 0.0:
        rest = 4.0 * known.damping * budget - known.late * older**2
        found.append(known.friction + math.sqrt(max(0.0, rest) / longest))
    if budget > 0.0 and speed > 0.0:
        found.append(known.friction + (budget / speed - known.late * older) / longest)
    return max(found), is_tight


def for_speed(case: Case, sign: float) -> None:
    """By the hand's speed alone a torque that may be held on takes as much in each of the holds."""
    known, speed = case.known, case.known.hand_speed
    holds = known.delay + (known.losses + 1 if known.late else 0)
    left = case.energy + case.bound.dissipated - under_way(case, -sign, speed, holds, ANY)[1]
    found = []
    for which in (SENT, HELD_ON) if known.delay == 1 else (ANY,):
        given, _, motion = under_way(case, sign, speed, known.delay, which)
        longest = (known.sample_time + known.late) * (known.losses + 1)
        found.append(max(0.0, ((left - given) / speed - known.late * motion.highest) / longest))
    assert same(largest_of_late_torques(known, case.bound, case.memory, sign, case.energy)[0], min(found))


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_where_frames_may_be_lost_the_least_of_what_was_sent_and_held_on_counts(sign: float) -> None:
    used = 0
    for seed in range(250):
        case = case_of(seed, losses=(1, 3))
        known, hand = case.known, hand_of(case, sign)
        if known.friction or known.damping:
            continue
        if not known.by_hand_force and known.hand_speed:
            used += 1
            for_speed(case, sign)
        if not known.by_hand_force or hand == math.inf:
            continue
        holds = known.delay + (known.losses + 1 if known.late else 0)
        left = case.energy + case.bound.dissipated - under_way(case, -sign, 0.0, holds, ANY)[1]
        found = []
        for which in (SENT, HELD_ON) if known.delay == 1 else (ANY,):
            given, _, motion = under_way(case, sign, 0.0, known.delay, which)
            found.append(torque_by_late_reach(known, hand, LateMotion(*motion), 0.0, left - given))
        by_force = largest_of_late_torques(known, case.bound, case.memory, sign, case.energy)[2]
        assert by_force == pytest.approx(min(found), rel=1e-9), seed
        used += 1
    assert used > 5
