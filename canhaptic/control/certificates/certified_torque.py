"""Largest torque of one axis that is certified for the next hold, and the energy reserved for the queued torques.

A certificate is a proof that up to some torque the axis generates no energy. All certificates are combined: the
declared hand bounds the displacement, and the device dissipates energy. The budget is the energy received and the
device's certain dissipation, S = E + sum((b/T) D_i^2 + f_c |D_i|).

Statements and proofs: `docs/theory/torques_of_an_axis.md`. A4 is what a hold takes from the budget (`taken`), A5 the
largest torque, A10 all of them with late torques, uneven holds and lost frames (`taken_in_hold`), A12 the uncertainty
due to an encoder, with dry friction. The functions below write n for the part of a torque above f_c; in bound A of A10,
f_c is 0.
"""

from dataclasses import dataclass
from math import inf, isnan, nan, sqrt
from typing import Annotated, Final, NamedTuple, Protocol

from canhaptic.control.certificates import scalar_bounds
from canhaptic.control.certificates.scalar_bounds import (
    WINDOW,
    end_of_late,
    hand_force_bound,
    next_displacement,
    tail_reach,
)
from canhaptic.kernels import OFTEN_ZERO, Buffer, MakeBuffer, new

_WHOLE: Final = 1.0 - 1e-9
"""Fraction of an encoder count from which a displacement is a full count; below 1 only to allow for rounding."""


@dataclass(frozen=True, slots=True)
class Declared:
    """Declared properties of axis and hand on which the certificates rely."""

    sample_time: float  # longest hold [s]
    delay: int  # whole holds between computation and action
    losses: Annotated[int, OFTEN_ZERO]  # consecutive cycles without a new torque that the certificates survive
    by_hand_force: bool  # whether that certificate is declared
    response: scalar_bounds.DisplacementResponse  # for it
    damping: float  # certain damping of the device [N*s/m or N*m*s/rad]; 0: not declared
    hand_speed: float  # largest speed of the hand [m/s or rad/s]; 0: not declared
    encoder_count: float  # [m or rad]; 0: ideal
    late: Annotated[float, OFTEN_ZERO] = 0.0  # theta of `hold_timing`: window and lag of a new torque [s]
    late_share: float = 0.0  # the same as a part of the shortest hold
    left: float = 0.0  # c of `hold_timing`: share of older torques that is left after a hold
    friction: float = 0.0  # certain dry friction of the device [N or N*m]; 0: not declared
    by_hand_force_alone: bool = False  # whether no other certificate is declared


@dataclass(slots=True)
class TorqueBound:
    """Measured state from which the next torque is bounded: the hold that ended, and the uncertainty of the energy."""

    displacement: float = 0.0  # [m or rad]
    torque: float = 0.0  # [N or N*m]
    position_uncertainty: float = 0.0  # uncertainty of the displacement beyond a count [m or rad]
    changes: float = 0.0  # uncertain energy due to the encoder, up to the last change of torque [J]
    uncertainty: float = 0.0  # largest shortfall of the energy that came in so far [J]: encoder counts and lost samples
    dissipated: float = 0.0  # by the device for certain, and not forgotten [J]
    certain: float = 0.0  # the same, less the further uncertainty for an arbitrary hand [J]
    slope: float = 0.0  # of G, see the module [N or N*m]
    kept: int = 0  # holds in the history
    newest: int = 0  # their newest place
    first: int = 0  # place of the torque that acts next in `BoundMemory.under_way`
    upward: float = nan  # `outward` along +, of a coarse encoder; NaN until it is asked for [m or rad]
    downward: float = nan  # the same along -
    out: float = 0.0  # direction out of the contact, 1 or -1; 0: there is none
    turns: bool = False  # whether the outside can change in a hold that matters for the next torque
    is_near: bool = False  # whether the holds ahead can reach such a place
    above: float = inf  # from here to the end of the stretch in which the effort points one way [m or rad]
    below: float = inf  # the same downwards
    highest: float = 0.0  # torque that acts at the last SYNC at most; used where torques come late [N or N*m]
    lowest: float = 0.0  # the same, at least
    most: float = 0.0  # that counts as held in the hold that ended, along + [N or N*m]
    least: float = 0.0  # the same, along -
    resolution: float = 0.0  # width of the energy's uncertainty [J]: torques that came late, lost samples


class BoundMemory(NamedTuple):
    """Ring buffers of past displacements and torques from which the next torque is bounded; changed in place."""

    displacements: Buffer  # of the last holds, a ring of `WINDOW` [m or rad]
    torques: Buffer  # held in them; where torques come late, what counts along + [N or N*m]
    against: Buffer  # what counts along -, where torques come late
    under_way: Buffer  # torques sent, the ring of `Commands` [N or N*m]


def bound_memory(declared: Declared, under_way: Buffer, make_buffer: MakeBuffer) -> BoundMemory:
    """Return new ring buffers for an axis's torque bound; the queued torques stay in the given ring `under_way`."""
    window = WINDOW if declared.encoder_count > 0.0 else 0
    against = window if declared.late > 0.0 else 0
    return BoundMemory(make_buffer(window), make_buffer(window), make_buffer(against), under_way)


def look_for_turn(declared: Declared, bound: TorqueBound, memory: BoundMemory, moved: float, holds: float) -> None:
    """Set `bound.turns` if the environment's force may change direction in a hold that affects the next torque's bound.

    At such a reversal the way out of one contact is the way into another, so that the larger of the hand's pull and
    push is used in both directions. The hold that ended matters, because its forces still affect the next displacement;
    so do all holds up to one after that of the next torque. For the hold that ended, the result of the previous SYNC
    is used too: a hand that went beyond a crest and came back within the hold leaves no trace in the positions.

    Args:
        declared: Declared properties of axis and hand.
        bound: State of the axis's torque bound, with the interval in which the force keeps its direction; changed.
        memory: Buffers of the bound.
        moved: Displacement since the last position [m or rad].
        holds: Number of holds since then.
    """
    count = declared.encoder_count
    inside = bound.below > count and bound.above > count and bound.below > moved + count and bound.above > count - moved
    is_near = not inside or holds > 1.0 or reaches_turn(declared, bound, memory, 0.0)
    bound.turns, bound.is_near = is_near or bound.is_near, is_near
    if bound.turns:
        bound.kept = 0  # of the holds before the hand may have done more


