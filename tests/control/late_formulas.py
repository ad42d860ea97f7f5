"""Certificates of torques that come late or are lost, written anew: random cases, and what torques take in a hold."""

import math
import random
from typing import NamedTuple

from canhaptic.control.certificates.certified_torque import BoundMemory, Declared, TorqueBound, bound_memory
from canhaptic.control.certificates.scalar_bounds import NO_RESPONSE, displacement_response, hold_timing
from canhaptic.kernels import list_of_zeros

T, MASS = 1e-3, 0.25
ANY, SENT, HELD_ON = 0, 1, 2
CASES = range(80)


class Case(NamedTuple):
    """An axis, the hold that ended, torques under way, and how certain each certificate is."""

    known: Declared
    bound: TorqueBound
    memory: BoundMemory
    energy: float
    lag_share: float  # of an older torque that counts in the hold of a new one


def case_of(seed: int, losses: tuple[int, ...] = (0, 1, 3)) -> Case:
    draw = random.Random(seed)
    damping, friction = draw.choice([0.0, 0.3, 8.0]), draw.choice([0.0, 0.7])
    by_force, delay = draw.random() < 0.7, draw.choice([0, 1, 2])
    timing = hold_timing(T, draw.choice([0.0, 0.03]), draw.choice([0.0, 1e-4, 3e-4]), draw.choice([0.0, 8e-5]))
    response = NO_RESPONSE
    if by_force:
        push = draw.choice([9.0, math.inf])
        response = displacement_response(T, MASS, 5.0, damping, 2.0 * damping + 0.1, push, timing)
    speed = draw.choice([0.0, 0.0, 0.2])
    lost = draw.choice(losses)
    known = Declared(
        timing.longest, delay, lost, by_force, response, damping, speed, 0.0, timing.late,
        timing.late / timing.shortest, timing.left, friction,
    )  # fmt: skip
    way = [draw.choice([0.0, draw.uniform(-1.0, 3.0), draw.uniform(0.0, 3.0)]) for _ in range(delay)]
    before = draw.choice([0.0, draw.uniform(-2.0, 3.0)])
    bound = TorqueBound(
        displacement=draw.uniform(-6e-5, 6e-5), torque=before, position_uncertainty=draw.choice([0.0, 1e-6])
    )
    bound.out, bound.turns = draw.choice([1.0, -1.0, 0.0]), draw.choice([False, False, True])
    bound.highest, bound.lowest = before + draw.choice([0.0, 0.8]), before - draw.choice([0.0, 0.8])
    bound.most, bound.least = 0.5 * (bound.highest + before), 0.5 * (bound.lowest + before)
    bound.dissipated = draw.uniform(0.0, 2e-3)
    bound.certain = bound.dissipated - draw.choice([-1e-4, 1e-4])
    memory = bound_memory(known, [*way, 0.0], list_of_zeros)
    energy = draw.choice([draw.uniform(0.0, 2e-3), draw.uniform(-3e-4, 1e-4)])
    return Case(known, bound, memory, energy, min(1.0, 2.0 * known.late_share) if by_force else 0.0)


class Motion(NamedTuple):
    """Farthest displacement, the torque that counts in it, and the extremes that act at its end."""

    moved: float
    counted: float
    highest: float
    lowest: float


def hand_of(case: Case, sign: float) -> float:
    """By the hand in two holds: it pushes against the way out of the contact; after a turn either way."""
    if not case.known.by_hand_force:
        return math.inf
    pushes = sign == -case.bound.out or case.bound.turns
    return case.known.response.push if pushes else case.known.response.hand


def after(case: Case, moved: float, before: float, now: float, hand: float) -> float:
    """Displacement in the next hold: D_1 = r D_0 and what both torques and the hand add."""
    response = case.known.response
    kept = response.growth if moved > 0.0 else response.retained
    return kept * moved + response.before * max(0.0, before) + response.during * max(0.0, now) + hand


def tail(case: Case, motion: Motion, highest: float, hand: float) -> float:
    """X of (2)."""
    r = case.known.response
    reach = r.share * max(0.0, motion.moved) + r.tail_before * max(0.0, motion.counted)
    return reach + r.tail_during * highest + r.tail_hand * hand


