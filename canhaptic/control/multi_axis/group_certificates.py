"""Which share of a group's torques may be sent for the next hold: the certificates of one axis, extended to all axes.

Terms, statements G1 to G9 and their proofs: `docs/theory/torques_of_a_group.md`. A cell is one axis in one hold.
"""

import math
from math import inf, sqrt
from typing import Annotated, Final, NamedTuple

from canhaptic.control.certificates.scalar_bounds import NO_RESPONSE, displacement_response, hand_force_bound
from canhaptic.control.passivity import LoopProperties
from canhaptic.control.passivity.stepped import towards_zero
from canhaptic.kernels import OFTEN_ZERO, Buffer, Indices, Matrix, list_of_zeros, zeros

_SLOWLY: Final = 1.9
"""Largest b T / m at which damping and hand force count in one sum; at 2 the largest share is unbounded by rounding."""


class GroupTiming(NamedTuple):
    """Declared timing of a group's holds as the certificates use it; see `hold_timing`. Shapes (axes,)."""

    is_uneven: Annotated[bool, OFTEN_ZERO]  # whether a hold may be longer or shorter, or a torque late
    growth: float  # longest hold over the shortest
    share: Buffer  # theta over the shortest hold
    counted: Buffer  # part of it for which an older torque counts as held throughout
    left: Buffer  # c: share of older torques that is left after a hold
    roots: Buffer  # T m^(-1/2): a force of norm 1 in `before` + `during` moves an axis so far, without damping
    hand: float  # F_h |1|, in the norm of `roots`
    swing: Buffer  # factor by which friction lengthens the way back inside a hold
    tail: Buffer  # theta / (T + theta)
    tail_path: float  # v_max theta [m or rad]


def timing_of(loops: tuple[LoopProperties, ...], by_hand: bool, pull: float, speed: float) -> GroupTiming:
    """Return the declared timing of a group's holds.

    Args:
        loops: Loop of each axis.
        by_hand: Whether the moving mass of every axis is known.
        pull: Declared hand force F_h plus dry friction [N or N*m].
        speed: Declared hand speed v_max [m/s or rad/s]; 0: not declared.
    """
    timings = [loop.timing for loop in loops]
    longest = max([timing.longest for timing in timings])
    shortest = min([timing.shortest for timing in timings])
    bounds = [max(loop.device_damping or 0.0, loop.device_damping_bound or 0.0) for loop in loops]
    masses = [(loop.moving_mass or 1.0) if by_hand else 1.0 for loop in loops]
    fading = [bound * longest / mass for bound, mass in zip(bounds, masses, strict=True)]
    late = [timing.late for timing in timings]
    return GroupTiming(
        is_uneven=any(late) or longest != shortest,
        growth=longest / shortest,
        share=[theta / shortest for theta in late],
        counted=[min(1.0, 2.0 * theta / shortest) for theta in late],
        left=[timing.left for timing in timings],
        roots=[longest / math.sqrt(mass) for mass in masses],
        hand=pull * longest * math.sqrt(sum(1.0 / mass for mass in masses)),
        swing=[y / -math.expm1(-y) if y > 0.0 else 1.0 for y in fading],
        tail=[theta / (longest + theta) for theta in late],
        tail_path=speed * max(late),
    )


class AxisLimits(NamedTuple):
    """Properties of the motor axes that the certificates use; shapes (axes,)."""

    before: Buffer  # response of the displacement to the torque of the hold before [m/N]
    during: Buffer  # and of the hold itself [m/N]
    lost: Buffer  # largest share of an inward displacement that friction takes from the next hold
    hand: float  # F_h |1|_P: displacement by the hand for |W|_P = 1, both in the norm of before + during
    by_hand: bool  # whether the hand-force certificate is declared
    damping: Buffer  # certain damping over the sample time [N/m]; 0 where it is not known
    by_damping: bool
    path: float  # v_max T [m or rad]; 0: the hand-speed certificate is not declared
    counts: Buffer  # encoder counts [m or rad]
    coarse: bool  # whether any of them is above 0
    squares: Buffer  # 4 b / (T + theta): square of a torque over its need of the damping [N^2/J]; 0: not known
    damps_slowly: Annotated[
        bool, OFTEN_ZERO
    ]  # whether hand force and damping are declared, holds are even, and b T < 1.9 m for every axis
    timing: GroupTiming