def reaches_turn(declared: Declared, bound: TorqueBound, memory: BoundMemory, torque: float) -> bool:
    """Return whether the axis can reach a place where the force reverses, up to one hold after the next torque's."""
    up = down = 0.0
    for place in range(len(memory.under_way)):
        up, down = max(up, memory.under_way[place]), min(down, memory.under_way[place])
    up, down = max(up, torque, acted(declared, bound, 1.0)), max(-down, -torque, acted(declared, bound, -1.0))
    return reach(declared, bound, 1.0, up) >= bound.above or reach(declared, bound, -1.0, down) >= bound.below


def reach(declared: Declared, bound: TorqueBound, sign: float, torque: float) -> float:
    """Return how far the axis can move along `sign` by the end of the hold after the next torque's [m or rad].

    The given torque along `sign` [N or N*m] is assumed in every hold, with the hand's pull or push in that direction.
    """
    hand = declared.response.hand if sign * bound.out > 0.0 else declared.response.push
    displacement = sign * bound.displacement + declared.encoder_count + bound.position_uncertainty
    farthest = declared.encoder_count
    for _ in range(declared.delay + declared.losses + 2):
        displacement = next_displacement(displacement, torque, torque, declared.response, hand)
        farthest += max(0.0, displacement)
    return farthest


def displacement_by_hand(declared: Declared, bound: TorqueBound, sign: float) -> float:
    """Return what the hand's pull (outward) or push (inward) adds at most to a displacement along `sign` [m or rad]."""
    if sign * bound.out < 0.0 or bound.turns:
        return declared.response.push
    return declared.response.hand


def acted(declared: Declared, bound: TorqueBound, sign: float) -> float:
    """Return a constant torque along `sign` that moves the axis no less than the last hold's torques did [N or N*m]."""
    if declared.late > 0.0:
        return bound.most if sign > 0.0 else -bound.least
    return sign * bound.torque


def end_hold(
    declared: Declared,
    bound: TorqueBound,
    memory: BoundMemory,
    displacement: float,
    torque: float,
    hold_length: float = 1.0,
) -> float:
    """Update the torque bound with a hold's displacement [m or rad], torque [N or N*m] and length [sample times].

    Returns:
        Largest amount by which the booked energy may exceed the received energy, because the torque acted late [J].
    """
    count, late, uncertainty = declared.encoder_count, declared.late, 0.0
    if declared.damping:
        certain = abs(displacement) - count
        if certain > 0.0:
            dissipate(bound, declared.damping / declared.sample_time * certain * certain)
    if declared.friction and not count:
        dissipate(bound, declared.friction * abs(displacement))
    if late:
        uncertainty = uncertainty_of_late(declared, bound, displacement, torque, hold_length)
        take_late(declared, bound, torque)
    if count:
        pass_within_count(bound, count, declared.friction, displacement, torque)
        newest = bound.newest + 1
        if newest == WINDOW:
            newest = 0
        bound.newest = newest
        memory.displacements[newest] = displacement
        memory.torques[newest] = torque
        if late:
            memory.torques[newest] = bound.most
            memory.against[newest] = bound.least
        if bound.kept < WINDOW:
            bound.kept += 1
        bound.upward = bound.downward = nan
    bound.position_uncertainty = 0.0
    bound.displacement, bound.torque = displacement, torque
    return uncertainty


def dissipate(bound: TorqueBound, energy: float) -> None:
    """Add energy that the device certainly dissipated [J] to the budget of the certificates."""
    bound.dissipated += energy
    bound.certain += energy


def certain_dissipation(bound: TorqueBound) -> float:
    """Return the device's dissipation that a certificate for an arbitrary hand may use, less uncertainty [J]."""
    return min(bound.certain, bound.dissipated)


def pass_within_count(bound: TorqueBound, count: float, friction: float, displacement: float, torque: float) -> None:
    """Add what dry friction dissipated in a hold, less the energy error of one encoder count; see G in the module.

    Args:
        bound: State of the axis's torque bound; changed.
        count: Encoder count [m or rad].
        friction: Certain dry friction of the device [N or N*m].
        displacement: Displacement in the hold [m or rad].
        torque: Torque held in it [N or N*m].
    """
    half, slope, earned = 0.5 * count, -torque, friction * abs(displacement)
    if displacement >= _WHOLE * count:
        slope += friction
    elif displacement <= -_WHOLE * count:
        slope -= friction
    else:
        earned = -earned
        slope += min(max(bound.slope + torque, -friction), friction)
    earned -= half * abs(slope - bound.slope)
    if earned > 0.0:
        dissipate(bound, earned)
    else:
        bound.changes -= earned
    bound.slope, bound.uncertainty = slope, bound.changes + half * abs(slope)


def shorten(declared: Declared, bound: TorqueBound, hold_length: float) -> None:
    """Scale the stored displacement of a hold longer than T to one sample time, to bound the next displacements.

    The axis is assumed to move at the mean speed of the whole hold; the possible difference is kept as an uncertainty.

    Args:
        declared: Declared properties of axis and hand.
        bound: State of the axis's torque bound, after `end_hold`.
        hold_length: Length of the hold, > 1 [sample times].
    """
    response, torque = declared.response, abs(bound.torque)
    if declared.late > 0.0:
        torque = max(torque, bound.most, -bound.least)
    hand = response.push if response.push < inf else response.hand
    step = (response.before + response.during) * torque + hand
    excursion = abs(bound.displacement) + declared.encoder_count + hold_length * hold_length * step
    bound.displacement /= hold_length
    bound.position_uncertainty = 0.5 * (hold_length - 1.0) * step
    bound.position_uncertainty += (1.0 - response.retained + (response.growth - 1.0)) * excursion
    bound.kept = 0
    if declared.damping > 0.0:  # the mean speed is known, and its square is no more than the mean of the squares
        certain = abs(bound.displacement) * hold_length - declared.encoder_count
        if certain > 0.0:
            dissipate(bound, -declared.damping / declared.sample_time * certain * certain * (1.0 - 1.0 / hold_length))


