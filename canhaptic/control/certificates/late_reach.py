"""Largest torque after late torques, by the reach of the hand's force; see `late_torque`.

n is the part of a torque above f_c, which friction pays for: f_c is 0 for A, and that of the device for B.
"""

from math import inf
from typing import NamedTuple

from canhaptic.control.certificates.scalar_bounds import (
    DisplacementResponse,
    hand_force_bound,
    next_displacement,
    tail_reach,
)
from canhaptic.control.certificates.torque_bound import Declared


class LateMotion(NamedTuple):
    """Largest displacement along the torque by the end of a hold, and the torques that act in the hold."""

    displacement: float  # in that hold; infinite: the hand is unknown [m or rad]
    counted: float  # torque that counts as held in it, >= 0 [N or N*m]
    highest: float  # torque along that acts at its end at most, >= 0 [N or N*m]
    lowest: float  # at least, >= 0; 0 where one acts against


def by_reach_of_late(declared: Declared, hand: float, motion: LateMotion, friction: float, energy: float) -> float:
    """Largest part of a torque above `friction` by A, or by B where friction is not 0 [N or N*m].

    Args:
        declared: Declared properties of axis and hand.
        hand: Displacement by the hand [m or rad].
        motion: Motion in the last hold under way.
        friction: Friction, which pays for the rest of every torque [N or N*m].
        energy: Energy budget [J].
    """
    if declared.losses:
        return if_held_on(declared, hand, motion, friction, energy)
    largest = above_older(declared, hand, motion, friction, energy)
    older = motion.highest - friction
    if largest < older:
        largest = min(older, below_older(declared, hand, motion, friction, energy))
    return min(largest, takes_in(declared, hand, motion, friction, energy)) if energy < 0.0 else largest


def own_share(
    declared: Declared, hand: float, motion: LateMotion, friction: float
) -> tuple[float, float, float, float]:
    """Start and gain of n (start + gain n), the energy that a torque takes by itself, its base, and its late part.

    It takes n D + (n - l) x and its tail n X, with D = base + during F the displacement in its hold and F = n + f_c.
    The tail counts the displacement where it is outward: `start` is without that.
    """
    response, displacement = declared.response, motion.displacement
    base = next_displacement(displacement, motion.counted, 0.0, response, hand) + response.during * friction
    late = -response.behind * displacement if displacement < 0.0 else 0.0
    gain = response.during + response.tail_before + response.tail_during
    start = base + late + response.tail_hand * hand + (response.tail_before + response.tail_during) * friction
    return start, gain, base, late


def takes_in(declared: Declared, hand: float, motion: LateMotion, friction: float, energy: float) -> float:
    """Largest n that takes energy in by itself, limited to the debt [N or N*m].

    Older torques push the axis while it acts: as if all of `late` of them were held, and `left` of them after the hold.
    Below -start / gain the axis goes inward in the hold of the torque, so that its tail takes none of that motion.
    """
    response = declared.response
    start, gain, _, _ = own_share(declared, hand, motion, friction)
    start += (response.during + response.tail_before) * response.late * motion.highest
    start += response.tail_during * declared.left * motion.highest
    return hand_force_bound(energy, start, gain)


def above_older(declared: Declared, hand: float, motion: LateMotion, friction: float, energy: float) -> float:
    """Return the largest n as if it were no smaller than the older ones; arguments of `by_reach_of_late`."""
    start, gain, base, late = own_share(declared, hand, motion, friction)
    energy += max(0.0, motion.lowest - friction) * late
    share = declared.response.share
    largest = hand_force_bound(energy, start + share * base, gain + share * declared.response.during)
    return min(largest, hand_force_bound(energy, start, gain))


def below_older(declared: Declared, hand: float, motion: LateMotion, friction: float, energy: float) -> float:
    """Return the largest n as if it were smaller than the older ones.

    With g the largest of these above f_c it takes n D + (g - n) X_0 + (n - l) x and the tail G X, where
    D = base + during (late g + (1 - late) F), G = c g + (1 - c) n, and (n - l) x is at most n x (g - l) / g.
    All is convex in n and joins `above_older` at n = g. Arguments of `by_reach_of_late`.
    """
    response, left = declared.response, declared.left
    displacement, before, highest, lowest = motion
    older = highest - friction
    early = tail_reach(displacement, before, highest, response, hand)
    gain = response.during * (1.0 - response.late)
    base = next_displacement(displacement, before, response.late * highest, response, hand) + gain * friction
    late = 0.0
    if displacement < 0.0:
        late = -response.behind * displacement * ((older - max(0.0, lowest - friction)) / older)
    rest = left * older
    rise = response.tail_before * (1.0 - response.late) + response.tail_during * (1.0 - left)
    ahead = response.tail_before * response.late * highest + response.tail_during * left * highest
    ahead += response.tail_hand * hand + rise * friction
    largest = inf
    for share in (0.0, response.share):  # of the displacement in the tail: counts where it is outward
        tail, more = ahead + share * base, rise + share * gain
        start = base - early + late + (1.0 - left) * tail + rest * more
        found = hand_force_bound(energy - older * early - rest * tail, start, gain + (1.0 - left) * more)
        largest = min(largest, found)
    return largest


def if_held_on(declared: Declared, hand: float, motion: LateMotion, friction: float, energy: float) -> float:
    """Return the largest n of a torque that may act in 1, 2, ... holds until another arrives.

    With D_i the displacements in them, g the older torques above f_c and X as in `hold_timing`, it takes n sum(D_i) +
    g X_1 + c g sum(X_i) + n x and its tail (n + c g) X; each X_i after the first is at most that of the sum of all
    outward displacements. Where it is lost, the older torques stay: they were certified for that. Arguments of
    `by_reach_of_late`.
    """
    response, left = declared.response, declared.left
    displacement, before, highest, _ = motion
    older = max(0.0, highest - friction)
    late = -response.behind * displacement if displacement < 0.0 else 0.0
    early = older * (tail_reach(displacement, before, highest, response, hand) + response.tail_during * friction)
    base = next_displacement(displacement, before, response.late * highest, response, hand)
    inward, largest = max(0.0, -base), inf
    for holds in range(1, declared.losses + 2):
        lost = (1.0 - response.retained) * inward
        start, gain, ahead = sum_of_displacements(response, base, response.during, hand, lost, holds)
        reach = response.share * ahead + (response.tail_before + response.tail_during) * highest
        reach += response.tail_hand * hand
        more = response.share * gain + response.tail_before + response.tail_during
        tail = left * older * holds
        start += late + left * (holds - 1) * response.behind * inward
        start += reach + older * response.tail_during + tail * more + (gain + more) * friction
        found = hand_force_bound(energy - early - tail * (reach + more * friction), start, gain + more)
        largest = min(largest, found)
    return largest


def sum_of_displacements(
    response: DisplacementResponse, base: float, gain: float, hand: float, friction: float, holds: int
) -> tuple[float, float, float]:
    """Sum of the displacements over several holds of one torque.

    Args:
        response: Displacement response of the axis.
        base: Displacement in the first hold without the torque [m or rad].
        gain: Displacement in the first hold per unit torque.
        hand: Displacement by the hand in two holds [m or rad].
        friction: Largest increase of an inward displacement in a hold by friction [m or rad].
        holds: Number of holds.

    Returns:
        Without the torque, per torque, and the outward part of the first [m or rad, m/N or rad/(N*m), m or rad].
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
