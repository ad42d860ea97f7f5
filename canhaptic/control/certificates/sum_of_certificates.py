"""All certificates of one axis as one: the declared hand bounds the displacement, the device dissipates the energy.

Counted is the energy received and what the device dissipates for certain, S = E + sum((b/T) D_i^2 + f_c |D_i|); with
neither b nor f_c declared that is E. A hold of torque f >= 0 along and displacement D along takes from S

    g(f, D) = f D - (b/T) D^2 - f_c |D|,

concave in D. Nothing is known of D but D <= R, the least of the reach of the hand force (`next_displacement`, which
chains over the holds under way), v_max T of the hand speed, and infinity. With n = f - f_c the largest value of g is

    R <= 0:                        f R, at most: energy comes in for certain
    n <= 0 < R:                    0: dry friction pays for the whole torque, at any speed of any hand
    n > 0, R < n T / 2b:           R (n - b R / T)
    else:                          n^2 T / 4b                                                                     (1)

(`taken`). The sum over the holds under way and over the next one is the most by which S can fall in them, for each D_i
has a bound of its own. So S stays >= 0 where the sum is <= S before every hold: S after the hold is S - g(f, D) >= the
sum over the holds that are left. A torque against adds what it may take in its own direction.

**The largest torque.** (1) grows with f, by itself and through R = base + gain f, so that the torques with
(1) <= S' (what the holds under way leave) form an interval. Its end is f_c + sqrt(4 b S' / T) for a hand of which
nothing is known; else the larger of the ends for each reach, where that of the hand force solves a quadratic in f:

    f^2 gain (1 - q) + f (base (1 - 2q) - f_c gain) <= S' + f_c base + (b/T) base^2,   q = (b/T) gain,

if the displacement at its root is below n T / 2b, and is the end for any hand if not: the quadratic is (1) with a
displacement that the hand would not choose, its root never the smaller one. q < 1, as `during` is that of a damping b.

Each certificate alone is the same with the others left out, and none has a larger end.

**For every hand no law sends more.** A hand of which nothing is known may place the axis anywhere at each SYNC: it can
take (1) with R infinite in every hold under way and in the next one, so that at any larger torque there is a hand that
brings S below 0. With b = 0 the end is f_c: at f > f_c a hand that moves by D > S' / (f - f_c) within the hold takes
out more than there is. With b it is f_c + sqrt(4 b S' / T), and what friction took on the way to the wall counts in S'.
So a wall k is held at a force F for every hand if (1 + delay) (F - f_c)^2 T / 4b is no more than F^2 / 2k + f_c F / k
and what was there before the contact (`start_energy`). k <= 2 f_c / (v T) (Diolaiti 2006) is for hands up to a speed v,
and b > k T / 2 with k <= 2 f_c / count (Abbott and Okamura 2005) pays for the encoder's quanta with f_c: neither is a
promise for every hand by f_c alone. With `hand_speed` v the end is f_c + S' / v T.
"""

from math import inf, sqrt

from canhaptic.control.certificates.scalar_bounds import hand_force_bound, next_displacement
from canhaptic.control.certificates.torque_bound import (
    BoundMemory,
    Declared,
    TorqueBound,
    for_any,
    hand_along,
    outward,
)


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
    """Energy that the torques under way along `sign` take together [J], and the base of the next one.

    They take less at first while the axis goes inward, and then more: what they take until then is no more than at the
    end, or than nothing. The base is the largest displacement in the next hold without a torque; infinite where the
    hand is not known. `speed` is that of the hand [m/s or rad/s]; 0: it does not count.
    """
    response, torques, first = declared.response, memory.under_way, bound.first
    hand = hand_along(declared, bound, sign) if declared.by_hand_force else inf
    fastest = speed * declared.sample_time if speed > 0.0 else inf
    displacement, before = inf, sign * bound.torque
    if hand < inf:
        if declared.encoder_count > 0.0:
            displacement = outward(declared, bound, memory, sign)
        else:
            displacement = sign * bound.displacement + bound.blur
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
    """Part of `energy`, with what the device dissipated, that the torques under way do not need [J]."""
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
    """Energy left by the torques under way [J], and the base of `taken_along` [m or rad]."""
    given, base = taken_along(declared, bound, memory, sign, speed)
    energy -= given
    for place in range(bound.first, bound.first + declared.delay):
        if sign * memory.under_way[place] < 0.0:
            energy -= max(0.0, taken_along(declared, bound, memory, -sign, speed)[0])
            break
    return energy, base


def taken_by_any(declared: Declared, bound: TorqueBound, memory: BoundMemory) -> float:
    """Largest energy that the torques under way take, for an arbitrary hand [J]."""
    total = 0.0
    for place in range(bound.first, bound.first + declared.delay):
        total += taken(declared, abs(memory.under_way[place]), inf)
    return total


def for_any_hand(declared: Declared, budget: float) -> float:
    """Largest torque by what the device dissipates, for an arbitrary hand [N or N*m]."""
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
