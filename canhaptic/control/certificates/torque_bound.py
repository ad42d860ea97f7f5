"""State of the certificates of one axis: the holds that ended, and the uncertainty of their energy.

**Uncertainty due to an encoder, with dry friction.** A position x_k = p_k + e_k is read as p_k, |e_k| <= c / 2, and
friction dissipates f_c |x_(k+1) - x_k| at least. Let G_k(e) be the least that came in and was dissipated, less what is
booked, over all motions that end at e. With D = p_(k+1) - p_k and the torque f of the hold

    G_(k+1)(e') = min over e of G_k(e) - f (e' - e) + f_c |D + e' - e|.

It starts flat. Where |D| >= c the sign of the motion is known, and G becomes a straight line, of any G before, with
the slope -f + f_c sign(D); where D = 0 its slope is limited to -f +- f_c. So a line it stays, exactly, and one number
has the slope s. Its least value is G(0) - |s| c / 2, and each hold changes G(0) by f_c |D| - |s' - s| c / 2. Without
friction that is |f - f'| c / 2 for each change of torque.

For a spring f = -k p that is rendered in full, dither over one edge costs nothing up to k = 2 f_c / c. A motion over
many counts costs k c^2 for each of them, of which friction covers f_c c: k = f_c / c is sustained at any speed of any
hand, and no more. For the same counts result from a hand that rests at every edge and crosses the next count
within one hold: it takes out k c^2 a count, and nothing in its counts tells it from a slow one. For a hand that is
slower than c / 2 T throughout, 2 f_c / c would do.
"""

from dataclasses import dataclass
from math import inf, isnan, nan
from typing import Final, NamedTuple, Protocol

from canhaptic.control.certificates.scalar_bounds import WINDOW, DisplacementResponse, next_displacement, tail_reach
from canhaptic.kernels import Buffer, MakeBuffer

_WHOLE: Final = 1.0 - 1e-9
"""Part of a count from which on a displacement is one or more of them; less is an encoder that shows parts."""


@dataclass(frozen=True, slots=True)
class Declared:
    """Declared properties of axis and hand."""

    sample_time: float  # longest hold [s]
    delay: int  # whole holds between computation and action
    losses: int  # consecutive cycles without a new torque that the certificates survive
    by_hand_force: bool  # whether that certificate is declared
    response: DisplacementResponse  # for it
    damping: float  # certain damping of the device [N*s/m or N*m*s/rad]; 0: not declared
    hand_speed: float  # largest speed of the hand [m/s or rad/s]; 0: not declared
    encoder_count: float  # [m or rad]; 0: ideal
    late: float = 0.0  # theta of `hold_timing`: window and lag of a new torque [s]; 0: torques change at the SYNC
    late_share: float = 0.0  # the same as a part of the shortest hold
    left: float = 0.0  # c of `hold_timing`: share of older torques that is left after a hold
    friction: float = 0.0  # certain dry friction of the device [N or N*m]; 0: not declared
    by_hand_force_alone: bool = False  # whether no other certificate is declared


@dataclass(slots=True)
class TorqueBound:
    """The hold that ended, and the uncertain part of the energy."""

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
    """Buffers of the bound for sequences; changed in place."""

    displacements: Buffer  # of the last holds, a ring of `WINDOW` [m or rad]
    torques: Buffer  # held in them; where torques come late, what counts along + [N or N*m]
    against: Buffer  # what counts along -, where torques come late
    under_way: Buffer  # torques sent, the ring of `Commands` [N or N*m]


def bound_memory(declared: Declared, under_way: Buffer, make_buffer: MakeBuffer) -> BoundMemory:
    """Return the buffers of a bound on the queued torque."""
    window = WINDOW if declared.encoder_count > 0.0 else 0
    against = window if declared.late > 0.0 else 0
    return BoundMemory(make_buffer(window), make_buffer(window), make_buffer(against), under_way)