def take_late(declared: Declared, bound: TorqueBound, torque: float) -> None:
    """Store the range of torques that acted in the last hold, and of those that still act at its end [N or N*m]."""
    above, below = bound.highest - torque, torque - bound.lowest
    counts, left = declared.response.late, declared.left
    bound.most = bound.highest = bound.least = bound.lowest = torque
    if above > 0.0:
        bound.most += counts * above
        bound.highest += left * above
    if below > 0.0:
        bound.least -= counts * below
        bound.lowest -= left * below


def uncertainty_of_late(
    declared: Declared, bound: TorqueBound, displacement: float, torque: float, hold_length: float = 1.0
) -> float:
    """Return by how much the booked energy may exceed the received energy in a hold whose torque acted late [J].

    See `scalar_bounds`. The bound of the hand's force is used only in the direction out of the contact. Without it, and
    without a hand speed, no motion inside a hold is bounded. The promise at the handle, by damping and dry friction of
    the device, needs no such bound: it covers each torque at every instant. With friction alone an estimate is
    subtracted, for an axis at most twice as fast as the mean of this hold or the previous one; `AxisMeter` adds the
    uncertainty at the motor for the largest speed of the axis.

    Args:
        declared: Declared properties of axis and hand.
        bound: State of the axis's torque bound before the hold; `resolution` and `dissipated` change.
        displacement: Displacement in the hold [m or rad].
        torque: Torque held in it [N or N*m].
        hold_length: Length of the hold [sample times].
    """
    change = torque - bound.torque
    rest = max(bound.highest - bound.torque, bound.torque - bound.lowest)
    differs = abs(change) + rest
    if differs == 0.0:
        return 0.0
    count = declared.encoder_count
    if declared.damping == 0.0:
        damped = differs * declared.late_share * 2.0 * (max(abs(displacement), abs(bound.displacement)) + count)
    else:
        path = (abs(displacement) + count) * declared.late_share
        damped = differs * path + differs * differs * declared.late / (4.0 * declared.damping)
    if declared.by_hand_force:
        sign = -1.0 if bound.out < 0.0 else 1.0
        up, down = reach_by_older_torques(declared, bound, sign, displacement, torque, hold_length)
        further = rest * max(up, down)
        if hold_length == 1.0:
            up, down = between_ends(declared, bound, sign, displacement, torque, (up, down))
        change *= sign
        less, more = (change * down, change * up) if change > 0.0 else (-change * up, -change * down)
        less, more = less + further, more + further
    elif declared.hand_speed > 0.0:
        less = more = differs * declared.hand_speed * declared.late
    else:
        bound.resolution += 2.0 * damped
        return damped
    bound.resolution += less + more
    if declared.damping > 0.0:  # a promise to every hand rests on no hand
        bound.certain += less - damped
    return less


def reach_by_older_torques(
    declared: Declared, bound: TorqueBound, sign: float, displacement: float, torque: float, hold_length: float
) -> tuple[float, float]:
    """Return how far the axis can have moved under older torques in a hold, along `sign` and against it [m or rad].

    In a hold of n sample times torque and hand have n times as long to move the axis away and back to the measured
    position, so that the way back grows n times; s of `scalar_bounds` grows at most to 1 + 2 n times its excess over 1
    in one sample time.

    Args:
        declared: Declared properties of axis and hand.
        bound: State of the axis's torque bound before the hold.
        sign: Direction in which the hand's force is bounded, 1 or -1.
        displacement: Displacement in the hold [m or rad].
        torque: Torque held in it [N or N*m].
        hold_length: Length of the hold [sample times].
    """
    response, count, hand = declared.response, declared.encoder_count, displacement_by_hand(declared, bound, sign)
    if hand == inf:  # no run begins so
        hand = response.hand
    acting = max(0.0, sign * torque, bound.highest if sign > 0.0 else -bound.lowest)
    start = sign * bound.displacement + count + bound.position_uncertainty
    up = tail_reach(start, acted(declared, bound, sign), acting, response, hand)
    back = count - sign * displacement
    down = hold_length * (response.tail_before * acting + response.tail_hand * hand)
    if back > 0.0:
        down += response.share * back
    swing = response.swing if hold_length == 1.0 else 1.0 + 2.0 * hold_length * (response.swing - 1.0)
    return up, swing * down


def between_ends(
    declared: Declared, bound: TorqueBound, sign: float, displacement: float, torque: float,
    reached: tuple[float, float],
) -> tuple[float, float]:  # fmt: skip
    """Return the same as `reach_by_older_torques` for the torque before alone, by both ends of its lateness [m or rad].

    Each is less than 0 where the axis has moved the other way for certain. `reached` is the result of
    `reach_by_older_torques`; the other arguments are the same.
    """
    response, (up, down) = declared.response, reached
    longest, late, moved, count = declared.sample_time, declared.late, sign * displacement, declared.encoder_count
    pull, push = displacement_by_hand(declared, bound, sign), displacement_by_hand(declared, bound, -sign)
    high, low = max(torque, bound.highest), min(torque, bound.lowest)
    along, against = (high, -low) if sign > 0.0 else (-low, high)
    if pull < inf:
        force = response.per_hand * pull + (along if along > 0.0 else 0.0)
        down = min(down, -end_of_late(moved - count, longest, late, force, response))
    if push < inf:
        force = response.per_hand * push + (against if against > 0.0 else 0.0)
        up = min(up, -end_of_late(-moved - count, longest, late, force, response))
    return up, down


