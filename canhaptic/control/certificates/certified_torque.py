"""The largest torque of the next hold by each certificate, and what the torques under way still need."""

from math import inf

from canhaptic.control.certificates.late_torque import (
    by_hand_force_late,
    given_by_any_late,
    held_on_late,
    largest_of_any,
    worst_out_late,
)
from canhaptic.control.certificates.scalar_bounds import (
    device_damping_bound,
    hand_force_bound,
    hand_speed_bound,
    next_displacement,
)
from canhaptic.control.certificates.sum_of_certificates import free_in_sum, largest_in_sum
from canhaptic.control.certificates.torque_bound import (
    BoundMemory,
    Declared,
    TorqueBound,
    hand_along,
    may_act,
    outward,
)
from canhaptic.kernels import Buffer


def free_energy(declared: Declared, bound: TorqueBound, memory: BoundMemory, energy: float) -> float:
    """Returns how much of `energy` [J] is not needed by the certificates of the torques under way."""
    delay, losses = declared.delay, declared.losses
    if losses == 0 and declared.late == 0.0:
        return free_in_sum(declared, bound, memory, energy)
    if losses == 0:
        hand, path, squares = needed(declared, bound, memory, memory.under_way, bound.first, delay)
        free = energy - hand if declared.by_hand_force else 0.0
    elif delay > 1 or declared.late > 0.0:  # some of the torques under way may act, and others not
        take_sizes(declared, bound, memory, losses + delay)
        _, path, squares = needed(declared, bound, memory, memory.held_on, 0, losses + delay)
        free = 0.0
        if declared.by_hand_force:
            free = energy - given_by_any(declared, bound, memory, 1.0, losses + delay)[0]
            free -= given_by_any(declared, bound, memory, -1.0, losses + delay)[0]
    else:
        take_constant(memory, bound.torque)
        hand, path, squares = needed(declared, bound, memory, memory.held_on, 0, losses + delay)
        if delay:
            take_constant(memory, memory.under_way[bound.first])
            other, further, more = needed(declared, bound, memory, memory.held_on, 0, losses + delay)
            hand, path, squares = max(hand, other), max(path, further), max(squares, more)
        free = energy - hand if declared.by_hand_force else 0.0
    hold, tail, tail_square = acting_time(declared, bound)
    if declared.hand_speed > 0.0:
        free = max(free, energy - declared.hand_speed * (hold * path + tail))
    if declared.damping > 0.0:
        share = hold / (4.0 * declared.damping)
        free = max(free, energy + bound.dissipated - share * (squares + tail_square))
    return free if free > 0.0 else 0.0


def acting_time(declared: Declared, bound: TorqueBound) -> tuple[float, float, float]:
    """Returns for how long a torque acts, and what older ones add: size times time, and square in whole times.

    In [s], [N*s or N*m*s] and [N^2 or N^2*m^2].
    """
    hold = declared.sample_time
    if declared.late == 0.0:
        return hold, 0.0, 0.0
    hold += declared.late
    older = max(bound.highest, -bound.lowest)
    return hold, older * declared.late, older * older * (declared.late / hold)


def take_constant(memory: BoundMemory, torque: float) -> None:
    """Writes that one torque [N or N*m] is held on."""
    for place in range(len(memory.held_on)):
        memory.held_on[place] = torque


def take_sizes(declared: Declared, bound: TorqueBound, memory: BoundMemory, holds: int) -> None:
    """Writes the largest size of a torque that may act in each of the next holds [N or N*m]."""
    for hold in range(holds):
        along = may_act(declared, bound, memory, 1.0, hold + 1)
        memory.held_on[hold] = max(along, may_act(declared, bound, memory, -1.0, hold + 1))