def axes_of(loops: tuple[LoopProperties, ...], hand_force: float | None, hand_speed: float | None) -> AxisLimits:
    """Return the properties of the motor axes that the certificates use.

    Args:
        loops: Loop of each axis.
        hand_force: Largest hand force F_h on each axis [N or N*m]; its certificate also needs every axis's moving
            mass. None: certificate not used.
        hand_speed: Largest hand speed v_max [m/s or rad/s]; None: certificate not used.
    """
    sample_time = max([loop.timing.longest for loop in loops])
    by_hand = hand_force is not None and all(loop.moving_mass is not None for loop in loops)
    alone = len(loops) == 1
    responses = [
        displacement_response(
            sample_time, loop.moving_mass or 1.0, 1.0, (loop.device_damping or 0.0) if alone else 0.0,
            max(loop.device_damping or 0.0, loop.device_damping_bound or 0.0),
        )
        if by_hand
        else NO_RESPONSE
        for loop in loops
    ]  # fmt: skip
    pull = (hand_force or 0.0) + max([loop.device_friction_bound or 0.0 for loop in loops])
    lost = [1.0 - response.retained for response in responses]
    damping = [(loop.device_damping or 0.0) / sample_time for loop in loops]
    timing = timing_of(loops, by_hand, pull, hand_speed or 0.0)
    return AxisLimits(
        before=[response.before for response in responses],
        during=[response.during for response in responses],
        lost=lost,
        hand=pull * math.sqrt(sum(response.hand for response in responses)),
        by_hand=by_hand,
        damping=damping,
        by_damping=all(value > 0.0 for value in damping),
        path=(hand_speed or 0.0) * sample_time + timing.tail_path,
        counts=[loop.encoder_count for loop in loops],
        coarse=any(loop.encoder_count for loop in loops),
        squares=[4.0 * value * (1.0 - tail) for value, tail in zip(damping, timing.tail, strict=True)],
        damps_slowly=by_hand
        and all(value > 0.0 for value in damping)
        and not timing.is_uneven
        and all(
            max(loop.device_damping or 0.0, loop.device_damping_bound or 0.0) * sample_time
            < _SLOWLY * (loop.moving_mass or 0.0)
            for loop in loops
        ),
        timing=timing,
    )


def _response_to(torques: Buffer, acting: Buffer, response: Buffer) -> float:
    """Return the most by which acting torques can raise the work W . D, for any inertia not below the declared [J]."""
    product = first = second = 0.0
    for i in range(len(response)):
        gain = response[i]
        product += torques[i] * gain * acting[i]
        first += torques[i] * gain * torques[i]
        second += acting[i] * gain * acting[i]
    largest = 0.5 * (product + math.sqrt(first * second))
    return largest if largest > 0.0 else 0.0


def response_to_late(
    axes: AxisLimits, torques: Buffer, highest: Buffer, lowest: Buffer, held: Buffer, response: Buffer
) -> float:
    """Return the most by which older torques can raise the work W . D of a hold, beyond the torques held in it [J].

    Args:
        axes: Properties of the motor axes.
        torques: Torques W, (axes,).
        highest: Largest of the older torques, (axes,) [N*m or N].
        lowest: Smallest of the older torques, (axes,) [N*m or N].
        held: Torques commanded for the hold, (axes,).
        response: Displacement per torque, `axes.before` or `axes.during`.
    """
    size = total = 0.0
    for i in range(len(response)):
        size += torques[i] * response[i] * torques[i]
    size = math.sqrt(size)
    for i in range(len(response)):
        above, below = highest[i] - held[i], held[i] - lowest[i]  # of which one is above 0
        along, any_way = torques[i] * response[i], size * math.sqrt(response[i])  # |along| <= any_way
        reply = max(above * (any_way + along), below * (any_way - along))
        total += 0.5 * axes.timing.counted[i] * reply
    return total


def pass_range(axes: AxisLimits, highest: Buffer, lowest: Buffer, held: Buffer) -> None:
    """Advance the range of torques that may still act to the next SYNC, after a hold with the torques `held`."""
    for i in range(len(held)):
        torque, left = held[i], axes.timing.left[i]
        highest[i] = torque + left * max(0.0, highest[i] - torque)
        lowest[i] = torque - left * max(0.0, torque - lowest[i])


def _hand_term(axes: AxisLimits, torques: Buffer) -> float:
    """Return the most by which the hand can raise the work W . D of the torques W in one hold [J]."""
    total = 0.0
    for i in range(len(axes.before)):
        total += torques[i] * (axes.before[i] + axes.during[i]) * torques[i]
    return axes.hand * math.sqrt(total)


