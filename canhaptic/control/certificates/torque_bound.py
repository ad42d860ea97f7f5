"""The certified bound of one axis: what is known of it and of the hand, applied to the torques under way."""

from dataclasses import dataclass
from math import inf, isnan, nan
from typing import NamedTuple, Protocol

from canhaptic.control.certificates.scalar_bounds import (
    WINDOW,
    DisplacementResponse,
    device_damping_bound,
    hand_force_bound,
    hand_speed_bound,
    next_displacement,
)
from canhaptic.kernels import Buffer, MakeBuffer


@dataclass(frozen=True, slots=True)
class Declared:
    """What a configuration declares of the axis and of the hand."""

    sample_time: float  # [s]
    delay: int  # whole holds between computation and action
    losses: int  # consecutive cycles without a new torque that the certificates survive
    by_hand_force: bool  # whether that certificate is declared
    response: DisplacementResponse  # for it
    damping: float  # certain damping of the device [N*s/m or N*m*s/rad]; 0: not declared
    hand_speed: float  # largest speed of the hand [m/s or rad/s]; 0: not declared
    encoder_count: float  # [m or rad]; 0: ideal


@dataclass(slots=True)
class TorqueBound:
    """The hold that ended, and the energy that is not known for certain."""

    displacement: float = 0.0  # [m or rad]
    torque: float = 0.0  # [N or N*m]
    blur: float = 0.0  # by which the displacement is unsure beyond a count [m or rad]
    changes: float = 0.0  # energy that the encoder leaves unsure, up to the last change of torque [J]
    unsure: float = 0.0  # how much less than booked may have come in so far [J]: encoder counts and lost samples
    dissipated: float = 0.0  # by the device for certain, and not forgotten [J]
    kept: int = 0  # holds in the history
    newest: int = 0  # their newest place
    first: int = 0  # place of the torque that acts next in `BoundMemory.under_way`
    upward: float = nan  # `outward` along +, of a coarse encoder; NaN until it is asked for [m or rad]
    downward: float = nan  # the same along -


class BoundMemory(NamedTuple):
    """Where the bound keeps sequences; changed in place."""

    displacements: Buffer  # of the last holds, a ring of `WINDOW` [m or rad]
    torques: Buffer  # held in them [N or N*m]
    under_way: Buffer  # torques sent, the ring of `Commands` [N or N*m]
    held_on: Buffer  # torques that may act instead where frames are lost, shape (losses + delay,) [N or N*m]


def bound_memory(declared: Declared, under_way: Buffer, make_buffer: MakeBuffer) -> BoundMemory:
    """Returns the buffers of a bound on the torque under way."""
    window = WINDOW if declared.encoder_count > 0.0 else 0
    held_on = declared.losses + declared.delay if declared.losses else 0
    return BoundMemory(make_buffer(window), make_buffer(window), under_way, make_buffer(held_on))


def end_hold(declared: Declared, bound: TorqueBound, memory: BoundMemory, displacement: float, torque: float) -> None:
    """Takes the hold that ended: displacement [m or rad] and the torque held in it [N or N*m]."""
    count = declared.encoder_count
    if declared.damping > 0.0:
        certain = abs(displacement) - count
        if certain > 0.0:
            bound.dissipated += declared.damping / declared.sample_time * certain * certain
    if count > 0.0:
        half = 0.5 * count
        bound.changes = changes = bound.changes + half * abs(torque - bound.torque)
        bound.unsure = changes + half * abs(torque)
        newest = bound.newest + 1
        if newest == WINDOW:
            newest = 0
        bound.newest = newest
        memory.displacements[newest] = displacement
        memory.torques[newest] = torque
        if bound.kept < WINDOW:
            bound.kept += 1
        bound.upward = bound.downward = nan
    bound.blur = 0.0
    bound.displacement, bound.torque = displacement, torque


def end_gap(
    declared: Declared,
    bound: TorqueBound,
    displacement: float,
    torque: float,
    holds: int,
    largest: float,
    apart: float,
) -> float:
    """Takes several holds of which only the whole displacement is known; returns the energy in doubt [J].

    In all but the last hold, whose torque was read back, any torque sent may have acted, and the one before them where
    commands may be lost. The energy is wrong by at most the difference of the torques times the excursion in the hold.
    The displacement alone does not bound it, as a reversal has next to none: the reach of the hand in the others does,
    or its speed, or what the device dissipates in an excursion.

    Args:
        declared: Of axis and hand.
        bound: Changed.
        displacement: In all of them [m or rad].
        torque: Held in the last of them [N or N*m].
        holds: How many.
        largest: Size of the torques sent for them [N or N*m].
        apart: Largest difference of one of those from the last [N or N*m].
    """
    count, missed = declared.encoder_count, holds - 1
    if declared.losses:
        largest, apart = max(largest, abs(bound.torque)), max(apart, abs(bound.torque - torque))
    bound.kept = 0
    bound.upward = bound.downward = nan
    if declared.by_hand_force:
        response = declared.response
        step = (response.before + response.during) * largest + response.hand
        start = abs(bound.displacement) + bound.blur + count
        excursion = abs(displacement) + count + holds * (start + holds * step)
        bound.blur = 0.5 * missed * step + (1.0 - response.retained) * holds * excursion
        doubt = missed * apart * excursion
    elif declared.hand_speed > 0.0:
        doubt = missed * apart * declared.hand_speed * declared.sample_time
    else:  # damping alone; see `lost_samples`
        stiffness, certain = declared.damping / declared.sample_time, abs(displacement) - count
        if certain > 0.0:
            bound.dissipated += stiffness * certain * certain / holds
        doubt = missed * apart * ((abs(displacement) + count) / holds + apart / (4.0 * stiffness))
    bound.changes += holds * count * largest
    bound.unsure = bound.changes + 0.5 * count * abs(torque)
    bound.displacement, bound.torque = displacement / holds, torque
    return doubt