def look_for_turn(declared: Declared, bound: TorqueBound, memory: BoundMemory, moved: float, holds: float) -> None:
    """Return whether any hold that matters for the next torque may contain a reversal of the effort.

    There the way out of one contact is the way into another, so that the hand may do in either direction what
    it may do in one. The hold that ended counts, as its force is in the next displacement, and so do those up to the
    end of the next torque, and one more. The result of the previous SYNC is kept for the hold that ended: a hand that
    turned beyond a crest and came back within it leaves no trace in the positions.

    Args:
        declared: Declared properties of axis and hand.
        bound: State of the axis's torque bound and its stretch; modified.
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
    """Whether the axis can reach the end of its stretch while the next torque acts, or in the hold after it."""
    up = down = 0.0
    for place in range(len(memory.under_way)):
        up, down = max(up, memory.under_way[place]), min(down, memory.under_way[place])
    up, down = max(up, torque, acted(declared, bound, 1.0)), max(-down, -torque, acted(declared, bound, -1.0))
    return reach(declared, bound, 1.0, up) >= bound.above or reach(declared, bound, -1.0, down) >= bound.below


def reach(declared: Declared, bound: TorqueBound, sign: float, torque: float) -> float:
    """Largest distance that the axis moves along `sign` until the hold after the next torque, by a torque along it.

    In [m or rad]; the hand pulls along the effort's torque and pushes against it.
    """
    hand = declared.response.hand if sign * bound.out > 0.0 else declared.response.push
    displacement = sign * bound.displacement + declared.encoder_count + bound.position_uncertainty
    farthest = declared.encoder_count
    for _ in range(declared.delay + declared.losses + 2):
        displacement = next_displacement(displacement, torque, torque, declared.response, hand)
        farthest += max(0.0, displacement)
    return farthest


def hand_along(declared: Declared, bound: TorqueBound, sign: float) -> float:
    """Displacement by the hand in two holds along `sign` [m or rad]: a pull outward, or a push inward."""
    if sign * bound.out < 0.0 or bound.turns:
        return declared.response.push
    return declared.response.hand


def acted(declared: Declared, bound: TorqueBound, sign: float) -> float:
    """Torque along `sign` counted as held in the hold that ended [N or N*m]."""
    if declared.late > 0.0:
        return bound.most if sign > 0.0 else -bound.least
    return sign * bound.torque


def end_hold(
    declared: Declared, bound: TorqueBound, memory: BoundMemory, displacement: float, torque: float, lasted: float = 1.0
) -> float:
    """Take the hold that ended: displacement [m or rad], the torque held in it [N or N*m], its length [sample times].

    Returns:
        Largest shortfall of the energy received against the booked energy, because the torque came late [J].
    """
    count, late, doubt = declared.encoder_count, declared.late, 0.0
    if declared.damping:
        certain = abs(displacement) - count
        if certain > 0.0:
            dissipate(bound, declared.damping / declared.sample_time * certain * certain)
    if declared.friction and not count:
        dissipate(bound, declared.friction * abs(displacement))
    if late:
        doubt = doubt_of_late(declared, bound, displacement, torque, lasted)
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
    return doubt


def dissipate(bound: TorqueBound, energy: float) -> None:
    """Add an energy [J] that the device certainly dissipated."""
    bound.dissipated += energy
    bound.certain += energy


def for_any(bound: TorqueBound) -> float:
    """Energy that the device dissipated beyond the uncertainty for an arbitrary hand [J]."""
    return min(bound.certain, bound.dissipated)


def pass_within_count(bound: TorqueBound, count: float, friction: float, displacement: float, torque: float) -> None:
    """Take a hold whose ends are known to one count: dissipation by dry friction, less the uncertainty of the count.

    See the module: the least of G changes by the friction along the counts, less half a count times the slope change.

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


def shorten(declared: Declared, bound: TorqueBound, lasted: float) -> None:
    """Replace the hold that ended, longer than T and of one torque, by its last sample time.

    In it the axis moved at the mean speed of the whole, up to what torque and hand gain in half of the rest.

    Args:
        declared: Declared properties of axis and hand.
        bound: State of the axis's torque bound, after `end_hold`.
        lasted: Length of the hold, > 1 [sample times].
    """
    response, torque = declared.response, abs(bound.torque)
    if declared.late > 0.0:
        torque = max(torque, bound.most, -bound.least)
    hand = response.push if response.push < inf else response.hand
    step = (response.before + response.during) * torque + hand
    excursion = abs(bound.displacement) + declared.encoder_count + lasted * lasted * step
    bound.displacement /= lasted
    bound.position_uncertainty = 0.5 * (lasted - 1.0) * step
    bound.position_uncertainty += (1.0 - response.retained + (response.growth - 1.0)) * excursion
    bound.kept = 0
    if declared.damping > 0.0:  # the mean speed is known, and its square is no more than the mean of the squares
        certain = abs(bound.displacement) * lasted - declared.encoder_count
        if certain > 0.0:
            dissipate(bound, -declared.damping / declared.sample_time * certain * certain * (1.0 - 1.0 / lasted))