def work_of_last_hold(axes: AxisLimits, torques: Buffer, displacement: Buffer, position_uncertainty: Buffer) -> float:
    """Return the largest work W . D_0, with D_0 known up to encoder counts and `position_uncertainty` [J]."""
    total = 0.0
    for i in range(len(axes.counts)):
        along = torques[i] * displacement[i]
        total += along + abs(torques[i]) * (axes.counts[i] + position_uncertainty[i])
    return total


def _raised_by_friction(axes: AxisLimits, torques: Buffer, displacement: Buffer) -> float:
    """Return by how much friction can raise the work W . D_0, slowing axes that move against W, in a hold [J], >= 0."""
    total = 0.0
    for i in range(len(axes.lost)):
        along = torques[i] * displacement[i] + abs(torques[i]) * axes.counts[i]
        if along < 0.0:
            total -= axes.lost[i] * along
    return total


class Acting(NamedTuple):
    """Range of the torques that may act at a SYNC."""

    highest: Buffer  # at most, (axes,) [N*m or N]
    lowest: Buffer  # at least


def work_base(
    axes: AxisLimits, torques: Buffer, displacement: Buffer, bound: float, last: Buffer, sent: Matrix, first: int,
    under_way: int, range_of: Acting,
) -> float:  # fmt: skip
    """Return `base` of l W . D <= l base + l^2 gain: the largest work W . D that W itself does not cause [J].

    W acts after the queued torques. In every hold friction acts on what is left of D_0, axis by axis, because the sum
    over axes that move inward and outward gives no bound. The responses to forces are bounded without friction.

    Args:
        axes: Properties of the motor axes.
        torques: Torques W, (axes,).
        displacement: Displacement D_0 in the hold that ended, (axes,).
        bound: Largest W . D_0 [J].
        last: Torques held in that hold, (axes,).
        sent: Queued torques, a ring buffer with a row for each hold, (holds, axes).
        first: Row of the next hold; negative indices wrap.
        under_way: Number of holds before W acts.
        range_of: Range of torques that may act at the SYNC where the hold that ended began; where torques come late, it
            is advanced to the SYNC of W.
    """
    hand, friction = _hand_term(axes, torques), _raised_by_friction(axes, torques, displacement)
    is_uneven, growth = axes.timing.is_uneven, axes.timing.growth
    highest, lowest = range_of.highest, range_of.lowest
    friction *= growth
    total = _stretched(bound, growth) + friction
    total += _response_to(torques, last, axes.before) + hand
    if is_uneven:
        total += response_to_late(axes, torques, highest, lowest, last, axes.before)
        pass_range(axes, highest, lowest, last)
    for place in range(first, first + under_way):
        acting = sent[place]
        total += _response_to(torques, acting, axes.during)
        if is_uneven:
            total += response_to_late(axes, torques, highest, lowest, acting, axes.during)
        if len(axes.lost) > 1:
            total = _stretched(total, growth) + friction
        elif total < 0.0:
            total -= axes.lost[0] * total
            total = _stretched(total, growth)
        else:
            total *= growth
        total += _response_to(torques, acting, axes.before) + hand
        if is_uneven:
            total += response_to_late(axes, torques, highest, lowest, acting, axes.before)
            pass_range(axes, highest, lowest, acting)
    return total


def _stretched(total: float, growth: float) -> float:
    """Return the largest work W . D in the next hold, which may be longer or shorter by the factor `growth` [J]."""
    return total * growth if total > 0.0 else total / growth


def taken_by_mover(torques: Buffer, moved: Buffer) -> float:
    """Return minus the work [J] of the torques in a hold in which the motors move by `moved`."""
    total = 0.0
    for i in range(len(moved)):
        total -= torques[i] * moved[i]
    return total


def work_gain(axes: AxisLimits, torques: Buffer) -> float:
    """Return `gain` of l W . D <= l base + l^2 gain: how much the torques W raise their own work W . D [J]."""
    total = 0.0
    for i in range(len(axes.during)):
        total += torques[i] * axes.during[i] * torques[i]
    return total


def damping_need(axes: AxisLimits, torques: Buffer) -> float:
    """Return the energy that device damping must cover for torques F: sum(F_i^2 (T + theta_i) / 4 b_i) [J]."""
    total = 0.0
    for i in range(len(axes.damping)):
        total += torques[i] * torques[i] / axes.squares[i]
    return total


