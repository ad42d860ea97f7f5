"""The hand-force certificate where a torque comes late: each step of the proof is in `hold_timing`."""

from typing import NamedTuple

from canhaptic.control.certificates.scalar_bounds import (
    DisplacementResponse,
    hand_force_bound,
    next_displacement,
    tail_reach,
)
from canhaptic.control.certificates.torque_bound import (
    BoundMemory,
    Declared,
    TorqueBound,
    acted,
    hand_along,
    may_act,
    outward,
)
from canhaptic.kernels import Buffer, new


class LateMotion(NamedTuple):
    """How far the axis can have moved along the torque by the end of a hold, and what acts in it."""

    displacement: float  # in that hold [m or rad]
    counted: float  # torque that counts as held in it, >= 0 [N or N*m]
    highest: float  # torque along that acts at its end at most, >= 0 [N or N*m]
    lowest: float  # at least, >= 0; 0 where one acts against


def motion_along(declared: Declared, bound: TorqueBound, memory: BoundMemory, sign: float) -> LateMotion:
    """Returns the motion along `sign` in the hold that ended."""
    highest, lowest = (bound.highest, bound.lowest) if sign > 0.0 else (-bound.lowest, -bound.highest)
    displacement = outward(declared, bound, memory, sign)
    counted = max(0.0, acted(declared, bound, sign))
    return new(LateMotion, (displacement, counted, max(0.0, highest), max(0.0, lowest)))


def pass_hold(
    declared: Declared, hand: float, motion: LateMotion, torque: float, least: float
) -> tuple[LateMotion, float, float]:
    """Returns the motion in the next hold, and the most energy that older torques and its own give out in it [J].

    Args:
        declared: Of the axis.
        hand: Displacement by the hand [m or rad].
        motion: Of the hold before.
        torque: Along, held in the next one; one against counts as 0 [N or N*m].
        least: The least that may be held in its place, >= 0 [N or N*m].
    """
    response, early, own = declared.response, 0.0, 0.0
    displacement, before, highest, lowest = motion
    acting = torque if torque > 0.0 else 0.0
    counted = newest = acting
    excess, lacking, oldest = highest - acting, acting - lowest, acting
    if excess > 0.0:
        counted += response.late * excess
        newest += declared.left * excess
    if highest > least:
        early = (highest - least) * tail_reach(displacement, before, highest, response, hand)
    following = next_displacement(displacement, before, counted, response, hand)
    if acting > 0.0:
        own = acting * following
    if lacking > 0.0:
        oldest -= declared.left * lacking
        if displacement < 0.0:
            own -= lacking * response.behind * displacement
    return new(LateMotion, (following, counted, newest, oldest)), early, own


def tail_of(declared: Declared, hand: float, motion: LateMotion) -> float:
    """Returns the most energy that the torques along give out after a hold that is the last of all [J]."""
    if motion.highest == 0.0:
        return 0.0
    return motion.highest * tail_reach(motion.displacement, motion.counted, motion.highest, declared.response, hand)


def worst_out_late(
    declared: Declared, bound: TorqueBound, memory: BoundMemory, sign: float, torques: Buffer, first: int, count: int
) -> float:
    """Returns `worst_out`, with the tail of the last torque [J]."""
    motion, hand = motion_along(declared, bound, memory, sign), hand_along(declared, bound, sign)
    acts = motion.highest > 0.0
    for place in range(first, first + count):
        if sign * torques[place] > 0.0:
            acts = True
    if not acts:
        return 0.0
    worst = total = 0.0
    for place in range(first, first + count):
        along = sign * torques[place]
        motion, early, own = pass_hold(declared, hand, motion, along, max(0.0, along))
        total += early + own
        worst = max(worst, total)
    return max(worst, total + tail_of(declared, hand, motion))


def by_hand_force_late(
    declared: Declared, bound: TorqueBound, memory: BoundMemory, sign: float, energy: float, torques: Buffer, first: int
) -> float:
    """Returns `by_hand_force` where torques come late [N or N*m]."""
    motion, hand = motion_along(declared, bound, memory, sign), hand_along(declared, bound, sign)
    energy -= worst_out_late(declared, bound, memory, -sign, torques, first, declared.delay)
    for place in range(first, first + declared.delay):
        along = sign * torques[place]
        motion, early, own = pass_hold(declared, hand, motion, along, max(0.0, along))
        energy -= early + own
    largest = above_older(declared, hand, motion, energy)
    if largest >= motion.highest:
        return largest
    return min(motion.highest, below_older(declared, hand, motion, energy))


def above_older(declared: Declared, hand: float, motion: LateMotion, energy: float) -> float:
    """Returns the largest torque as if it were no smaller than the older ones [N or N*m].

    It gives out F D + (F - l) x and its tail F X, with D = base + during F the displacement in its hold.

    Args:
        declared: Of the axis.
        hand: Displacement by the hand [m or rad].
        motion: Of the hold before.
        energy: That may be taken out [J].
    """
    response, displacement = declared.response, motion.displacement
    base = next_displacement(displacement, motion.counted, 0.0, response, hand)
    late = -response.behind * displacement if displacement < 0.0 else 0.0
    start = base + late + response.tail_hand * hand
    gain = response.during + response.tail_before + response.tail_during
    energy += motion.lowest * late
    share = response.share
    largest = hand_force_bound(energy, start + share * base, gain + share * response.during)
    return largest if base >= 0.0 else min(largest, hand_force_bound(energy, start, gain))