class Dissipated(Protocol):
    """What remembers how much the device dissipated for certain, and not forgotten [J]."""

    dissipated: float


def keep(bound: Dissipated, energy: float, enough: float) -> None:
    """Forgets what the device dissipated beyond `enough` [J] together with `energy`.

    Without it a contact could live, and buzz, on what the device dissipated long ago.
    """
    if energy + bound.dissipated > enough:
        bound.dissipated = max(0.0, enough - energy)


def free_energy(declared: Declared, bound: TorqueBound, memory: BoundMemory, energy: float) -> float:
    """Returns how much of `energy` [J] is not needed by the certificates of the torques under way."""
    delay, losses = declared.delay, declared.losses
    if delay == 0 and losses == 0:
        return energy + bound.dissipated
    if losses == 0:
        hand, path, squares = needed(declared, bound, memory, memory.under_way, bound.first, delay)
        free = energy - hand if declared.by_hand_force else 0.0
    elif delay > 1:  # some of the torques under way may act, and others not
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
    if declared.hand_speed > 0.0:
        free = max(free, energy - declared.hand_speed * declared.sample_time * path)
    if declared.damping > 0.0:
        share = declared.sample_time / (4.0 * declared.damping)
        free = max(free, energy + bound.dissipated - share * squares)
    return free if free > 0.0 else 0.0


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
    if declared.by_hand_force and sizes > 0.0:
        hand = worst_out(declared, bound, memory, 1.0, torques, first, count)
        hand += worst_out(declared, bound, memory, -1.0, torques, first, count)
    return hand, sizes, squares


def outward(declared: Declared, bound: TorqueBound, memory: BoundMemory, sign: float) -> float:
    """Returns the largest displacement of the hold that ended, counted along `sign` [m or rad].

    The displacement is known to one count. A mean over j holds is known to count / j, and the hand and the torques
    can have raised the last one above the mean only so far; the smallest of these bounds counts.
    """
    if declared.encoder_count == 0.0 or bound.kept < 2:
        return sign * bound.displacement + declared.encoder_count + bound.blur
    known = bound.upward if sign > 0.0 else bound.downward
    if isnan(known):
        known = outward_by_windows(declared, bound, memory, sign)
        if sign > 0.0:
            bound.upward = known
        else:
            bound.downward = known
    return known


def outward_by_windows(declared: Declared, bound: TorqueBound, memory: BoundMemory, sign: float) -> float:
    """Returns the smallest of the bounds by the mean over the last 1, 2, 3, ... holds [m or rad]."""
    response, count = declared.response, declared.encoder_count
    lost, enough = 1.0 - response.retained, 2.0 * count
    later = sign * bound.torque if sign * bound.torque > 0.0 else 0.0
    total = least = sign * bound.displacement + count
    raised = raises = 0.0
    start = bound.newest + 1
    for holds in range(2, bound.kept + 1):  # the newest is taken; an index below 0 wraps, as a ring does
        along, push = sign * memory.displacements[start - holds], sign * memory.torques[start - holds]
        if push < 0.0:
            push = 0.0
        raised += response.before * push + response.during * later + response.hand
        if along < count:
            raised += lost * (count - along)
        raises += raised
        total += along
        mean = (total + raises) / holds
        if mean < least:
            least = mean
        if raised * holds > enough:
            break
        later = push
    return least


def worst_out(
    declared: Declared, bound: TorqueBound, memory: BoundMemory, sign: float, torques: Buffer, first: int, count: int
) -> float:
    """Returns the most energy [J] that a sequence of torques may give out along `sign`, >= 0; see `needed`."""
    acts = False
    for place in range(first, first + count):
        if sign * torques[place] > 0.0:
            acts = True
    if not acts:
        return 0.0
    displacement, before = outward(declared, bound, memory, sign), sign * bound.torque
    worst = given = 0.0
    for place in range(first, first + count):
        along = sign * torques[place]
        displacement = next_displacement(displacement, before, along, declared.response)
        if along > 0.0:
            given += along * displacement
            if given > worst:
                worst = given
        before = along
    return worst