def end_gap(
    declared: Declared, bound: TorqueBound, displacement: float, torque: float, holds: int, largest: float,
    apart: float,
) -> float:  # fmt: skip
    """Update the torque bound with holds of which only the total displacement is known; return their energy error [J].

    The torque of the last hold was read back. In the others any torque sent may have acted, or the one before them if
    commands may be lost. The energy is wrong by at most the difference of the torques times the excursion in each hold.
    A reversal has a large excursion without displacement, so that the reach of the hand bounds it, or its speed, or the
    dissipation of the device in it.

    Args:
        declared: Declared properties of axis and hand.
        bound: State of the axis's torque bound; changed.
        displacement: Total displacement [m or rad].
        torque: Torque held in the last hold [N or N*m].
        holds: Number of holds.
        largest: Largest magnitude of the torques sent for these holds [N or N*m].
        apart: Largest difference between one of these torques and the last [N or N*m].
    """
    count, missed, damped = declared.encoder_count, holds - 1, 0.0
    if declared.losses:
        largest, apart = max(largest, abs(bound.torque)), max(apart, abs(bound.torque - torque))
    if declared.late > 0.0:
        missed, apart = holds + 2, spread_of_gap(bound, torque, apart)
        largest = max(largest, bound.highest, -bound.lowest)
    bound.kept = 0
    bound.upward = bound.downward = nan
    if declared.damping > 0.0:  # for every hand; see `group_account`
        stiffness, certain = declared.damping / declared.sample_time, abs(displacement) - count
        if certain > 0.0:
            dissipate(bound, stiffness * certain * certain / holds)
        damped = missed * apart * ((abs(displacement) + count) / holds + apart / (4.0 * stiffness))
    if declared.friction > 0.0:
        certain = abs(displacement) - count if abs(displacement) > count else 0.0
        dissipate(bound, declared.friction * certain - 0.5 * count * abs(bound.slope + bound.torque))
    if declared.by_hand_force:
        uncertainty = missed * apart * excursion_unseen(declared, bound, displacement, holds, largest)
    elif declared.hand_speed > 0.0:
        uncertainty = missed * apart * declared.hand_speed * declared.sample_time
    else:
        uncertainty = damped
    if declared.damping > 0.0:  # a promise to every hand rests on no hand
        bound.certain += uncertainty - damped
    bound.resolution += 2.0 * uncertainty
    bound.changes += holds * count * largest
    bound.slope, bound.uncertainty = -torque, bound.changes + 0.5 * count * abs(torque)
    bound.displacement, bound.torque = displacement / holds, torque
    return uncertainty


def spread_of_gap(bound: TorqueBound, torque: float, apart: float) -> float:
    """Widen the stored torque range to all that may have acted in holds without samples; return its width [N or N*m].

    A late torque u is at every instant a mean of torques in this range, which includes the torque f read back. By
    parts, the energy is wrong by the integral of (u - f) dx = [(u - f)(x - x_end)] - integral of (x - x_end) du. This
    is at most the width times the excursion, once for the change at the start of each hold and twice more.

    Args:
        bound: State of the axis's torque bound; changed.
        torque: Torque held in the last hold [N or N*m].
        apart: Largest difference between a torque sent for these holds and `torque` [N or N*m].
    """
    high = max(torque + apart, bound.torque, bound.highest)
    low = min(torque - apart, bound.torque, bound.lowest)
    bound.most = bound.highest = high
    bound.least = bound.lowest = low
    return high - low


def excursion_unseen(declared: Declared, bound: TorqueBound, displacement: float, holds: int, largest: float) -> float:
    """Return how far the axis can have moved away within several holds without samples [m or rad]; see `end_gap`.

    `bound.position_uncertainty` is set to the uncertainty of the last displacement.
    """
    response, further = declared.response, 1.0
    hand = response.push if response.push < inf else response.hand
    step = (response.before + response.during) * largest + hand
    for _ in range(holds):
        further *= response.growth
    start = abs(bound.displacement) + bound.position_uncertainty + declared.encoder_count
    excursion = abs(displacement) + declared.encoder_count + further * (holds * (start + holds * step))
    bound.position_uncertainty = 0.5 * (holds - 1) * step + (1.0 - response.retained) * holds * excursion
    bound.position_uncertainty += (further - 1.0) * excursion
    return excursion


class Dissipated(Protocol):
    """State with the energy that the device certainly dissipated, less what was discarded [J]."""

    dissipated: float


def keep(bound: Dissipated, energy: float, enough: float) -> None:
    """Limit the stored dissipation of the device, so that it raises the budget `energy` to at most `enough` [J].

    Otherwise a contact could vibrate on energy that the device dissipated long ago.
    """
    if energy + bound.dissipated > enough:
        bound.dissipated = min(bound.dissipated, max(0.0, enough - energy))


def outward(declared: Declared, bound: TorqueBound, memory: BoundMemory, sign: float) -> float:
    """Return the largest displacement along `sign` that is possible in the hold that ended [m or rad].

    The encoder gives the displacement to one count, and the mean over j holds to count / j. The forces of hand and
    torques bound how far the last displacement is from the mean; the smallest of the resulting bounds is returned.
    """
    if bound.kept < 2:  # of an ideal encoder none is kept
        return sign * bound.displacement + declared.encoder_count + bound.position_uncertainty
    known = bound.upward if sign > 0.0 else bound.downward
    if isnan(known):
        known = displacement_by_windows(declared, bound, memory, sign)
        if sign > 0.0:
            bound.upward = known
        else:
            bound.downward = known
    return known