def hold(
    case: Case, motion: Motion, most: float, least: float, hand: float, speed: float, law: str = "ABCD"
) -> tuple[Motion, float]:
    """The motion in the next hold, and the least of A to D."""
    known, theta = case.known, case.known.late
    counted = most + case.lag_share * max(0.0, motion.highest - most)
    moved = after(case, motion.moved, motion.counted, counted, hand) if hand < math.inf else math.inf
    found = []
    for name, friction in (("A", 0.0), ("B", known.friction)):
        if name in law and hand < math.inf:
            up, low, old, oldest = (max(0.0, u - friction) for u in (most, least, motion.highest, motion.lowest))
            energy = (up if moved > 0.0 else low) * moved
            energy += max(0.0, old - low) * tail(case, motion, max(most, motion.highest), hand)
            energy += max(0.0, up - oldest) * min(known.response.share, known.response.retained) * max(
                0.0, -motion.moved
            )  # fmt: skip
            found.append(energy)
    net, old = (max(0.0, u - known.friction) for u in (most, motion.highest))
    if "C" in law and net == old == 0.0:
        found.append(0.0)
    elif "C" in law and known.damping > 0.0:
        found.append((net**2 * known.sample_time + theta * max(0.0, old**2 - net**2)) / (4.0 * known.damping))
    if "D" in law and speed > 0.0:
        found.append(speed * (net * known.sample_time + theta * max(0.0, old - net)))
    left = known.left
    next_motion = Motion(
        moved, counted, most + left * max(0.0, motion.highest - most), least - left * max(0.0, least - motion.lowest)
    )
    return next_motion, min(found, default=math.inf)


def last_tail(case: Case, motion: Motion, hand: float, speed: float, law: str = "ABCD") -> float:
    """What the torque that is the last of all takes after its hold."""
    known, net = case.known, motion.highest - case.known.friction
    if law == "A":
        return motion.highest * tail(case, motion, motion.highest, hand) if known.late else 0.0
    if net <= 0.0 or known.late == 0.0:
        return 0.0
    found = [net * tail(case, motion, motion.highest, hand)] if hand < math.inf else []
    if known.damping > 0.0:
        found.append(known.late * net**2 / (4.0 * known.damping))
    if speed > 0.0:
        found.append(speed * known.late * net)
    return min(found, default=math.inf)


def start(case: Case, sign: float) -> Motion:
    bound, known = case.bound, case.known
    ends = (bound.highest, bound.lowest) if sign > 0.0 else (-bound.lowest, -bound.highest)
    counted = sign * bound.torque
    if known.late > 0.0:
        counted = bound.most if sign > 0.0 else -bound.least
    moved = sign * bound.displacement + bound.position_uncertainty if hand_of(case, sign) < math.inf else math.inf
    return Motion(moved, max(0.0, counted), max(0.0, ends[0]), max(0.0, ends[1]))


def largest_acting(case: Case, sign: float, number: int) -> list[float]:
    """Torques along that may act in a hold: the one sent for it, and those before it that losses let stay."""
    sent = [case.bound.torque, *case.memory.under_way[: case.known.delay]]
    last = min(number, case.known.delay)
    return [sign * torque for torque in sent[max(0, number - case.known.losses) : last + 1]]


def under_way(case: Case, sign: float, speed: float, holds: int, which: int) -> tuple[float, float, Motion]:
    """Sum, worst partial sum with the tail, and the last motion."""
    hand, motion, total, worst = hand_of(case, sign), start(case, sign), 0.0, 0.0
    for number in range(1, holds + 1):
        acting = largest_acting(case, sign, number)
        if which != ANY:
            acting = [sign * (case.memory.under_way[0] if which == SENT else case.bound.torque)]
        most, least = max(0.0, *acting, 0.0), max(0.0, min(acting, default=0.0))
        motion, taken = hold(case, motion, most, least, hand, speed)
        total += taken
        worst = max(worst, total)
    return total, max(worst, total + last_tail(case, motion, hand, speed)), motion


def same(found: float, expected: float) -> bool:
    return found == expected or math.isclose(found, expected, rel_tol=1e-9, abs_tol=1e-15)


def largest(needed, budget: float) -> float:
    """Returns the end of the torques of which none needs more than a budget, by bisection."""
    low, high = 0.0, 1e-3
    while needed(high) <= budget and high < 1e4:
        low, high = high, 2.0 * high
    for _ in range(80):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if needed(middle) <= budget else (low, middle)
    return low
