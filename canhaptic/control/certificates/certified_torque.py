"""The largest torque of the next hold by all certificates, and the energy reserved for the queued torques.

All certificates of one axis as one: the declared hand bounds the displacement, the device dissipates the energy.

The budget is the energy received and the device's certain dissipation, S = E + sum((b/T) D_i^2 + f_c |D_i|); with
neither b nor f_c declared that is E. A hold of torque f >= 0 along and displacement D along takes from S

    g(f, D) = f D - (b/T) D^2 - f_c |D|,

concave in D. Nothing is known of D but D <= R, the least of the reach of the hand force (`next_displacement`, which
chains over the queued holds), v_max T of the hand speed, and infinity. With n = f - f_c the largest value of g is

    R <= 0:                        f R, at most: energy comes in for certain
    n <= 0 < R:                    0: dry friction pays for the whole torque, at any speed of any hand
    n > 0, R < n T / 2b:           R (n - b R / T)
    else:                          n^2 T / 4b                                                                     (1)

(`taken`). The sum over the queued holds and the next one is the most by which S can fall in them, for each D_i
has a bound of its own. So S stays >= 0 where the sum is <= S before every hold: S after the hold is S - g(f, D) >= the
sum over the holds that are left. A torque against adds what it may take in its own direction.

**The largest torque.** (1) grows with f, by itself and through R = base + gain f, so that the torques with
(1) <= S' (what the queued holds leave) form an interval. Its end is f_c + sqrt(4 b S' / T) for an unknown
hand; else the larger of the ends for each reach, where that of the hand force solves a quadratic in f:

    f^2 gain (1 - q) + f (base (1 - 2q) - f_c gain) <= S' + f_c base + (b/T) base^2,   q = (b/T) gain,

if the displacement at its root is below n T / 2b, and is the end for any hand if not: the quadratic is (1) with a
displacement that the hand would not choose, its root never the smaller one. q < 1, as `during` is that of a damping b.

Each certificate alone is the same with the others left out, and none has a larger end.

**For every hand no law sends more.** An unknown hand may move the axis anywhere by each SYNC: it can
take (1) with R infinite in every queued hold and in the next one, so that at any larger torque there is a hand that
brings S below 0. With b = 0 the end is f_c: at f > f_c a hand that moves by D > S' / (f - f_c) within the hold takes
out more than there is. With b it is f_c + sqrt(4 b S' / T), and what friction took on the way to the wall counts in S'.
So a wall k is held at a force F for every hand if (1 + delay) (F - f_c)^2 T / 4b is no more than F^2 / 2k + f_c F / k
and the budget before the contact (`start_energy`). k <= 2 f_c / (v T) (Diolaiti 2006) is for hands up to a speed v,
and b > k T / 2 with k <= 2 f_c / count (Abbott and Okamura 2005) pays for the encoder's quanta with f_c: neither is a
promise for every hand by f_c alone. With `hand_speed` v the end is f_c + S' / v T.

Largest torque after late torques, by the reach of the hand's force; see `certified_torque`.

n is the part of a torque above f_c, which friction pays for: f_c is 0 for A, and that of the device for B.

The sum of certificates where torques come late, holds are uneven, or frames may be lost.

`certified_torque` has the sum for holds with one torque each, `hold_timing` the effect of a late torque. Here both:
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

**Lost frames.** In each queued hold any of the last torques sent may act: A to D are taken at the largest, an energy
that comes in at the least of them. A new torque may act in 1, 2, ... holds, and each of A to D is summed over them.

**Remaining budget.** S includes what the device dissipated. The least energy that may have come in is booked: by the
hand's force or speed, or by the damping for an arbitrary hand (`for_any`).

**In debt** (a budget below zero) there may be no torque that meets it. Then a torque is sent only as far as it
absorbs energy by itself, its tail included, at any older torques (`takes_in`).
"""

from math import inf, sqrt
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
    for_any,
    hand_along,
    outward,
)
from canhaptic.kernels import new