def path_need(axes: AxisLimits, torques: Buffer) -> float:
    """Return the most energy that torques F give out at the declared hand speed: sum |F_i| v_max (T + theta) [J]."""
    total = 0.0
    for torque in torques:
        total += abs(torque)
    return total * axes.path


class PerAxisLimits(NamedTuple):
    """Constants of the per-axis certificates in one run."""

    delay: int  # whole holds between computation and action
    losses: Annotated[int, OFTEN_ZERO]  # consecutive cycles in which an axis may be without a new torque
    holds: int  # in which the next torque may act, counted from now
    first: float  # share of a whole response that a torque has in its first hold
    is_uneven: Annotated[bool, OFTEN_ZERO]  # whether a hold may be longer or shorter, or a torque late
    is_apart: Annotated[bool, OFTEN_ZERO]  # whether axes are certified one by one
    is_late: Annotated[bool, OFTEN_ZERO]  # whether any torque comes late
    responses: Buffer  # T^2 / m of each axis
    roots: Buffer  # of these


class PerAxisMemory(NamedTuple):
    """Buffers of the per-axis certificates: torques that may still act, and the energy [J] of each axis with them."""

    sent: Matrix  # torques held in the hold that ended, and those under way, (delay + 1, axes) [N*m or N]
    largest: Buffer  # size of any of them on each axis, (axes,)
    starts: Matrix  # displacement of the hold that ended along + and -, uncertainty included, (axes, 2) [m or rad]
    lost: Matrix  # its part lost to friction in a hold, (axes, 2)
    along: Matrix  # largest torque along + that may act in each hold, >= 0, (holds, axes) [N*m or N]
    against: Matrix  # the same along -
    ends: Indices  # of each cell in the parabolas; a cell is one axis in one hold, (cells,)
    constant: Buffer  # A of the parabolas A + B l + C l^2, (pieces + 1,), the last of which is always 0
    linear: Buffer  # B
    square: Buffer  # C
    old: Buffer  # sums over the holds by the torques under way, (axes,)
    new: Buffer  # sums added by new ones
    nothing: Buffer  # zeros, (axes,)
    alone: Buffer  # a torque of one axis, (axes,)
    others: Buffer  # of all others
    rest: Buffer  # of all that take no energy in
    older: Acting  # range of all torques at the last SYNC, (axes,) [N*m or N]


def per_axis_limits(axes: AxisLimits, delay: int, losses: int) -> PerAxisLimits:
    """Return the constants of the per-axis certificates."""
    whole = [b + d for b, d in zip(axes.before, axes.during, strict=True)]
    first = max([d / r if r else 0.0 for d, r in zip(axes.during, whole, strict=True)])
    is_late = any(axes.timing.share)
    is_apart = losses > 0 or (len(whole) > 1 and not is_late)
    return PerAxisLimits(
        delay, losses, delay + 1 + losses, first, axes.timing.is_uneven, is_apart, is_late, whole,
        [sqrt(r) for r in whole],
    )  # fmt: skip


def per_axis_memory(limits: PerAxisLimits) -> PerAxisMemory:
    """Return the buffers of the per-axis certificates, filled with zeros."""
    axes, one = len(limits.roots), list_of_zeros
    cells, pieces = limits.holds * axes, (limits.delay + 2) * limits.holds * axes
    if limits.is_late:
        pieces = 8 * cells + 8 * (cells + axes)
    ends = 2 * cells + axes if limits.is_late else cells
    if not limits.is_apart:
        ends = pieces = 0
    return PerAxisMemory(
        zeros(limits.delay + 1, axes), one(axes), zeros(axes, 2), zeros(axes, 2), zeros(limits.holds, axes),
        zeros(limits.holds, axes), [0] * ends, one(pieces + 1), one(pieces + 1), one(pieces + 1), one(axes), one(axes),
        one(axes), one(axes), one(axes), one(axes), Acting(one(axes), one(axes)),
    )  # fmt: skip


def write_parabolas(memory: PerAxisMemory, place: int, old: float, new: float, base: float, slope: float) -> int:
    """Store, as parabolas in l, the energies of the old torque and of l times the new one over base + slope * l."""
    if old > 0.0:
        memory.constant[place], memory.linear[place], memory.square[place] = old * base, old * slope, 0.0
        place += 1
    if new > 0.0:
        memory.constant[place], memory.linear[place], memory.square[place] = 0.0, new * base, new * slope
        place += 1
    return place