def displacement_by_windows(declared: Declared, bound: TorqueBound, memory: BoundMemory, sign: float) -> float:
    """Return the smallest bound on the last displacement by means over 1, 2, ... holds [m or rad]; see `outward`."""
    response, count = declared.response, declared.encoder_count
    lost, enough, more = 1.0 - response.retained, 2.0 * count, response.growth - 1.0
    torques = memory.against if declared.late > 0.0 and sign < 0.0 else memory.torques
    hand, acting = displacement_by_hand(declared, bound, sign), acted(declared, bound, sign)
    later = acting if acting > 0.0 else 0.0
    total = least = sign * bound.displacement + count
    raised = raises = 0.0
    start = bound.newest + 1
    for holds in range(2, bound.kept + 1):  # the newest is taken; an index below 0 wraps, as a ring does
        along, push = sign * memory.displacements[start - holds], sign * torques[start - holds]
        if push < 0.0:
            push = 0.0
        raised += response.before * push + response.during * later + hand
        if along < count:
            raised += lost * (count - along)
        if more > 0.0 and along > -count:
            raised += more * (along + count)
        raises += raised
        total += along
        mean = (total + raises) / holds
        if mean < least:
            least = mean
        if raised * holds > enough:
            break
        later = push
    return least


def taken(declared: Declared, torque: float, reach: float) -> float:
    """Return the most that a torque can take from the budget in a hold, net of the device's dissipation in it: A4 [J].

    Args:
        declared: Declared properties of axis and hand.
        torque: Torque along the direction, >= 0 [N or N*m].
        reach: Largest displacement along it [m or rad]; infinite: unknown.
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


def taken_by_queue(
    declared: Declared, bound: TorqueBound, memory: BoundMemory, sign: float, speed: float
) -> tuple[float, float]:
    """Return what the queued torques along `sign` can take from the budget [J], and the next displacement (base).

    The axis may still move inward before it moves outward: at any time they have taken at most this energy, or 0.
    The base is the largest displacement in the next hold without a torque [m or rad], infinite for an unknown hand.
    `speed` is the largest speed of the hand [m/s or rad/s]; 0: not used.
    """
    response, torques, first = declared.response, memory.under_way, bound.first
    hand = displacement_by_hand(declared, bound, sign) if declared.by_hand_force else inf
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


def free_of_even_holds(declared: Declared, bound: TorqueBound, memory: BoundMemory, energy: float) -> float:
    """Return `energy` plus the device's dissipation, less what the queued torques can take from it, >= 0 [J]."""
    free = energy + bound.dissipated
    if declared.delay:
        pushes = pulls = False
        for place in range(bound.first, bound.first + declared.delay):
            pushes = pushes or memory.under_way[place] > 0.0
            pulls = pulls or memory.under_way[place] < 0.0
        if pushes:  # else they take nothing that way
            free -= max(0.0, taken_by_queue(declared, bound, memory, 1.0, declared.hand_speed)[0])
        if pulls:
            free -= max(0.0, taken_by_queue(declared, bound, memory, -1.0, declared.hand_speed)[0])
    return free if free > 0.0 else 0.0


def largest_of_even_holds(
    declared: Declared, bound: TorqueBound, memory: BoundMemory, sign: float, energy: float
) -> tuple[float, float, float]:
    """Return the largest torques along `sign` by all certificates, by those for any hand, and by all but hand speed.

    All three are in [N or N*m].

    Args:
        declared: Declared properties of axis and hand.
        bound: State of the axis's torque bound.
        memory: Buffers of the bound.
        sign: 1 or -1.
        energy: Energy budget, without the device's dissipation [J].
    """
    by_any = 0.0  # largest energy that the queued torques take, for an arbitrary hand
    for place in range(bound.first, bound.first + declared.delay):
        by_any += taken(declared, abs(memory.under_way[place]), inf)
    for_all = torque_for_any_hand(declared, energy + certain_dissipation(bound) - by_any)
    energy += bound.dissipated
    by_force = for_all
    damped, friction, gain = declared.damping / declared.sample_time, declared.friction, declared.response.during
    if declared.by_hand_force:
        budget, base = budget_after_queue(declared, bound, memory, sign, energy, 0.0)
        any_hand = torque_for_any_hand(declared, budget)
        by_force = max(for_all, any_hand, torque_by_reach(damped, friction, gain, budget, base, any_hand))
    if declared.hand_speed == 0.0:
        return by_force, for_all, by_force
    budget, base = budget_after_queue(declared, bound, memory, sign, energy, declared.hand_speed)
    any_hand = torque_for_any_hand(declared, budget)
    largest = max(by_force, any_hand, torque_by_reach(damped, friction, gain, budget, base, any_hand))
    if budget > 0.0:
        fastest = declared.hand_speed * declared.sample_time
        largest = max(largest, torque_by_hand_speed(damped, friction, budget, fastest, any_hand))
    return largest, for_all, by_force


def budget_after_queue(
    declared: Declared, bound: TorqueBound, memory: BoundMemory, sign: float, energy: float, speed: float
) -> tuple[float, float]:
    """Return the budget that the queued torques leave [J], and the next displacement (base of `taken_by_queue`)."""
    given, base = taken_by_queue(declared, bound, memory, sign, speed)
    energy -= given
    for place in range(bound.first, bound.first + declared.delay):
        if sign * memory.under_way[place] < 0.0:
            energy -= max(0.0, taken_by_queue(declared, bound, memory, -sign, speed)[0])
            break
    return energy, base


def torque_for_any_hand(declared: Declared, budget: float) -> float:
    """Return the largest torque that a budget [J] and the device's dissipation permit for any hand [N or N*m]."""
    if budget <= 0.0:
        return declared.friction
    return declared.friction + sqrt(4.0 * declared.damping / declared.sample_time * budget)


