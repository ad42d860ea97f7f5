"""The sum of certificates where torques come late, holds are uneven, or frames may be lost.

`sum_of_certificates` has the sum for holds with one torque each, `hold_timing` what a late torque changes. Here both:
at every instant the device dissipates b v^2 + f_c |v|, so that torques u = f (1 - p) + older ones take from S no more
than the integral of

    phi = u v - b v^2 - f_c |v|

over the motions v <= v* that the hand allows. phi is concave in v, and with n the part of a torque above f_c,
(u - f_c)+ <= n_f (1 - p) + n_older p. So a hold takes no more than each of

    A  what the torques give out along v*, as in `hold_timing`:     phi <= u v* where v* < 0 or u v* > 0
    B  the same with n in place of every torque:                    phi <= (u - f_c)+ v*, and u v* <= n v* for v* < 0
    C  (n_f^2 T + theta max(0, n_g^2 - n_f^2)) / 4b:                phi <= (u - f_c)+^2 / 4b, and squares are convex
    D  v_max (n_f T + theta max(0, n_g - n_f)):                     phi <= (u - f_c)+ |v|

with g the largest older torque, and the least of them counts (`taken_in_hold`): A and B need the hand's force (the
motion is that of the whole torques), C the device's damping, or torques that are all below f_c, and D the hand's speed.
Torques in both directions are charged each for its own; friction and damping are used where v is along the torque
alone, so that no part of them counts twice. The tail of the last torque is charged as if no torque followed.

**Lost frames.** In each hold under way any of the last torques sent may act: A to D are taken at the largest, an energy
that comes in at the least of them. A new torque may act in 1, 2, ... holds, and each of A to D is summed over them.

**What is left.** S has what the device dissipated. The least that may have come in is booked: by the hand's force or
speed, or by the damping for an arbitrary hand (`for_any`).

**In debt** (the budget is below zero) there may be no torque that meets it. Then a torque is sent only as far as it
takes energy in by itself, its tail included, at any older torques (`takes_in`).
"""

from math import inf, sqrt

from canhaptic.control.certificates.late_reach import LateMotion, by_reach_of_late
from canhaptic.control.certificates.scalar_bounds import DisplacementResponse, next_displacement, tail_reach
from canhaptic.control.certificates.torque_bound import (
    BoundMemory,
    Declared,
    TorqueBound,
    acted,
    for_any,
    hand_along,
    outward,
)
from canhaptic.kernels import new

_ANY, _SENT, _HELD_ON = 0, 1, 2


def motion_along(declared: Declared, bound: TorqueBound, memory: BoundMemory, sign: float, hand: float) -> LateMotion:
    """Return the motion along `sign` in the hold that ended."""
    highest, lowest = (bound.highest, bound.lowest) if sign > 0.0 else (-bound.lowest, -bound.highest)
    displacement = outward(declared, bound, memory, sign) if hand < inf else inf
    counted = max(0.0, acted(declared, bound, sign))
    return new(LateMotion, (displacement, counted, max(0.0, highest), max(0.0, lowest)))


def pass_hold(
    declared: Declared, hand: float, speed: float, motion: LateMotion, most: float, least: float
) -> tuple[LateMotion, float]:
    """Motion in the next hold, and the largest energy taken beyond what the device dissipates [J].

    Args:
        declared: Declared properties of axis and hand.
        hand: Displacement by the hand [m or rad]; infinite: unknown.
        speed: Speed of the hand; 0: unknown [m/s or rad/s].
        motion: Motion in the hold before.
        most: Largest torque along `sign` that may be held in the next hold, >= 0 [N or N*m].
        least: Smallest such torque, >= 0 [N or N*m].
    """
    response = declared.response
    displacement, before, highest, lowest = motion
    counted, newest, oldest, following = most, most, least, inf
    if highest > most:
        counted += response.late * (highest - most)
        newest += declared.left * (highest - most)
    if least > lowest:
        oldest -= declared.left * (least - lowest)
    if hand < inf:
        following = next_displacement(displacement, before, counted, response, hand)
    taken = taken_in_hold(declared, hand, speed, motion, most, least, following)
    return new(LateMotion, (following, counted, newest, oldest)), taken