def write_late_cells(
    axes: AxisLimits, limits: PerAxisLimits, memory: PerAxisMemory, torques: Buffer, fixed: Buffer, norm: float,
    more: float, place: int,
) -> None:  # fmt: skip
    """Store bounds on the energy of older torques, beyond the torques of each hold, as parabolas in the share l of W.

    The bounds include the hold after the last, in which all torques may still act.

    Args:
        axes: Properties of the motor axes.
        limits: Per-axis limits of the group.
        memory: Buffers of the certificates, after `take_sent`.
        torques: Requested torques W, (axes,).
        fixed: Torques sent for every l, (axes,).
        norm: N_0 + h of the module: norm of torques and hand at l = 0.
        more: N_1 of the module: increase of that norm with l.
        place: Index of the next parabola.
    """
    cell = limits.holds * len(torques)
    for i in range(len(torques)):
        up, down = memory.older.highest[i], -memory.older.lowest[i]
        for index in range(limits.holds + 1):
            is_last = index == limits.holds
            for side in range(2):
                sign = 1.0 if side == 0 else -1.0
                before, held, new = up if side == 0 else down, 0.0, 0.0
                if is_last:
                    before, new = max(before, sign * fixed[i]), sign * torques[i]
                else:
                    held = memory.along[index][i] if side == 0 else memory.against[index][i]
                older = max(0.0, before - held)
                if older > 0.0 or new > 0.0:
                    place = write_tail(axes, limits, memory, i, side, index, norm, more, older, new, place)
                after = held + axes.timing.left[i] * older
                if side == 0:
                    up = after
                else:
                    down = after
            memory.ends[cell] = place
            cell += 1


def write_tail(
    axes: AxisLimits, limits: PerAxisLimits, memory: PerAxisMemory, axis: int, side: int, index: int, norm: float,
    more: float, older: float, new: float, place: int,
) -> int:  # fmt: skip
    """Store a bound on the energy of older torques at the start of a hold, parabolas in l; return the next index.

    X = integral(p v) over v > 0, the outward motion weighted by the part p of older torques, is convex in the
    displacement D of the hold before: s D + s (1/2 + s) a T^2 for D >= 0, and 0 where the axis still goes inward at
    the end of the hold, D <= -3/2 a T^2.
    """
    share, root, start = axes.timing.share[axis], axes.timing.roots[axis], memory.starts[axis][side]
    pace, rise = memory.lost[axis][side] + root * norm, root * more
    moved, grown = start + index * pace, rise * max(0, index - limits.delay)
    slope = share * (0.5 + share)
    pull, gain = slope * (moved / 1.5 + pace), slope * (grown / 1.5 + rise)
    place = write_parabolas(memory, place, older, new, pull, gain)
    return write_parabolas(memory, place, older, new, share * moved + slope * pace, share * grown + slope * rise)


_PASSES: Final = 24
"""Most iterations of the search for a share; if more are needed, the share is 0."""
_ROUNDING: Final = 1e-12


def take_sent(
    axes: AxisLimits, limits: PerAxisLimits, memory: PerAxisMemory, displacement: Buffer, position_uncertainty: Buffer,
    torques: Buffer, under_way: Matrix, first: int, older: Acting,
) -> None:  # fmt: skip
    """Copy the motion in the hold that ended, and the torques that may still act, to the buffers.

    Args:
        axes: Properties of the motor axes.
        limits: Per-axis limits of the group.
        memory: Buffers of the certificates; changed.
        displacement: Displacement in the hold that ended, (axes,) [rad or m].
        position_uncertainty: Uncertainty of each displacement (axes,).
        torques: Torques held in that hold, (axes,) [N*m or N].
        under_way: Queued torques, a ring buffer (delay + 1, axes).
        first: Row of the torques that act next; negative indices wrap.
        older: Range of all torques that may act at the last SYNC, where torques come late.
    """
    for i in range(len(torques)):
        memory.sent[0][i], memory.largest[i] = torques[i], abs(torques[i])
        slack, moved = axes.counts[i] + position_uncertainty[i], displacement[i]
        memory.starts[i][0], memory.starts[i][1] = slack + moved, slack - moved
        for side in range(2):
            start = memory.starts[i][side]
            memory.lost[i][side] = axes.lost[i] * max(0.0, -start)
        if limits.is_uneven:
            take_older(axes, memory, older, i)
    for hold in range(limits.delay):
        row = under_way[first + hold]
        for i in range(len(torques)):
            memory.sent[hold + 1][i] = row[i]
            memory.largest[i] = max(memory.largest[i], abs(row[i]))
    write_largest(limits, memory)