def torque_by_reach(damped: float, friction: float, gain: float, budget: float, base: float, for_all: float) -> float:
    """Return the largest torque that the reach of the hand's force permits [N or N*m]; 0 if `base` is infinite.

    For torques l W of a group, `damped`, `gain` and `base` are in [J], and the result is the share l.

    Args:
        damped: Certain damping over the sample time [N/m or N*m/rad].
        friction: Certain dry friction [N or N*m].
        gain: Displacement per torque in the hold [m/N or rad/(N*m)].
        budget: Energy that may be taken, the device's dissipation included [J].
        base: Largest displacement in the hold without a torque [m or rad].
        for_all: Largest torque for any hand [N or N*m].
    """
    if base == inf:
        return 0.0
    if budget < 0.0:
        return hand_force_bound(budget, base, gain)
    share = damped * gain
    largest = hand_force_bound(
        budget + (friction + damped * base) * base, base * (1.0 - 2.0 * share) - friction * gain, gain * (1.0 - share)
    )
    if 2.0 * damped * (base + gain * largest) > largest - friction:
        return for_all
    return largest


def torque_by_hand_speed(damped: float, friction: float, budget: float, fastest: float, for_all: float) -> float:
    """Return the largest torque for a hand that moves no farther than `fastest` [m or rad] in a hold [N or N*m].

    The other arguments are those of `torque_by_reach`.
    """
    largest = friction + budget / fastest + damped * fastest
    return for_all if 2.0 * damped * fastest > largest - friction else largest


class LateMotion(NamedTuple):
    """Largest displacement along the torque in a hold, and the torques that act in it."""

    displacement: float  # in that hold; infinite: the hand is unknown [m or rad]
    counted: float  # torque that counts as held in it, >= 0 [N or N*m]
    highest: float  # torque along that acts at its end at most, >= 0 [N or N*m]
    lowest: float  # at least, >= 0; 0 where one acts against


def torque_by_late_reach(declared: Declared, hand: float, motion: LateMotion, friction: float, energy: float) -> float:
    """Return by how much the next torque may exceed `friction` if torques act late [N or N*m]: n of bound A or B.

    Bound A is used if `friction` is 0, else bound B.

    Args:
        declared: Declared properties of axis and hand.
        hand: Displacement due to the hand's largest force [m or rad].
        motion: Motion in the last queued hold.
        friction: Dry friction, which covers the rest of every torque [N or N*m].
        energy: Energy budget [J].
    """
    if declared.losses:
        return torque_if_repeated(declared, hand, motion, friction, energy)
    largest = torque_above_older(declared, hand, motion, friction, energy)
    older = motion.highest - friction
    if largest < older:
        largest = min(older, torque_below_older(declared, hand, motion, friction, energy))
    return min(largest, absorbing_torque(declared, hand, motion, friction, energy)) if energy < 0.0 else largest


def own_share(
    declared: Declared, hand: float, motion: LateMotion, friction: float
) -> tuple[float, float, float, float]:
    """Return (start, gain, base, late): the next torque n alone takes n (start + gain n) from the budget [J].

    It takes n D + (n - l) x and its tail n X, with D = base + during F the displacement in its hold, F = n + f_c and
    x = late. An outward displacement adds to the tail; `start` leaves this part out.
    """
    response, displacement = declared.response, motion.displacement
    base = next_displacement(displacement, motion.counted, 0.0, response, hand) + response.during * friction
    late = -response.behind * displacement if displacement < 0.0 else 0.0
    gain = response.during + response.tail_before + response.tail_during
    start = base + late + response.tail_hand * hand + (response.tail_before + response.tail_during) * friction
    return start, gain, base, late


def absorbing_torque(declared: Declared, hand: float, motion: LateMotion, friction: float, energy: float) -> float:
    """Return the n of `torque_by_late_reach` for a budget below zero: the torque itself must absorb energy [N or N*m].

    Older torques push the axis while it acts, with a share of `late` in its hold and `left` after it. For n below
    -start / gain the axis moves inward in the hold, so that this motion adds nothing to the tail.
    """
    response = declared.response
    start, gain, _, _ = own_share(declared, hand, motion, friction)
    start += (response.during + response.tail_before) * response.late * motion.highest
    start += response.tail_during * declared.left * motion.highest
    return hand_force_bound(energy, start, gain)


def torque_above_older(declared: Declared, hand: float, motion: LateMotion, friction: float, energy: float) -> float:
    """Return the n of `torque_by_late_reach` if the next torque is not below the older ones; same arguments."""
    start, gain, base, late = own_share(declared, hand, motion, friction)
    energy += max(0.0, motion.lowest - friction) * late
    share = declared.response.share
    largest = hand_force_bound(energy, start + share * base, gain + share * declared.response.during)
    return min(largest, hand_force_bound(energy, start, gain))