def taken_in_hold(
    declared: Declared, hand: float, speed: float, motion: LateMotion, most: float, least: float, following: float
) -> float:
    """Return the least of A to D for a hold [J]; `following` is its displacement, for the rest see `pass_hold`."""
    friction, hold, late, taken = declared.friction, declared.sample_time, declared.late, inf
    net = most - friction if most > friction else 0.0
    older = motion.highest - friction if motion.highest > friction else 0.0
    if hand < inf:
        reach = tail_reach(motion.displacement, motion.counted, max(most, motion.highest), declared.response, hand)
        taken = along_reach(declared.response, motion, 0.0, most, least, following, reach)
        taken = min(taken, along_reach(declared.response, motion, friction, most, least, following, reach))
    if net == 0.0 and older == 0.0:
        taken = min(taken, 0.0)
    elif declared.damping > 0.0:
        squares = net * net * hold
        if older > net:
            squares += late * (older * older - net * net)
        taken = min(taken, squares / (4.0 * declared.damping))
    if speed > 0.0:
        taken = min(taken, speed * (net * hold + late * (older - net if older > net else 0.0)))
    return taken


def along_reach(
    response: DisplacementResponse,
    motion: LateMotion,
    friction: float,
    most: float,
    least: float,
    following: float,
    reach: float,
) -> float:
    """Return what torques give out in a hold along the farthest motion [J]: A, or with friction B."""
    most, least = max(0.0, most - friction), max(0.0, least - friction)
    highest, lowest = motion.highest - friction, max(0.0, motion.lowest - friction)
    taken = (most if following > 0.0 else least) * following
    if highest > least:
        taken += (highest - least) * reach
    if most > lowest and motion.displacement < 0.0:
        taken -= (most - lowest) * response.behind * motion.displacement
    return taken


def tail_of(declared: Declared, hand: float, speed: float, motion: LateMotion) -> float:
    """Return the most that the torques along take after a hold that is the last of all [J]."""
    net = motion.highest - declared.friction
    if declared.late == 0.0 or net <= 0.0:
        return 0.0
    taken = inf
    if hand < inf:
        taken = net * tail_reach(motion.displacement, motion.counted, motion.highest, declared.response, hand)
    if declared.damping > 0.0:
        taken = min(taken, declared.late * net * net / (4.0 * declared.damping))
    return min(taken, speed * declared.late * net) if speed > 0.0 else taken


def may_act(declared: Declared, bound: TorqueBound, memory: BoundMemory, sign: float, hold: int) -> float:
    """Return the largest torque along `sign` that may act in one of the next holds [N or N*m], >= 0.

    Any torque sent may stay for the declared losses.
    """
    most = 0.0
    for place in range(max(0, hold - declared.losses), min(hold, declared.delay) + 1):
        torque = sign * (memory.under_way[bound.first + place - 1] if place else bound.torque)
        if torque > most:
            most = torque
    return most


def smallest_acting(declared: Declared, bound: TorqueBound, memory: BoundMemory, sign: float, hold: int) -> float:
    """Return the smallest torque along `sign` that may act in one of the next holds [N or N*m], >= 0."""
    least = inf
    for place in range(max(0, hold - declared.losses), min(hold, declared.delay) + 1):
        torque = sign * (memory.under_way[bound.first + place - 1] if place else bound.torque)
        if torque < least:
            least = torque
    return least if 0.0 < least < inf else 0.0


def taken_under_way(
    declared: Declared, bound: TorqueBound, memory: BoundMemory, sign: float, speed: float, holds: int, which: int
) -> tuple[float, float, LateMotion]:
    """Worst energy that the torques under way along `sign` take together, tail included [J], and the last motion.

    Args:
        declared: Declared properties of axis and hand.
        bound: State of the axis's torque bound.
        memory: Buffers of the bound.
        sign: 1 or -1.
        speed: Largest speed of the hand; 0: not used [m/s or rad/s].
        holds: Number of holds in which they act.
        which: `_ANY` torque that may act, or in the next hold alone the torque as sent, or the one before it held on.
    """
    hand = hand_along(declared, bound, sign) if declared.by_hand_force else inf
    motion, total, worst = motion_along(declared, bound, memory, sign, hand), 0.0, 0.0
    for hold in range(1, holds + 1):
        if which == _ANY:
            most = may_act(declared, bound, memory, sign, hold)
            least = most if declared.losses == 0 else smallest_acting(declared, bound, memory, sign, hold)
        else:
            most = least = max(0.0, sign * (memory.under_way[bound.first] if which == _SENT else bound.torque))
        motion, taken = pass_hold(declared, hand, speed, motion, most, least)
        total += taken
        worst = max(worst, total)
    return total, max(worst, total + tail_of(declared, hand, speed, motion)), motion