def take_late(declared: Declared, bound: TorqueBound, torque: float) -> None:
    """Record the torque of the hold that ended, and the range of older torques that acted in it [N or N*m]."""
    above, below = bound.highest - torque, torque - bound.lowest
    counts, left = declared.response.late, declared.left
    bound.most = bound.highest = bound.least = bound.lowest = torque
    if above > 0.0:
        bound.most += counts * above
        bound.highest += left * above
    if below > 0.0:
        bound.least -= counts * below
        bound.lowest -= left * below


def doubt_of_late(
    declared: Declared, bound: TorqueBound, displacement: float, torque: float, lasted: float = 1.0
) -> float:
    """Largest shortfall of the energy received against the booked energy, in a hold whose torque came late [J].

    See `hold_timing`. The hand's force is used in the direction out of the contact alone. Damping and dry
    friction of the device alone bound no motion inside a hold, and their promise at the handle needs none: it covers
    each torque at every instant. For friction an estimate is subtracted, for an axis no faster than twice the mean of
    this hold or the previous one; `AxisMeter` adds the uncertainty at the motor for a hand of the largest speed.

    Args:
        declared: Declared properties of axis and hand.
        bound: State of the axis's torque bound before the hold; `resolution` and `dissipated` change.
        displacement: Displacement in the hold [m or rad].
        torque: Torque held in it [N or N*m].
        lasted: Length of the hold [sample times].
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
        up, down = reach_of_late(declared, bound, sign, displacement, torque, lasted)
        change *= sign
        less, more = (change * down, change * up) if change > 0.0 else (-change * up, -change * down)
        further = rest * max(up, down)
        less, more = less + further, more + further
    elif declared.hand_speed > 0.0:
        less = more = differs * declared.hand_speed * declared.late
    else:
        bound.resolution += damped if declared.damping == 0.0 else 2.0 * damped
        return damped
    bound.resolution += less + more
    if declared.damping > 0.0:  # a promise to every hand rests on no hand
        bound.certain += less - damped
    return less


def reach_of_late(
    declared: Declared, bound: TorqueBound, sign: float, displacement: float, torque: float, lasted: float
) -> tuple[float, float]:
    """Largest displacement of older torques along `sign`, and against it, in the hold that ended.

    In [m or rad]. In a hold of n sample times torque and hand have n times as long to move the axis there and back
    before it ends at the measured position, so that the way back grows n times; s of `hold_timing` grows at most to
    1 + 2 n times its excess over 1 in one sample time.

    Args:
        declared: Declared properties of axis and hand.
        bound: State of the axis's torque bound before the hold.
        sign: Direction in which the hand's force is bounded, 1 or -1.
        displacement: Displacement in the hold [m or rad].
        torque: Torque held in it [N or N*m].
        lasted: Length of the hold [sample times].
    """
    response, count, hand = declared.response, declared.encoder_count, hand_along(declared, bound, sign)
    if hand == inf:  # no run begins so
        hand = response.hand
    acting = max(0.0, sign * torque, bound.highest if sign > 0.0 else -bound.lowest)
    start = sign * bound.displacement + count + bound.position_uncertainty
    up = tail_reach(start, acted(declared, bound, sign), acting, response, hand)
    back = count - sign * displacement
    down = lasted * (response.tail_before * acting + response.tail_hand * hand)
    if back > 0.0:
        down += response.share * back
    swing = response.swing if lasted == 1.0 else 1.0 + 2.0 * lasted * (response.swing - 1.0)
    return up, swing * down


def end_gap(
    declared: Declared, bound: TorqueBound, displacement: float, torque: float, holds: int, largest: float,
    apart: float,
) -> float:  # fmt: skip
    """Book several holds of which only the total displacement is known; return the uncertainty of their energy [J].

    In all but the last hold, whose torque was read back, any torque sent may have acted, and the previous one if
    commands may be lost. The energy is wrong by at most the difference of the torques times the excursion in the hold.
    The displacement alone does not bound it, as a reversal has almost none: the reach of the hand does,
    or its speed, or what the device dissipates in an excursion.

    Args:
        declared: Declared properties of axis and hand.
        bound: State of the axis's torque bound; changed.
        displacement: Total displacement [m or rad].
        torque: Torque held in the last hold [N or N*m].
        holds: Number of holds.
        largest: Largest size of the torques sent for them [N or N*m].
        apart: Largest difference of one of those torques from the last [N or N*m].
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
        doubt = missed * apart * excursion_unseen(declared, bound, displacement, holds, largest)
    elif declared.hand_speed > 0.0:
        doubt = missed * apart * declared.hand_speed * declared.sample_time
    else:
        doubt = damped
    if declared.damping > 0.0:  # a promise to every hand rests on no hand
        bound.certain += doubt - damped
    bound.resolution += 2.0 * doubt
    bound.changes += holds * count * largest
    bound.slope, bound.uncertainty = -torque, bound.changes + 0.5 * count * abs(torque)
    bound.displacement, bound.torque = displacement / holds, torque
    return doubt