def torque_below_older(declared: Declared, hand: float, motion: LateMotion, friction: float, energy: float) -> float:
    """Return the n of `torque_by_late_reach` if the next torque is below the older ones; same arguments.

    With g the largest older part above f_c, it takes n D + (g - n) X_0 + (n - l) x and the tail G X, where
    D = base + during (late g + (1 - late) F), G = c g + (1 - c) n, and (n - l) x is at most n x (g - l) / g.
    All terms are convex in n and equal those of `torque_above_older` at n = g.
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


def torque_if_repeated(declared: Declared, hand: float, motion: LateMotion, friction: float, energy: float) -> float:
    """Return the n of `torque_by_late_reach` if lost frames may let the torque act in several holds; same arguments.

    With D_i the displacements in them, g the older torques above f_c and X as in `scalar_bounds`, it takes n sum(D_i) +
    g X_1 + c g sum(X_i) + n x and its tail (n + c g) X; each X_i after the first is at most that of the sum of all
    outward displacements. If the new torque is lost, the older ones stay; they were certified for this.
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
    response: scalar_bounds.DisplacementResponse, base: float, gain: float, hand: float, friction: float, holds: int
) -> tuple[float, float, float]:
    """Return the largest total displacement over several holds of one torque, as a linear function of the torque.

    Args:
        response: Displacement response of the axis.
        base: Displacement in the first hold without the torque [m or rad].
        gain: Displacement in the first hold per unit torque.
        hand: Displacement due to the hand's largest force in two holds [m or rad].
        friction: Largest increase of an inward displacement in a hold by friction [m or rad].
        holds: Number of holds.

    Returns:
        (Sum without the torque [m or rad], increase of the sum per torque [m/N or rad/(N*m)], sum without the torque
        and without inward displacements [m or rad]).
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


def pass_hold(
    declared: Declared, hand: float, speed: float, motion: LateMotion, most: float, least: float
) -> tuple[LateMotion, float]:
    """Return the largest motion in the next hold, and the most its torques take from the budget, net of losses [J].

    Args:
        declared: Declared properties of axis and hand.
        hand: Displacement due to the hand's largest force [m or rad]; infinite: unknown.
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
    """Return the most that a hold's torques can take from the budget: the least of bounds A to D in the module [J].

    `following` is the displacement in the hold [m or rad]; the other arguments are those of `pass_hold`.
    """
    friction, hold, late, taken = declared.friction, declared.sample_time, declared.late, inf
    net = most - friction if most > friction else 0.0
    older = motion.highest - friction if motion.highest > friction else 0.0
    if hand < inf:
        reach = tail_reach(motion.displacement, motion.counted, max(most, motion.highest), declared.response, hand)
        taken = taken_by_reach(declared, motion, 0.0, most, least, following, reach)
        taken = min(taken, taken_by_reach(declared, motion, friction, most, least, following, reach))
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


def taken_by_reach(
    declared: Declared, motion: LateMotion, friction: float, most: float, least: float, following: float, reach: float
) -> float:
    """Return the most that a hold's torques can take from the budget [J]: bound A, or B if friction is not 0."""
    most, least = max(0.0, most - friction), max(0.0, least - friction)
    highest, lowest = motion.highest - friction, max(0.0, motion.lowest - friction)
    taken = (most if following > 0.0 else least) * following
    if highest > least:
        taken += (highest - least) * reach
    if most > lowest and motion.displacement < 0.0:
        taken -= (most - lowest) * declared.response.behind * motion.displacement
    return taken


def taken_by_tail(declared: Declared, hand: float, speed: float, motion: LateMotion) -> float:
    """Return the most that late torques, which still act after the last hold, can take from the budget [J]."""
    net = motion.highest - declared.friction
    if declared.late == 0.0 or net <= 0.0:
        return 0.0
    taken = inf
    if hand < inf:
        taken = net * tail_reach(motion.displacement, motion.counted, motion.highest, declared.response, hand)
    if declared.damping > 0.0:
        taken = min(taken, declared.late * net * net / (4.0 * declared.damping))
    return min(taken, speed * declared.late * net) if speed > 0.0 else taken


def largest_acting(declared: Declared, bound: TorqueBound, memory: BoundMemory, sign: float, hold: int) -> float:
    """Return the largest torque along `sign` that may act in a future hold [N or N*m], >= 0; hold 1 is the next.

    If frames are lost, a torque acts longer: by at most as many holds as losses are declared.
    """
    most = 0.0
    for place in range(max(0, hold - declared.losses), min(hold, declared.delay) + 1):
        torque = sign * (memory.under_way[bound.first + place - 1] if place else bound.torque)
        if torque > most:
            most = torque
    return most


def smallest_acting(declared: Declared, bound: TorqueBound, memory: BoundMemory, sign: float, hold: int) -> float:
    """Return the smallest torque along `sign` that may act in a future hold [N or N*m], >= 0; hold 1 is the next."""
    least = inf
    for place in range(max(0, hold - declared.losses), min(hold, declared.delay) + 1):
        least = min(least, sign * (memory.under_way[bound.first + place - 1] if place else bound.torque))
    return least if 0.0 < least < inf else 0.0


def taken_under_way(
    declared: Declared, bound: TorqueBound, memory: BoundMemory, sign: float, speed: float, holds: int, which: int
) -> tuple[float, float, LateMotion]:
    """Return the most [J] that queued torques along `sign` take by the end, and at any time, and the last motion.

    The second value includes torques that still act after the last hold.

    Args:
        declared: Declared properties of axis and hand.
        bound: State of the axis's torque bound.
        memory: Buffers of the bound.
        sign: 1 or -1.
        speed: Largest speed of the hand; 0: not used [m/s or rad/s].
        holds: Number of holds in which they act.
        which: Torques assumed in all holds: `_ANY`: all that may act; `_SENT`: next queued; `_HELD_ON`: last held.
    """
    hand = displacement_by_hand(declared, bound, sign) if declared.by_hand_force else inf
    highest, lowest = (bound.highest, bound.lowest) if sign > 0.0 else (-bound.lowest, -bound.highest)
    displacement, counted = outward(declared, bound, memory, sign) if hand < inf else inf, acted(declared, bound, sign)
    motion = new(LateMotion, (displacement, max(0.0, counted), max(0.0, highest), max(0.0, lowest)))
    total = worst = 0.0
    for hold in range(1, holds + 1):
        if which == _ANY:
            most = largest_acting(declared, bound, memory, sign, hold)
            least = most if declared.losses == 0 else smallest_acting(declared, bound, memory, sign, hold)
        else:
            most = least = max(0.0, sign * (memory.under_way[bound.first] if which == _SENT else bound.torque))
        motion, taken = pass_hold(declared, hand, speed, motion, most, least)
        total += taken
        worst = max(worst, total)
    return total, max(worst, total + taken_by_tail(declared, hand, speed, motion)), motion