def write_largest(limits: PerAxisLimits, memory: PerAxisMemory) -> None:
    """Store, for each hold and axis, the largest sent torque that may act along + and along -, >= 0."""
    for index in range(limits.holds):
        for i in range(len(memory.largest)):
            up = down = 0.0
            for place in range(first_acting(limits, index + 1), end_acting(limits, index + 1)):
                up, down = max(up, memory.sent[place][i]), max(down, -memory.sent[place][i])
            memory.along[index][i], memory.against[index][i] = up, down


def take_older(axes: AxisLimits, memory: PerAxisMemory, older: Acting, axis: int) -> None:
    """Copy one axis's range of torques, and widen its last displacement and friction for holds of varying length."""
    highest, lowest = older.highest[axis], older.lowest[axis]
    memory.older.highest[axis], memory.older.lowest[axis] = highest, lowest
    memory.largest[axis] = max(memory.largest[axis], highest, -lowest)
    for side in range(2):
        start, growth = memory.starts[axis][side], axes.timing.growth
        memory.starts[axis][side] = start * growth if start > 0.0 else start / growth
        memory.lost[axis][side] *= axes.timing.swing[axis] / growth


def first_acting(limits: PerAxisLimits, hold: int) -> int:
    """Return the row of `sent` with the oldest torques that may act in a hold, the next hold being 1."""
    return max(0, hold - limits.losses)


def end_acting(limits: PerAxisLimits, hold: int) -> int:
    """Return the end index in `sent` of the torques that may act in hold number `hold`; 1 is the next hold."""
    return min(hold, limits.delay) + 1


def write_cells(
    axes: AxisLimits, limits: PerAxisLimits, memory: PerAxisMemory, mover_motion: Matrix, torques: Buffer, fixed: Buffer
) -> None:
    """Store a bound on the energy that each axis may give out in each hold: the largest of several parabolas in l.

    Args:
        axes: Properties of the motor axes.
        limits: Per-axis limits of the group.
        memory: Buffers of the certificates; changed.
        mover_motion: Motion of a mover in future holds, (holds, axes) [m or rad].
        torques: Requested torques W, (axes,); the caller searches for the largest permitted share l of them.
        fixed: Torques sent for every l, on axes where W is 0, (axes,).
    """
    total = added = 0.0
    for i in range(len(torques)):
        response, largest, torque = limits.responses[i], memory.largest[i], abs(torques[i])
        sent = max(largest, abs(fixed[i]))
        total += response * sent * sent
        added += response * max(0.0, torque * torque - sent * sent)
    norm, more, place = sqrt(total) + axes.hand, sqrt(added), 0
    for i in range(len(torques)):
        if limits.is_late:
            place = write_courses(limits, memory, mover_motion, torques[i], fixed[i], norm, more, i, place)
        else:
            place = write_options(axes, limits, memory, mover_motion, torques[i], fixed[i], norm, more, i, place)
    if limits.is_late:
        write_late_cells(axes, limits, memory, torques, fixed, norm, more, place)


def write_options(
    axes: AxisLimits, limits: PerAxisLimits, memory: PerAxisMemory, mover_motion: Matrix, torque: float, fixed: float,
    norm: float, more: float, axis: int, place: int,
) -> int:  # fmt: skip
    """Store one axis's energy in each hold, a parabola in l for each torque that may be held; return the next index."""
    root, kept = limits.roots[axis], 1.0 - axes.lost[axis]
    along, against = memory.starts[axis][0], memory.starts[axis][1]
    for index in range(limits.holds):
        along, against = along * kept if along < 0.0 else along, against * kept if against < 0.0 else against
        mine, reach, moved = index - limits.delay, (index + 1) * (root * norm), mover_motion[index][axis]
        slope = root * more * (mine + limits.first) if mine >= 0 else 0.0
        for option in range(first_acting(limits, index + 1), end_acting(limits, index + 1)):
            held = memory.sent[option][axis]
            base = reach + (along - moved if held > 0.0 else against + moved)
            held = abs(held)
            memory.constant[place], memory.linear[place], memory.square[place] = held * base, held * slope, 0.0
            place += 1
        if mine >= 0:
            base = reach + (along - moved if fixed + torque > 0.0 else against + moved)
            held, whole = abs(fixed), abs(torque)
            memory.constant[place], memory.square[place] = held * base, whole * slope
            memory.linear[place] = held * slope + whole * base
            place += 1
        memory.ends[axis * limits.holds + index] = place
    return place