def for_every_hand(declared: Declared, bound: TorqueBound, memory: BoundMemory, energy: float, holds: int) -> float:
    """Energy left after all torques under way, for an arbitrary hand [J].

    The integral of (u - f_c)+^2 is at most the sum of n_k^2 (T + theta), u being a mean of the torques.
    """
    older = max(bound.highest, -bound.lowest) - declared.friction
    squares = declared.late * older * older if older > 0.0 else 0.0
    for hold in range(1, holds + 1):
        most = max(may_act(declared, bound, memory, 1.0, hold), may_act(declared, bound, memory, -1.0, hold))
        if most > declared.friction:
            beyond = most - declared.friction
            squares += (declared.sample_time + declared.late) * (beyond * beyond)
    if squares == 0.0:
        return energy
    return energy - squares / (4.0 * declared.damping) if declared.damping > 0.0 else -inf


def free_of_late(declared: Declared, bound: TorqueBound, memory: BoundMemory, energy: float) -> float:
    """Part of `energy`, with what the device dissipated, that the torques under way do not need [J]."""
    holds, known = declared.delay + declared.losses, energy + bound.dissipated
    free = 0.0
    if declared.by_hand_force or declared.hand_speed > 0.0:
        known -= taken_under_way(declared, bound, memory, 1.0, declared.hand_speed, holds, _ANY)[1]
        known -= taken_under_way(declared, bound, memory, -1.0, declared.hand_speed, holds, _ANY)[1]
        free = max(free, known)
    if declared.damping > 0.0 or declared.friction > 0.0:
        free = max(free, for_every_hand(declared, bound, memory, energy + for_any(bound), holds))
    return free


def largest_of_late(
    declared: Declared, bound: TorqueBound, memory: BoundMemory, sign: float, energy: float
) -> tuple[float, float, float]:
    """Largest torque along `sign` [N or N*m]: by all certificates, for any hand, and without the hand speed.

    Arguments as for `largest_in_sum`.
    """
    longest = (declared.sample_time + declared.late) * (declared.losses + 1)
    for_all = declared.friction
    left = for_every_hand(declared, bound, memory, energy + for_any(bound), declared.delay)
    if left > 0.0:
        for_all += sqrt(4.0 * declared.damping * left / longest)
    known = energy + bound.dissipated
    by_force = for_all
    if declared.by_hand_force:
        by_force = max(for_all, largest_of_known(declared, bound, memory, sign, known, 0.0))
    if declared.hand_speed == 0.0:
        return by_force, for_all, by_force
    largest = largest_of_known(declared, bound, memory, sign, known, declared.hand_speed)
    return max(by_force, largest), for_all, by_force


def largest_of_known(
    declared: Declared, bound: TorqueBound, memory: BoundMemory, sign: float, energy: float, speed: float
) -> float:
    """Largest torque along `sign` for a hand of bounded force, speed, or both [N or N*m].

    Args:
        declared: Declared properties of axis and hand.
        bound: State of the axis's torque bound.
        memory: Buffers of the bound.
        sign: 1 or -1.
        energy: Energy budget, with what the device dissipated [J].
        speed: Largest speed of the hand; 0: not used [m/s or rad/s].
    """
    losses, delay = declared.losses, declared.delay
    holds = delay + losses + 1 if losses and declared.late > 0.0 else delay
    energy -= taken_under_way(declared, bound, memory, -sign, speed, holds, _ANY)[1]
    if losses == 0 or delay != 1:
        return largest_after(declared, bound, memory, sign, energy, speed, _ANY)
    sent = largest_after(declared, bound, memory, sign, energy, speed, _SENT)
    return min(sent, largest_after(declared, bound, memory, sign, energy, speed, _HELD_ON))


def largest_after(
    declared: Declared, bound: TorqueBound, memory: BoundMemory, sign: float, energy: float, speed: float, which: int
) -> float:
    """Return `largest_of_known` after some torques of `taken_under_way`, less what those against it take."""
    given, _, motion = taken_under_way(declared, bound, memory, sign, speed, declared.delay, which)
    budget, friction, losses = energy - given, declared.friction, declared.losses
    hand = hand_along(declared, bound, sign) if declared.by_hand_force else inf
    largest = friction
    if hand < inf:
        largest = max(largest, by_reach_of_late(declared, hand, motion, 0.0, budget))
        if friction > 0.0:
            largest = max(largest, friction + by_reach_of_late(declared, hand, motion, friction, budget))
    older = max(0.0, motion.highest - friction)
    longest = (declared.sample_time + declared.late) * (losses + 1)
    squares = 4.0 * declared.damping * budget - declared.late * older * older
    if squares > 0.0:
        largest = max(largest, friction + sqrt(squares / longest))
    if speed > 0.0:
        largest = max(largest, friction + (budget / speed - declared.late * older) / longest)
    return largest