def budget_for_any_hand(
    declared: Declared, bound: TorqueBound, memory: BoundMemory, energy: float, holds: int
) -> float:
    """Return the budget `energy` less what the queued torques can give to an arbitrary hand [J].

    The integral of (u - f_c)+^2 is at most the sum of n_k^2 (T + theta), because u is a mean of the torques.
    """
    older = max(bound.highest, -bound.lowest) - declared.friction
    squares = declared.late * older * older if older > 0.0 else 0.0
    for hold in range(1, holds + 1):
        most = max(
            largest_acting(declared, bound, memory, 1.0, hold), largest_acting(declared, bound, memory, -1.0, hold)
        )
        if most > declared.friction:
            beyond = most - declared.friction
            squares += (declared.sample_time + declared.late) * (beyond * beyond)
    if squares == 0.0:
        return energy
    return energy - squares / (4.0 * declared.damping) if declared.damping > 0.0 else -inf


def free_of_late_torques(declared: Declared, bound: TorqueBound, memory: BoundMemory, energy: float) -> float:
    """Return the energy of `free_of_even_holds` [J] if torques come late or frames may be lost."""
    holds, known = declared.delay + declared.losses, energy + bound.dissipated
    free = 0.0
    if declared.by_hand_force or declared.hand_speed > 0.0:
        known -= taken_under_way(declared, bound, memory, 1.0, declared.hand_speed, holds, _ANY)[1]
        known -= taken_under_way(declared, bound, memory, -1.0, declared.hand_speed, holds, _ANY)[1]
        free = max(free, known)
    if declared.damping > 0.0 or declared.friction > 0.0:
        free = max(free, budget_for_any_hand(declared, bound, memory, energy + certain_dissipation(bound), holds))
    return free


def largest_of_late_torques(
    declared: Declared, bound: TorqueBound, memory: BoundMemory, sign: float, energy: float
) -> tuple[float, float, float]:
    """Return the torques of `largest_of_even_holds` [N or N*m] if torques come late or frames may be lost."""
    longest = (declared.sample_time + declared.late) * (declared.losses + 1)
    for_all = declared.friction
    left = budget_for_any_hand(declared, bound, memory, energy + certain_dissipation(bound), declared.delay)
    if left > 0.0:
        for_all += sqrt(4.0 * declared.damping * left / longest)
    known = energy + bound.dissipated
    by_force = for_all
    if declared.by_hand_force:
        by_force = max(for_all, torque_by_bounded_hand(declared, bound, memory, sign, known, 0.0))
    if declared.hand_speed == 0.0:
        return by_force, for_all, by_force
    largest = torque_by_bounded_hand(declared, bound, memory, sign, known, declared.hand_speed)
    return max(by_force, largest), for_all, by_force


def torque_by_bounded_hand(
    declared: Declared, bound: TorqueBound, memory: BoundMemory, sign: float, energy: float, speed: float
) -> float:
    """Return the largest certified torque along `sign` for a hand of bounded force, speed, or both [N or N*m].

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
        return torque_after_queue(declared, bound, memory, sign, energy, speed, _ANY)
    sent = torque_after_queue(declared, bound, memory, sign, energy, speed, _SENT)
    return min(sent, torque_after_queue(declared, bound, memory, sign, energy, speed, _HELD_ON))


def torque_after_queue(
    declared: Declared, bound: TorqueBound, memory: BoundMemory, sign: float, energy: float, speed: float, which: int
) -> float:
    """Return the largest torque of `torque_by_bounded_hand` if the queue named by `which` acts before it [N or N*m].

    `energy` is the budget less what torques in the other direction can take from it [J].
    """
    given, _, motion = taken_under_way(declared, bound, memory, sign, speed, declared.delay, which)
    budget, friction, losses = energy - given, declared.friction, declared.losses
    hand = displacement_by_hand(declared, bound, sign) if declared.by_hand_force else inf
    largest = friction
    if hand < inf:
        largest = max(largest, torque_by_late_reach(declared, hand, motion, 0.0, budget))
        if friction > 0.0:
            largest = max(largest, friction + torque_by_late_reach(declared, hand, motion, friction, budget))
    older = max(0.0, motion.highest - friction)
    longest = (declared.sample_time + declared.late) * (losses + 1)
    squares = 4.0 * declared.damping * budget - declared.late * older * older
    if squares > 0.0:
        largest = max(largest, friction + sqrt(squares / longest))
    if speed > 0.0:
        largest = max(largest, friction + (budget / speed - declared.late * older) / longest)
    return largest


def free_energy(declared: Declared, bound: TorqueBound, memory: BoundMemory, energy: float) -> float:
    """Return the budget not reserved for queued torques [J]; `energy` leaves out the device's dissipation."""
    if declared.losses == 0 and declared.late == 0.0:
        return free_of_even_holds(declared, bound, memory, energy)
    return free_of_late_torques(declared, bound, memory, energy)


def largest_torques(
    declared: Declared, bound: TorqueBound, memory: BoundMemory, sign: float, energy: float
) -> tuple[float, float, float]:
    """Return the largest torques along `sign` by all certificates, by those for any hand, and by all but hand speed.

    All three are in [N or N*m]. `energy` is the budget without the device's dissipation [J].
    """
    if declared.losses or declared.late > 0.0:
        return largest_of_late_torques(declared, bound, memory, sign, energy)
    if declared.by_hand_force_alone:
        force = by_hand_force(declared, bound, memory, sign, energy)
        return force, 0.0, force
    return largest_of_even_holds(declared, bound, memory, sign, energy)


def by_hand_force(declared: Declared, bound: TorqueBound, memory: BoundMemory, sign: float, energy: float) -> float:
    """Return the largest certified torque along `sign` for a hand that keeps its declared force [N or N*m].

    If no other property is declared, `largest_of_even_holds` gives the same torque. `energy` is the budget [J].
    """
    response, before, hand = declared.response, sign * bound.torque, displacement_by_hand(declared, bound, sign)
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
            energy -= max(0.0, taken_by_queue(declared, bound, memory, -sign, 0.0)[0])
    base = next_displacement(displacement, before, 0.0, response, hand)
    return hand_force_bound(energy, base, response.during)