def below_older(declared: Declared, hand: float, motion: LateMotion, energy: float) -> float:
    """Returns the largest torque as if it were smaller than the older ones [N or N*m].

    With g the largest of these it gives out F D + (g - F) X_0 + (F - l) x and the tail G X, where
    D = base + during (late g + (1 - late) F), G = c g + (1 - c) F, and (F - l) x is at most F (g - l) x / g.
    All is convex in F and joins `above_older` at F = g. Arguments as there.
    """
    response, left = declared.response, declared.left
    displacement, before, highest, lowest = motion
    early = tail_reach(displacement, before, highest, response, hand)
    base = next_displacement(displacement, before, response.late * highest, response, hand)
    gain = response.during * (1.0 - response.late)
    late = 0.0
    if displacement < 0.0:
        late = -response.behind * displacement * ((highest - lowest) / highest)
    rest = left * highest
    ahead = response.tail_before * response.late * highest + response.tail_during * rest + response.tail_hand * hand
    rise = response.tail_before * (1.0 - response.late) + response.tail_during * (1.0 - left)
    largest = -1.0
    for share in (0.0, response.share):  # of the displacement in the tail: counts where it is outward
        tail, more = ahead + share * base, rise + share * gain
        start = base - early + late + (1.0 - left) * tail + rest * more
        found = hand_force_bound(energy - highest * early - rest * tail, start, gain + (1.0 - left) * more)
        if largest < 0.0 or found < largest:
            largest = found
    return largest


def any_late(
    declared: Declared, bound: TorqueBound, memory: BoundMemory, sign: float, holds: int
) -> tuple[float, LateMotion]:
    """Returns what any mix of torques along `sign` may give out in so many holds [J], and the motion in the last.

    What one of them would take in is not counted: another, or none, may act in its place.
    """
    motion, hand = motion_along(declared, bound, memory, sign), hand_along(declared, bound, sign)
    total = 0.0
    for hold in range(1, holds + 1):
        motion = new(LateMotion, (motion.displacement, motion.counted, motion.highest, 0.0))
        along = may_act(declared, bound, memory, sign, hold)
        motion, early, own = pass_hold(declared, hand, motion, along, 0.0)
        total += early
        if own > 0.0:
            total += own
    return total, motion


def given_by_any_late(
    declared: Declared, bound: TorqueBound, memory: BoundMemory, sign: float, holds: int
) -> tuple[float, float]:
    """Returns `given_by_any` with the tail of the last torque; the base is that of no torque after it."""
    given, motion = any_late(declared, bound, memory, sign, holds)
    hand = hand_along(declared, bound, sign)
    base = next_displacement(motion.displacement, motion.counted, 0.0, declared.response, hand)
    return given + tail_of(declared, hand, motion), base


def largest_of_any(declared: Declared, bound: TorqueBound, memory: BoundMemory, sign: float, energy: float) -> float:
    """Returns the largest torque along `sign` where frames may be lost and torques come late [N or N*m].

    F acts in 1, 2, ... holds until another arrives. With D_i the displacements in them, g the older torques and X as
    in `hold_timing`, it gives out F sum(D_i) + g X_1 + c g sum(X_i) + F x and its tail (F + c g) X; each X_i after the
    first is at most that of the sum of all outward displacements. Where F is lost, the older torques stay: they were
    certified for that.
    """
    response, left, hand = declared.response, declared.left, hand_along(declared, bound, sign)
    given, motion = any_late(declared, bound, memory, sign, declared.delay)
    energy -= given + given_by_any_late(declared, bound, memory, -sign, declared.delay + declared.losses + 1)[0]
    displacement, before, older, _ = motion
    late = -response.behind * displacement if displacement < 0.0 else 0.0
    early = older * tail_reach(displacement, before, older, response, hand)
    base = next_displacement(displacement, before, response.late * older, response, hand)
    inward, largest = max(0.0, -base), -1.0
    for holds in range(1, declared.losses + 2):
        friction = (1.0 - response.retained) * inward
        start, gain, ahead = held_on_late(response, base, response.during, hand, friction, holds)
        reach = response.share * ahead + (response.tail_before + response.tail_during) * older
        reach += response.tail_hand * hand
        more = response.share * gain + response.tail_before + response.tail_during
        tail = left * older * holds
        start += late + left * (holds - 1) * response.behind * inward
        start += reach + older * response.tail_during + tail * more
        found = hand_force_bound(energy - early - tail * reach, start, gain + more)
        if largest < 0.0 or found < largest:
            largest = found
    return largest


def held_on_late(
    response: DisplacementResponse, base: float, gain: float, hand: float, friction: float, holds: int
) -> tuple[float, float, float]:
    """Returns the sum of the displacements in so many holds of one torque.

    Args:
        response: Of the axis.
        base: Displacement in the first hold without the torque [m or rad].
        gain: In the first hold per torque.
        hand: Displacement by the hand in two holds [m or rad].
        friction: What friction adds to an inward displacement in a hold at most [m or rad].
        holds: How many.

    Returns:
        Without the torque, per torque, and of the first only what is outward [m or rad, m/N or rad/(N*m), m or rad].
    """
    start, more, ahead = base, gain, max(0.0, base)
    for _ in range(1, holds):
        if base > 0.0:
            base *= response.growth
        base += hand + friction
        gain = response.growth * gain + response.before + response.during
        start += base
        more += gain
        if base > 0.0:
            ahead += base
    return start, more, ahead