def spread_of_gap(bound: TorqueBound, torque: float, apart: float) -> float:
    """Widen the range of acting torques to all that may have acted in lost holds; return its width [N or N*m].

    A late torque u is at every instant a mean of torques in this range, and the one read back, f, is one of them. By
    parts the energy is wrong by the integral of (u - f) dx = [(u - f)(x - x_end)] - integral of (x - x_end) du: no more
    than the width times the excursion for each of the changes at the beginnings of the holds, and twice more.

    Args:
        bound: State of the axis's torque bound; changed.
        torque: Torque held in the last hold [N or N*m].
        apart: Largest difference of a sent torque from it [N or N*m].
    """
    high = max(torque + apart, bound.torque, bound.highest)
    low = min(torque - apart, bound.torque, bound.lowest)
    bound.most = bound.highest = high
    bound.least = bound.lowest = low
    return high - low


def excursion_unseen(declared: Declared, bound: TorqueBound, displacement: float, holds: int, largest: float) -> float:
    """Largest excursion of the axis by the hand within several holds [m or rad]; see `end_gap`.

    The uncertainty of the last displacement is then in `bound.position_uncertainty`.
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
    """Energy that the device certainly dissipated, less what was discarded [J]."""

    dissipated: float


def keep(bound: Dissipated, energy: float, enough: float) -> None:
    """Discard the device's dissipation beyond the amount that reaches `enough` [J] together with `energy`.

    Otherwise a contact could live, and buzz, on what the device dissipated long ago.
    """
    if energy + bound.dissipated > enough:
        bound.dissipated = min(bound.dissipated, max(0.0, enough - energy))


def outward(declared: Declared, bound: TorqueBound, memory: BoundMemory, sign: float) -> float:
    """Largest displacement of the hold that ended, counted along `sign` [m or rad].

    The displacement is known to one count. A mean over j holds is known to count / j, and the hand and the torques
    can have raised the last one above the mean only so far; the smallest of these bounds counts.
    """
    if bound.kept < 2:  # of an ideal encoder none is kept
        return sign * bound.displacement + declared.encoder_count + bound.position_uncertainty
    known = bound.upward if sign > 0.0 else bound.downward
    if isnan(known):
        known = outward_by_windows(declared, bound, memory, sign)
        if sign > 0.0:
            bound.upward = known
        else:
            bound.downward = known
    return known


def outward_by_windows(declared: Declared, bound: TorqueBound, memory: BoundMemory, sign: float) -> float:
    """Smallest of the bounds from the mean over the last 1, 2, 3, ... holds [m or rad]."""
    response, count = declared.response, declared.encoder_count
    lost, enough, more = 1.0 - response.retained, 2.0 * count, response.growth - 1.0
    torques = memory.against if declared.late > 0.0 and sign < 0.0 else memory.torques
    hand, acting = hand_along(declared, bound, sign), acted(declared, bound, sign)
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