def needed(
    declared: Declared, bound: TorqueBound, memory: BoundMemory, torques: Buffer, first: int, count: int
) -> tuple[float, float, float]:
    """Returns what a sequence of torques may give out to a hand within its force [J], sum(|f|), and sum(f^2).

    Args:
        declared: Of axis and hand.
        bound: Of the axis.
        memory: Of the bound.
        torques: [N or N*m].
        first: Place of the one that acts first; below 0 it wraps.
        count: How many act.
    """
    sizes = squares = hand = 0.0
    for place in range(first, first + count):
        torque = torques[place]
        sizes += abs(torque)
        squares += torque * torque
    if declared.by_hand_force and (sizes > 0.0 or declared.late > 0.0):
        hand = worst_out(declared, bound, memory, 1.0, torques, first, count)
        hand += worst_out(declared, bound, memory, -1.0, torques, first, count)
    return hand, sizes, squares


def worst_out(
    declared: Declared, bound: TorqueBound, memory: BoundMemory, sign: float, torques: Buffer, first: int, count: int
) -> float:
    """Returns the most energy [J] that a sequence of torques may give out along `sign`, >= 0; see `needed`."""
    if declared.late > 0.0:
        return worst_out_late(declared, bound, memory, sign, torques, first, count)
    acts = False
    for place in range(first, first + count):
        if sign * torques[place] > 0.0:
            acts = True
    if not acts:
        return 0.0
    displacement, before = outward(declared, bound, memory, sign), sign * bound.torque
    hand = hand_along(declared, bound, sign)
    worst = given = 0.0
    for place in range(first, first + count):
        along = sign * torques[place]
        displacement = next_displacement(displacement, before, along, declared.response, hand)
        if along > 0.0:
            given += along * displacement
            if given > worst:
                worst = given
        before = along
    return worst


def given_by_any(
    declared: Declared, bound: TorqueBound, memory: BoundMemory, sign: float, holds: int
) -> tuple[float, float]:
    """Returns what any mix of torques along `sign` may give out [J], and the base of one after them [m or rad].

    What one of them would take in is not counted: another may act in its place.
    """
    if declared.late > 0.0:
        return given_by_any_late(declared, bound, memory, sign, holds)
    displacement, before, given = outward(declared, bound, memory, sign), sign * bound.torque, 0.0
    hand = hand_along(declared, bound, sign)
    for hold in range(1, holds + 1):
        along = may_act(declared, bound, memory, sign, hold)
        displacement = next_displacement(displacement, before, along, declared.response, hand)
        if displacement > 0.0 and along > 0.0:
            given += along * displacement
        before = along
    return given, next_displacement(displacement, before, 0.0, declared.response, hand)


def by_hand_force_of_any(
    declared: Declared, bound: TorqueBound, memory: BoundMemory, sign: float, energy: float
) -> float:
    """Returns `by_hand_force` where any mix of the torques under way may act."""
    hand = hand_along(declared, bound, sign)
    if hand == inf:
        return 0.0
    if declared.late > 0.0:
        return largest_of_any(declared, bound, memory, sign, energy)
    given, base = given_by_any(declared, bound, memory, sign, declared.delay)
    energy -= given + given_by_any(declared, bound, memory, -sign, declared.delay)[0]
    largest = hand_force_bound(energy, base, declared.response.during)
    return min(largest, by_hand_force_if_held_on(declared, energy, base, hand))


def by_hand_force(
    declared: Declared, bound: TorqueBound, memory: BoundMemory, sign: float, energy: float, torques: Buffer, first: int
) -> float:
    """Returns the largest torque along `sign` [N or N*m] for a hand within its declared force.

    Args:
        declared: Of axis and hand.
        bound: Of the axis.
        memory: Of the bound.
        sign: 1 or -1.
        energy: That may be taken out [J].
        torques: Of which `delay` act before it [N or N*m].
        first: Place of the one that acts first.
    """
    response, before, hand = declared.response, sign * bound.torque, hand_along(declared, bound, sign)
    if hand == inf:  # nothing is known of the hand along it
        return 0.0
    if declared.late > 0.0:
        return by_hand_force_late(declared, bound, memory, sign, energy, torques, first)
    if declared.encoder_count > 0.0:
        displacement = outward(declared, bound, memory, sign)
    else:
        displacement = sign * bound.displacement + bound.blur
    if declared.delay:
        opposed = False
        for place in range(first, first + declared.delay):
            along = sign * torques[place]
            displacement = next_displacement(displacement, before, along, response, hand)
            if along >= 0.0:
                energy -= along * displacement
            else:
                opposed = True
            before = along
        if opposed:
            energy -= worst_out(declared, bound, memory, -sign, torques, first, declared.delay)
    base = next_displacement(displacement, before, 0.0, response, hand)
    largest = hand_force_bound(energy, base, response.during)
    if declared.losses:
        largest = min(largest, by_hand_force_if_held_on(declared, energy, base, hand))
    return largest