def may_act(declared: Declared, bound: TorqueBound, memory: BoundMemory, sign: float, hold: int) -> float:
    """Returns the largest torque along `sign` that may act in one of the next holds [N or N*m], >= 0.

    Any torque sent may stay for the declared losses.
    """
    most = 0.0
    for place in range(max(0, hold - declared.losses), min(hold, declared.delay) + 1):
        torque = sign * (memory.under_way[bound.first + place - 1] if place else bound.torque)
        if torque > most:
            most = torque
    return most


def given_by_any(
    declared: Declared, bound: TorqueBound, memory: BoundMemory, sign: float, holds: int
) -> tuple[float, float]:
    """Returns what any mix of torques along `sign` may give out [J], and the base of one after them [m or rad].

    What one of them would take in is not counted: another may act in its place.
    """
    displacement, before, given = outward(declared, bound, memory, sign), sign * bound.torque, 0.0
    for hold in range(1, holds + 1):
        along = may_act(declared, bound, memory, sign, hold)
        displacement = next_displacement(displacement, before, along, declared.response)
        if displacement > 0.0:
            given += along * displacement
        before = along
    return given, next_displacement(displacement, before, 0.0, declared.response)


def by_hand_force_of_any(
    declared: Declared, bound: TorqueBound, memory: BoundMemory, sign: float, energy: float
) -> float:
    """Returns `by_hand_force` where any mix of the torques under way may act."""
    given, base = given_by_any(declared, bound, memory, sign, declared.delay)
    energy -= given + given_by_any(declared, bound, memory, -sign, declared.delay)[0]
    largest = hand_force_bound(energy, base, declared.response.during)
    return min(largest, by_hand_force_if_held_on(declared, energy, base))


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
    response, before = declared.response, sign * bound.torque
    if declared.encoder_count > 0.0:
        displacement = outward(declared, bound, memory, sign)
    else:
        displacement = sign * bound.displacement + bound.blur
    if declared.delay:
        opposed = False
        for place in range(first, first + declared.delay):
            along = sign * torques[place]
            displacement = next_displacement(displacement, before, along, response)
            if along >= 0.0:
                energy -= along * displacement
            else:
                opposed = True
            before = along
        if opposed:
            energy -= worst_out(declared, bound, memory, -sign, torques, first, declared.delay)
    base = next_displacement(displacement, before, 0.0, response)
    largest = hand_force_bound(energy, base, response.during)
    if declared.losses:
        largest = min(largest, by_hand_force_if_held_on(declared, energy, base))
    return largest


def by_hand_force_if_held_on(declared: Declared, energy: float, base: float) -> float:
    """Returns the largest torque that may act in as many holds more as frames may be lost [N or N*m]."""
    response, largest = declared.response, inf
    friction = (1.0 - response.retained) * max(0.0, -base)
    for holds in range(2, declared.losses + 2):
        pairs = 0.5 * holds * (holds - 1)
        start = holds * base + pairs * (response.hand + friction)
        gain = holds * response.during + pairs * (response.before + response.during)
        largest = min(largest, hand_force_bound(energy, start, gain))
    return largest


def largest_torques(
    declared: Declared, bound: TorqueBound, memory: BoundMemory, sign: float, energy: float
) -> tuple[float, float, float]:
    """Returns the bound of each certificate along `sign` [N or N*m]: hand force, device damping, hand speed.

    0 where a certificate is not declared. `energy` [J] is what may be taken out.
    """
    losses, delay, torques, first = declared.losses, declared.delay, memory.under_way, bound.first
    force = damping = speed = 0.0
    if declared.by_hand_force:
        if losses and delay > 1:
            force = by_hand_force_of_any(declared, bound, memory, sign, energy)
        else:
            force = by_hand_force(declared, bound, memory, sign, energy, torques, first)
            if losses and delay:
                take_constant(memory, bound.torque)
                force = min(force, by_hand_force(declared, bound, memory, sign, energy, memory.held_on, 0))
    if losses:
        take_sizes(declared, bound, memory, delay)
        torques, first = memory.held_on, 0
    if declared.damping > 0.0:
        squares = 0.0
        for place in range(first, first + delay):
            squares += torques[place] * torques[place]
        energy_left = energy + bound.dissipated
        damping = device_damping_bound(energy_left, declared.damping, declared.sample_time, squares, losses + 1)
    if declared.hand_speed > 0.0:
        sizes = 0.0
        for place in range(first, first + delay):
            sizes += abs(torques[place])
        rest = energy - declared.hand_speed * declared.sample_time * sizes
        speed = hand_speed_bound(rest, declared.hand_speed, declared.sample_time, losses + 1)
    return force, damping, speed