def write_courses(
    limits: PerAxisLimits, memory: PerAxisMemory, mover_motion: Matrix, torque: float, fixed: float, norm: float,
    more: float, axis: int, place: int,
) -> int:  # fmt: skip
    """Store one axis's energy in each hold, where its torque may vary from 0 to the torques of that hold.

    The energies are parabolas in l. Returns the index of the next parabola.
    """
    root = limits.roots[axis]
    for index in range(limits.holds):
        mine, sign, moved = index - limits.delay, 1.0, mover_motion[index][axis]
        rise = root * more if mine >= 0 else 0.0
        slope = rise * (mine + limits.first)
        for side in range(2):
            pace = memory.lost[axis][side] + root * norm
            base = memory.starts[axis][side] + (index + 1) * pace + max(0.0, -sign * moved)
            old, asked = memory.along[index][axis] if side == 0 else memory.against[index][axis], 0.0
            if mine >= 0:
                old, asked = max(old, sign * fixed), sign * torque
            place = write_parabolas(memory, place, old, asked, base, slope)  # it may turn inside the hold
            place = write_parabolas(memory, place, old, asked, 0.5 * base + 0.25 * pace, 0.5 * slope + 0.25 * rise)
            sign = -1.0
        memory.ends[axis * limits.holds + index] = place
    return place


def largest_parabola(memory: PerAxisMemory, first: int, end: int, share: float, least: float) -> tuple[int, float]:
    """Return the index and the value [J] of the parabola that is largest at a share.

    If none exceeds `least`, return `least` and the index of the last parabola, which is always 0.
    """
    active, largest = -1, least
    for place in range(first, end):
        given = memory.constant[place] + share * (memory.linear[place] + share * memory.square[place])
        if given > largest:
            active, largest = place, given
    return active, largest


def energy_parabola(limits: PerAxisLimits, memory: PerAxisMemory, share: float) -> tuple[float, float, float]:
    """Return A, B, C of the parabola that equals, at this share, the most energy that all axes may give out [J]."""
    least = 0.0 if limits.is_late else -inf
    fixed = linear = square = 0.0
    cell = place = 0
    for _ in range(len(memory.largest)):
        value = a = b = c = 0.0
        most = worst_a = worst_b = worst_c = 0.0
        for index in range(limits.holds):
            active, largest = largest_parabola(memory, place, memory.ends[cell], share, least)
            value += largest
            a, b, c = a + memory.constant[active], b + memory.linear[active], c + memory.square[active]
            if index <= limits.delay or value > most:
                most, worst_a, worst_b, worst_c = value, a, b, c
            place, cell = memory.ends[cell], cell + 1
        fixed, linear, square = fixed + worst_a, linear + worst_b, square + worst_c
    while cell < len(memory.ends):
        active, _ = largest_parabola(memory, place, memory.ends[cell], share, 0.0)
        fixed, linear = fixed + memory.constant[active], linear + memory.linear[active]
        square += memory.square[active]
        place, cell = memory.ends[cell], cell + 1
    return fixed, linear, square


def needed_by_hand(axes: AxisLimits, limits: PerAxisLimits, memory: PerAxisMemory, mover_motion: Matrix) -> float:
    """Return the most energy that the queued torques may give out to a hand within its declared force [J]."""
    write_cells(axes, limits, memory, mover_motion, memory.nothing, memory.nothing)
    return energy_parabola(limits, memory, 0.0)[0]


def largest_share(limits: PerAxisLimits, memory: PerAxisMemory, budget: float) -> float:
    """Return the largest share l <= 1 at which the bounds of `write_cells` sum to `budget` at most [J], 0 if none."""
    share = 1.0
    for _ in range(_PASSES):
        fixed, linear, square = energy_parabola(limits, memory, share)
        size = abs(fixed) + share * (abs(linear) + share * square)
        if fixed + share * (linear + share * square) <= budget + _ROUNDING * size:
            return share
        smaller = hand_force_bound(budget - fixed, linear, square)
        if not smaller < share:
            return 0.0
        share = smaller
    return 0.0


def share_per_axis(
    axes: AxisLimits, limits: PerAxisLimits, memory: PerAxisMemory, mover_motion: Matrix, torques: Buffer, budget: float
) -> float:
    """Return the largest share l <= 1 of new torques that the hand-force certificate permits; 0 if there is none.

    Args:
        axes: Properties of the motor axes.
        limits: Per-axis limits of the group.
        memory: Buffers of the certificates, after `take_sent`.
        mover_motion: Motion of a mover in future holds, (holds, axes) [m or rad].
        torques: Requested torques W, (axes,) [N*m or N].
        budget: Energy that may be given out [J].
    """
    write_cells(axes, limits, memory, mover_motion, torques, memory.nothing)
    return largest_share(limits, memory, budget)