def taken(declared: Declared, torque: float, reach: float) -> float:
    """Largest energy that a torque takes in a hold, beyond what the device dissipates in it: (1) [J].

    Args:
        declared: Declared properties of axis and hand.
        torque: Torque along the direction, >= 0 [N or N*m].
        reach: Largest displacement along it; infinite: unknown [m or rad].
    """
    if reach <= 0.0:
        return torque * reach
    net = torque - declared.friction
    if net <= 0.0:
        return 0.0
    if declared.damping == 0.0:
        return reach * net
    damped = declared.damping / declared.sample_time
    if 2.0 * damped * reach >= net:
        return net * net / (4.0 * damped)
    return reach * (net - damped * reach)


def taken_along(
    declared: Declared, bound: TorqueBound, memory: BoundMemory, sign: float, speed: float
) -> tuple[float, float]:
    """Energy that the queued torques along `sign` take together [J], and the base of the next one.

    They take less while the axis still moves inward, and more afterwards: what they take until then is at most
    what they take by the end, or zero. The base is the largest displacement in the next hold without a torque; infinite
    for an unknown hand. `speed` is the hand's [m/s or rad/s]; 0: unused.
    """
    response, torques, first = declared.response, memory.under_way, bound.first
    hand = hand_along(declared, bound, sign) if declared.by_hand_force else inf
    fastest = speed * declared.sample_time if speed > 0.0 else inf
    displacement, before = inf, sign * bound.torque
    if hand < inf:
        if declared.encoder_count > 0.0:
            displacement = outward(declared, bound, memory, sign)
        else:
            displacement = sign * bound.displacement + bound.position_uncertainty
    total = 0.0
    for place in range(first, first + declared.delay):
        along = sign * torques[place]
        if hand < inf:
            displacement = next_displacement(displacement, before, along, response, hand)
        if along > 0.0:
            total += taken(declared, along, displacement if displacement < fastest else fastest)
        before = along
    if hand < inf:
        displacement = next_displacement(displacement, before, 0.0, response, hand)
    return total, displacement


def free_in_sum(declared: Declared, bound: TorqueBound, memory: BoundMemory, energy: float) -> float:
    """Part of `energy`, with the device's dissipation, that the queued torques do not need [J]."""
    free = energy + bound.dissipated
    if declared.delay:
        pushes = pulls = False
        for place in range(bound.first, bound.first + declared.delay):
            pushes = pushes or memory.under_way[place] > 0.0
            pulls = pulls or memory.under_way[place] < 0.0
        if pushes:  # else they take nothing that way
            free -= max(0.0, taken_along(declared, bound, memory, 1.0, declared.hand_speed)[0])
        if pulls:
            free -= max(0.0, taken_along(declared, bound, memory, -1.0, declared.hand_speed)[0])
    return free if free > 0.0 else 0.0


def largest_in_sum(
    declared: Declared, bound: TorqueBound, memory: BoundMemory, sign: float, energy: float
) -> tuple[float, float, float]:
    """Largest torque along `sign` [N or N*m]: by all certificates, for any hand, and without the hand speed.

    Args:
        declared: Declared properties of axis and hand.
        bound: State of the axis's torque bound.
        memory: Buffers of the bound.
        sign: 1 or -1.
        energy: Energy budget, without what the device dissipated [J].
    """
    for_all = for_any_hand(declared, energy + for_any(bound) - taken_by_any(declared, bound, memory))
    energy += bound.dissipated
    by_force = for_all
    if declared.by_hand_force:
        budget, base = left_under_way(declared, bound, memory, sign, energy, 0.0)
        any_hand = for_any_hand(declared, budget)
        by_force = max(for_all, any_hand, by_reach(declared, budget, base, any_hand))
    if declared.hand_speed == 0.0:
        return by_force, for_all, by_force
    budget, base = left_under_way(declared, bound, memory, sign, energy, declared.hand_speed)
    any_hand = for_any_hand(declared, budget)
    largest = max(by_force, any_hand, by_reach(declared, budget, base, any_hand))
    if budget > 0.0:
        largest = max(largest, by_fastest(declared, budget, declared.hand_speed * declared.sample_time, any_hand))
    return largest, for_all, by_force