def by_hand_force_if_held_on(declared: Declared, energy: float, base: float, hand: float) -> float:
    """Returns the largest torque that may act in as many holds more as frames may be lost [N or N*m].

    Args:
        declared: Of axis and hand.
        energy: That may be taken out [J].
        base: Displacement in the first of the holds without the torque [m or rad].
        hand: Displacement by the hand [m or rad].
    """
    response, largest = declared.response, inf
    friction = (1.0 - response.retained) * max(0.0, -base)
    for holds in range(2, declared.losses + 2):
        pairs = 0.5 * holds * (holds - 1)
        start = holds * base + pairs * (hand + friction)
        gain = holds * response.during + pairs * (response.before + response.during)
        if response.growth > 1.0:
            start, gain, _ = held_on_late(response, base, response.during, hand, friction, holds)
        largest = min(largest, hand_force_bound(energy, start, gain))
    return largest


def largest_torques(
    declared: Declared, bound: TorqueBound, memory: BoundMemory, sign: float, energy: float
) -> tuple[float, float, float]:
    """Returns the largest torque along `sign`: by all certificates, for every hand, without the hand speed [N or N*m].

    Where torques come late or frames are lost it is the largest of the certificates, else their sum. `energy` [J] is
    what may be taken out.
    """
    losses, delay, torques, first = declared.losses, declared.delay, memory.under_way, bound.first
    if losses == 0 and declared.late == 0.0:
        if declared.by_hand_force_alone:
            force = by_hand_force(declared, bound, memory, sign, energy, torques, first)
            return force, 0.0, force
        return largest_in_sum(declared, bound, memory, sign, energy)
    force, damping, speed = 0.0, declared.friction, 0.0
    if declared.by_hand_force:
        if losses and (delay > 1 or declared.late > 0.0):
            force = by_hand_force_of_any(declared, bound, memory, sign, energy)
        else:
            force = by_hand_force(declared, bound, memory, sign, energy, torques, first)
            if losses and delay:
                take_constant(memory, bound.torque)
                force = min(force, by_hand_force(declared, bound, memory, sign, energy, memory.held_on, 0))
    if losses:
        take_sizes(declared, bound, memory, delay)
        torques, first = memory.held_on, 0
    if declared.damping > 0.0 or declared.hand_speed > 0.0:
        damping, speed = by_damping_or_speed(declared, bound, torques, first, energy)
        damping = max(damping, declared.friction)
    force = max(force, damping)
    return max(force, speed), damping, force


def by_damping_or_speed(
    declared: Declared, bound: TorqueBound, torques: Buffer, first: int, energy: float
) -> tuple[float, float]:
    """Returns the largest torque by device damping, and by hand speed [N or N*m]; 0 where one is not declared.

    Args:
        declared: Of axis and hand.
        bound: Of the axis.
        torques: Of which `delay` act before it [N or N*m].
        first: Place of the one that acts first.
        energy: That may be taken out [J].
    """
    hold, tail, tail_square = acting_time(declared, bound)
    damping = speed = sizes = squares = 0.0
    for place in range(first, first + declared.delay):
        sizes += abs(torques[place])
        squares += torques[place] * torques[place]
    if declared.damping > 0.0:
        energy_left = energy + bound.dissipated
        squares += tail_square
        damping = device_damping_bound(energy_left, declared.damping, hold, squares, declared.losses + 1)
    if declared.hand_speed > 0.0:
        rest = energy - declared.hand_speed * (hold * sizes + tail)
        speed = hand_speed_bound(rest, declared.hand_speed, hold, declared.losses + 1)
    return damping, speed