def inward_first(
    axes: AxisLimits, limits: PerAxisLimits, memory: PerAxisMemory, mover_motion: Matrix, torques: Buffer,
    quanta: Buffer, budget: float, found: Buffer,
) -> None:  # fmt: skip
    """Choose the torques to send: first on axes that move against their torque, then a common share on the others.

    An axis that moves against its torque absorbs energy, independently of the others. Without this order a group with
    an empty account could never start, because the first torque of an axis at rest gives out F^2 T^2 / 2m. The force of
    the group changes direction while the account is short. Torques that need no energy are sent even in debt.

    Args:
        axes: Properties of the motor axes.
        limits: Per-axis limits of the group.
        memory: Buffers of the certificates, after `take_sent`.
        mover_motion: Motion of a mover in future holds, (holds, axes) [m or rad].
        torques: Requested torques W, (axes,) [N*m or N].
        quanta: Torque quanta of the drives; torques are rounded towards 0, (axes,).
        budget: Energy that may be given out [J].
        found: Receives the rounded torques, (axes,).
    """
    count = len(torques)
    for i in range(count):
        memory.others[i] = found[i] = 0.0
        memory.new[i] = memory.starts[i][0 if torques[i] > 0.0 else 1] * abs(torques[i])
        memory.rest[i] = torques[i] if not memory.new[i] < 0.0 else 0.0
    reserve = max(budget, needed_by_hand(axes, limits, memory, mover_motion))
    for _ in range(count):  # the axis that brings in most first
        axis = 0
        for i in range(1, count):
            if memory.new[i] < memory.new[axis]:
                axis = i
        if not memory.new[axis] < 0.0:
            break
        memory.new[axis] = 0.0
        for i in range(count):
            memory.alone[i] = torques[i] if i == axis else 0.0
        write_cells(axes, limits, memory, mover_motion, memory.alone, memory.others)
        found[axis] = towards_zero(largest_share(limits, memory, reserve) * torques[axis], quanta[axis])
        memory.others[axis] = found[axis]
    write_cells(axes, limits, memory, mover_motion, memory.rest, memory.others)
    share = largest_share(limits, memory, budget)
    for i in range(count):
        if memory.rest[i] != 0.0:
            found[i] = towards_zero(share * torques[i], quanta[i])


def write_needs(limits: PerAxisLimits, memory: PerAxisMemory, torques: Buffer, squared: bool) -> None:
    """Store each axis's sum over all holds of queued torques |f_i| or f_i^2, and its increase if W is sent in full.

    If l W is sent, the increase is at most l or l^2 times as large.

    Args:
        limits: Per-axis limits of the group.
        memory: Buffers; `old` receives the sum, `new` the increase.
        torques: Requested torques W, (axes,); zeros for the queued torques alone.
        squared: Whether the squares are summed.
    """
    for i in range(len(torques)):
        old = new = 0.0
        torque = abs(torques[i])
        for index in range(limits.holds):
            held = max(memory.along[index][i], memory.against[index][i])
            held, asked = (held * held, torque * torque) if squared else (held, torque)
            old += held
            if index >= limits.delay:
                new += max(0.0, asked - held)
        memory.old[i], memory.new[i] = old, new


def taken_at_most(
    limits: PerAxisLimits, memory: PerAxisMemory, mover_motion: Matrix, torques: Buffer
) -> tuple[float, float]:
    """Return the most energy that a mover takes from the queued torques, and its increase by new torques [J].

    Args:
        limits: Per-axis limits of the group.
        memory: Buffers of the certificates, after `take_sent`.
        mover_motion: Motion of a mover in future holds, (holds, axes) [m or rad].
        torques: Requested torques W, (axes,); zeros for the queued torques alone.
    """
    old = new = 0.0
    for index in range(limits.holds):
        for i in range(len(torques)):
            moved, held = mover_motion[index][i], 0.0
            for place in range(first_acting(limits, index + 1), end_acting(limits, index + 1)):
                held = max(held, -memory.sent[place][i] * moved)
            old += held
            if index >= limits.delay:
                new += max(0.0, -torques[i] * moved - held)
    return old, new