def left_under_way(
    declared: Declared, bound: TorqueBound, memory: BoundMemory, sign: float, energy: float, speed: float
) -> tuple[float, float]:
    """Energy left by the queued torques [J], and the base of `taken_along` [m or rad]."""
    given, base = taken_along(declared, bound, memory, sign, speed)
    energy -= given
    for place in range(bound.first, bound.first + declared.delay):
        if sign * memory.under_way[place] < 0.0:
            energy -= max(0.0, taken_along(declared, bound, memory, -sign, speed)[0])
            break
    return energy, base


def taken_by_any(declared: Declared, bound: TorqueBound, memory: BoundMemory) -> float:
    """Largest energy that the queued torques take, for an arbitrary hand [J]."""
    total = 0.0
    for place in range(bound.first, bound.first + declared.delay):
        total += taken(declared, abs(memory.under_way[place]), inf)
    return total


def for_any_hand(declared: Declared, budget: float) -> float:
    """Largest torque covered by the device's dissipation, for an arbitrary hand [N or N*m]."""
    if budget <= 0.0:
        return declared.friction
    return declared.friction + sqrt(4.0 * declared.damping / declared.sample_time * budget)


def by_reach(declared: Declared, budget: float, base: float, for_all: float) -> float:
    """Return the largest torque by the reach of the hand force [N or N*m]; 0 where that is infinite."""
    if base == inf:
        return 0.0
    friction, gain = declared.friction, declared.response.during
    damped = declared.damping / declared.sample_time
    if budget < 0.0:
        return hand_force_bound(budget, base, gain)
    share = damped * gain
    largest = hand_force_bound(
        budget + (friction + damped * base) * base, base * (1.0 - 2.0 * share) - friction * gain, gain * (1.0 - share)
    )
    if 2.0 * damped * (base + gain * largest) > largest - friction:
        return for_all
    return largest


def by_fastest(declared: Declared, budget: float, fastest: float, for_all: float) -> float:
    """Return the largest torque for a hand that moves no farther than `fastest` [m or rad] in a hold [N or N*m]."""
    damped = declared.damping / declared.sample_time
    largest = declared.friction + budget / fastest + damped * fastest
    return for_all if 2.0 * damped * fastest > largest - declared.friction else largest


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
        motion: Motion in the last queued hold.
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
    """Largest n for a torque that absorbs energy by itself, limited to the debt [N or N*m].

    Older torques push the axis while it acts: as if all of `late` of them were held, and `left` of them after the hold.
    Below -start / gain the axis goes inward in the hold of the torque, so that its tail takes none of that motion.
    """
    response = declared.response
    start, gain, _, _ = own_share(declared, hand, motion, friction)
    start += (response.during + response.tail_before) * response.late * motion.highest
    start += response.tail_during * declared.left * motion.highest
    return hand_force_bound(energy, start, gain)


def above_older(declared: Declared, hand: float, motion: LateMotion, friction: float, energy: float) -> float:
    """Return the largest n as if it were no smaller than the older ones; arguments as for `by_reach_of_late`."""
    start, gain, base, late = own_share(declared, hand, motion, friction)
    energy += max(0.0, motion.lowest - friction) * late
    share = declared.response.share
    largest = hand_force_bound(energy, start + share * base, gain + share * declared.response.during)
    return min(largest, hand_force_bound(energy, start, gain))


def below_older(declared: Declared, hand: float, motion: LateMotion, friction: float, energy: float) -> float:
    """Return the largest n as if it were smaller than the older ones.

    With g the largest of these above f_c it takes n D + (g - n) X_0 + (n - l) x and the tail G X, where
    D = base + during (late g + (1 - late) F), G = c g + (1 - c) n, and (n - l) x is at most n x (g - l) / g.
    All is convex in n and joins `above_older` at n = g. Arguments as for `by_reach_of_late`.
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
    outward displacements. If the new torque is lost, the older ones stay: they were certified for it. Arguments as for
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
        Sum without the torque, its gain, and the outward part of the first [m or rad, m/N or rad/(N*m), m or rad].
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
    """Return the least of A to D for a hold [J]; `following` is its displacement, the rest as for `pass_hold`."""
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
    """Return the energy that torques give out in a hold along the farthest motion [J]: A, or with friction B."""
    most, least = max(0.0, most - friction), max(0.0, least - friction)
    highest, lowest = motion.highest - friction, max(0.0, motion.lowest - friction)
    taken = (most if following > 0.0 else least) * following
    if highest > least:
        taken += (highest - least) * reach
    if most > lowest and motion.displacement < 0.0:
        taken -= (most - lowest) * response.behind * motion.displacement
    return taken


def tail_of(declared: Declared, hand: float, speed: float, motion: LateMotion) -> float:
    """Return the most energy that the torques take after the last hold [J]."""
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
    """Worst energy that the queued torques along `sign` take together, tail included [J], and the last motion.

    Args:
        declared: Declared properties of axis and hand.
        bound: State of the axis's torque bound.
        memory: Buffers of the bound.
        sign: 1 or -1.
        speed: Largest speed of the hand; 0: not used [m/s or rad/s].
        holds: Number of holds in which they act.
        which: `_ANY`: any torque that may act; else, in the next hold, the torque as sent or the previous one held on.
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
    """Energy left after all queued torques, for an arbitrary hand [J].

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
    """Part of `energy`, with the device's dissipation, that the queued torques do not need [J]."""
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
        energy: Energy budget, with the device's dissipation [J].
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
    """Return `largest_of_known` after some torques of `taken_under_way`, minus the energy taken by opposing ones."""
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


def free_energy(declared: Declared, bound: TorqueBound, memory: BoundMemory, energy: float) -> float:
    """Part of `energy` [J] that the certificates of the queued torques do not need."""
    if declared.losses == 0 and declared.late == 0.0:
        return free_in_sum(declared, bound, memory, energy)
    return free_of_late(declared, bound, memory, energy)


def largest_torques(
    declared: Declared, bound: TorqueBound, memory: BoundMemory, sign: float, energy: float
) -> tuple[float, float, float]:
    """Largest torque along `sign` [N or N*m]: by all certificates, for any hand, and without the hand speed.

    `energy` [J] is the budget, without the device's dissipation.
    """
    if declared.losses or declared.late > 0.0:
        return largest_of_late(declared, bound, memory, sign, energy)
    if declared.by_hand_force_alone:
        force = by_hand_force(declared, bound, memory, sign, energy)
        return force, 0.0, force
    return largest_in_sum(declared, bound, memory, sign, energy)


def by_hand_force(declared: Declared, bound: TorqueBound, memory: BoundMemory, sign: float, energy: float) -> float:
    """Return the largest torque along `sign` [N or N*m] for a hand within its declared force.

    It equals the result of `largest_in_sum` where nothing else is declared. `energy` [J] is the budget.
    """
    response, before, hand = declared.response, sign * bound.torque, hand_along(declared, bound, sign)
    if hand == inf:  # the hand is unknown along it
        return 0.0
    if declared.encoder_count > 0.0:
        displacement = outward(declared, bound, memory, sign)
    else:
        displacement = sign * bound.displacement + bound.position_uncertainty
    if declared.delay:
        opposed = False
        for place in range(bound.first, bound.first + declared.delay):
            along = sign * memory.under_way[place]
            displacement = next_displacement(displacement, before, along, response, hand)
            if along >= 0.0:
                energy -= along * displacement
            else:
                opposed = True
            before = along
        if opposed:
            energy -= worst_out(declared, bound, memory, -sign)
    base = next_displacement(displacement, before, 0.0, response, hand)
    return hand_force_bound(energy, base, response.during)


def worst_out(declared: Declared, bound: TorqueBound, memory: BoundMemory, sign: float) -> float:
    """Return the most energy [J] that the queued torques may give out along `sign`, >= 0."""
    displacement, before = outward(declared, bound, memory, sign), sign * bound.torque
    hand = hand_along(declared, bound, sign)
    given = 0.0
    for place in range(bound.first, bound.first + declared.delay):
        along = sign * memory.under_way[place]
        displacement = next_displacement(displacement, before, along, declared.response, hand)
        if along > 0.0:
            given += along * displacement
        before = along
    return max(0.0, given)  # less at first while the axis goes inward, then more
