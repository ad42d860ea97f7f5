"""The certificates for axes that may act apart: each holds its new torque, an older one, or a part of either.

`bound` holds for torques that act together. Where a frame is lost, a link policy ramps, or a limiter or drive cuts one
axis alone, the group's torque turns, and energy that one axis was to bring in is missing while another still gives it
out. With `max_consecutive_losses` = L declared, the energy is certified axis by axis: in every hold from now on, axis i
may have any torque between 0 and one of those sent for it, each of which may stay for L more holds. With D_ij the
displacement of axis i in hold j, counted along such a torque f,

    energy out <= sum over holds and axes of max over f of max(0, f D_ij),
    D_ij <= D_i0 + j sqrt(r_i) (N + h),        r_i = T^2 / m_i,

N the largest |f|_r of all torques that may act, h that of the hand: for any inertia M >= diag(m) one axis answers to
the torques of all with no more than this (Cauchy-Schwarz). f D_ij grows with f where it is positive, so that the ends
of the interval are enough. With the new torques scaled by l <= 1, N <= N_0 + l N_1 with
N_1^2 = sum(r_i max(0, W_i^2 - f_i^2)), f_i the largest sent before. Every term is a parabola in l, their sum convex,
and the largest l within the budget is found by solving for the terms that count at the last one, from l = 1 down.

**Torques that come late** (`hold_timing`). In a hold, axis i may then have any course between 0 and the torques of that
hold, and gives out no more than the largest times the way V that it goes along it: for an axis that gains a T in the
hold, V = D_ij where it begins outward, and V <= (D_ij + a T^2 / 2) / 2 where it turns inside the hold and
D_ij <= a T^2 / 2. What an older torque has beyond all of those acts for theta alone (`write_tail`), and all of them,
once more, in the hold after the last. A mover that gives energy gives it to the torque that is held, which may be
none.

A mover's motion, known in advance, is taken off D_ij (`bound`). The hand counts axis by axis as well: a force across
the torque of the group that pulls one axis along its own torque is part of the declared force.
"""

from math import sqrt
from typing import Final

from canhaptic.control.certificates.scalar_bounds import hand_force_bound
from canhaptic.control.multi_axis.group_certificates import Acting, AxisLimits
from canhaptic.control.multi_axis.late_cells import write_late_cells, write_parabolas
from canhaptic.control.multi_axis.per_axis_memory import PerAxisLimits, PerAxisMemory
from canhaptic.kernels import Buffer, Matrix

_PASSES: Final = 24
"""Most passes of the search for a share; an axis that needs more renders nothing."""
_ROUNDING: Final = 1e-12


def take_sent(
    axes: AxisLimits, limits: PerAxisLimits, memory: PerAxisMemory, displacement: Buffer, blur: Buffer,
    torques: Buffer, under_way: Matrix, first: int, older: Acting,
) -> None:  # fmt: skip
    """Takes the hold that ended and the torques that may still act.

    Args:
        axes: What the certificates know of the motor axes.
        limits: Of the group.
        memory: Written.
        displacement: In the hold that ended, (axes,) [rad or m].
        blur: How much further each axis may have moved in it (axes,).
        torques: Held in it, (axes,) [N*m or N].
        under_way: Sent, a ring (delay + 1, axes).
        first: Place of the torques that act next; below 0 it wraps.
        older: Range of all torques at the last SYNC, where torques come late.
    """
    for i in range(len(torques)):
        memory.sent[0][i], memory.largest[i] = torques[i], abs(torques[i])
        slack, moved = axes.counts[i] + blur[i], displacement[i]
        memory.starts[i][0], memory.starts[i][1] = slack + moved, slack - moved
        for side in range(2):
            start = memory.starts[i][side]
            memory.lost[i][side] = axes.lost[i] * max(0.0, -start)
        if not limits.is_ideal:
            take_older(axes, memory, older, i)
    for hold in range(limits.delay):
        row = under_way[first + hold]
        for i in range(len(torques)):
            memory.sent[hold + 1][i] = row[i]
            memory.largest[i] = max(memory.largest[i], abs(row[i]))
    write_largest(limits, memory)


def write_largest(limits: PerAxisLimits, memory: PerAxisMemory) -> None:
    """Writes the largest torques that may act in each hold, of those sent."""
    for index in range(limits.holds):
        for i in range(len(memory.largest)):
            up, down, found = 0.0, 0.0, False
            for place in range(first_of(limits, index + 1), end_of(limits, index + 1)):
                torque = memory.sent[place][i]
                if not found or torque > up:
                    up = torque
                if not found or -torque > down:
                    down = -torque
                found = True
            memory.along[index][i], memory.against[index][i] = up, down


def take_older(axes: AxisLimits, memory: PerAxisMemory, older: Acting, axis: int) -> None:
    """Takes the range of the torques of an axis at the last SYNC, holds of any length, and friction within them."""
    highest, lowest = older.highest[axis], older.lowest[axis]
    memory.older.highest[axis], memory.older.lowest[axis] = highest, lowest
    memory.largest[axis] = max(memory.largest[axis], highest, -lowest)
    for side in range(2):
        start, growth = memory.starts[axis][side], axes.timing.growth
        memory.starts[axis][side] = start * growth if start > 0.0 else start / growth
        memory.lost[axis][side] *= axes.timing.swing[axis] / growth


def first_of(limits: PerAxisLimits, hold: int) -> int:
    """Returns the row of the oldest torques that may act in a hold, the next one being 1."""
    return max(0, hold - limits.losses)


def end_of(limits: PerAxisLimits, hold: int) -> int:
    """Returns the row after that of the newest torques under way that may act in a hold."""
    return min(hold, limits.delay) + 1


def write_cells(
    axes: AxisLimits, limits: PerAxisLimits, memory: PerAxisMemory, coming: Matrix, torques: Buffer, fixed: Buffer
) -> None:
    """Writes what each axis may give out in each hold: the largest of some parabolas, and of 0.

    Args:
        axes: What the certificates know of the motor axes.
        limits: Of the group.
        memory: Written.
        coming: Motion of a mover in the holds to come, (holds, axes) [m or rad].
        torques: W, (axes,), of which the share l is to be found.
        fixed: Torques sent at every l, on axes without W, (axes,).
    """
    total = added = 0.0
    for i in range(len(torques)):
        response, largest, torque = limits.responses[i], memory.largest[i], abs(torques[i])
        sent = max(largest, abs(fixed[i]))
        total += response * sent * sent
        added += response * max(0.0, torque * torque - sent * sent)
    norm, more = sqrt(total) + axes.hand, sqrt(added)
    cell = place = 0
    for index in range(limits.holds):
        mine = index - limits.delay
        grown = more * (mine + limits.first) if mine >= 0 else 0.0
        for i in range(len(torques)):
            root, sign = limits.roots[i], 1.0
            for side in range(2):
                pace = memory.lost[i][side] + root * norm
                base = memory.starts[i][side] + (index + 1) * pace
                if limits.is_ideal or sign * coming[index][i] < 0.0:
                    base -= sign * coming[index][i]
                slope, new = root * grown, sign * torques[i]
                old = memory.along[index][i] if side == 0 else memory.against[index][i]
                if mine >= 0:
                    old = max(old, sign * fixed[i])
                if mine < 0:
                    new = 0.0
                place = write_parabolas(memory, place, old, new, base, slope)
                if not limits.is_ideal:  # it may turn inside the hold
                    base, slope = 0.5 * base + 0.25 * pace, 0.5 * slope + 0.25 * root * more
                    place = write_parabolas(memory, place, old, new, base, slope)
                sign = -1.0
            memory.ends[cell] = place
            cell += 1
    if not limits.is_ideal:
        write_late_cells(axes, limits, memory, torques, fixed, norm, more, place)


def needed_by_hand(axes: AxisLimits, limits: PerAxisLimits, memory: PerAxisMemory, coming: Matrix) -> float:
    """Returns the most energy [J] that the torques under way may give out to a hand within its declared force."""
    write_cells(axes, limits, memory, coming, memory.nothing, memory.nothing)
    total, place = 0.0, 0
    for cell in range(len(memory.ends)):
        most = 0.0
        while place < memory.ends[cell]:
            most = max(most, memory.constant[place])
            place += 1
        total += most
    return total


def largest_share(memory: PerAxisMemory, budget: float) -> float:
    """Returns the largest l <= 1 at which the cells, each the largest of its parabolas and 0, sum to the budget [J]."""
    share = 1.0
    for _ in range(_PASSES):
        fixed = linear = square = 0.0
        place = 0
        for cell in range(len(memory.ends)):
            most, active = 0.0, -1
            while place < memory.ends[cell]:
                value = memory.constant[place] + share * (memory.linear[place] + share * memory.square[place])
                if value > most:
                    most, active = value, place
                place += 1
            if active >= 0:
                fixed += memory.constant[active]
                linear += memory.linear[active]
                square += memory.square[active]
        size = abs(fixed) + share * (abs(linear) + share * square)
        if fixed + share * (linear + share * square) <= budget + _ROUNDING * size:
            return share
        smaller = hand_force_bound(budget - fixed, linear, square)
        if not smaller < share:
            return 0.0
        share = smaller
    return 0.0


def share_by_hand(
    axes: AxisLimits, limits: PerAxisLimits, memory: PerAxisMemory, coming: Matrix, torques: Buffer, budget: float
) -> float:
    """Returns the largest share l <= 1 of new torques within a budget [J]; 0 where none is.

    Args:
        axes: What the certificates know of the motor axes.
        limits: Of the group.
        memory: After `take_sent`.
        coming: Motion of a mover in the holds to come, (holds, axes) [m or rad].
        torques: W, (axes,) [N*m or N].
        budget: [J].
    """
    write_cells(axes, limits, memory, coming, torques, memory.nothing)
    return largest_share(memory, budget)


def raise_inward(
    axes: AxisLimits, limits: PerAxisLimits, memory: PerAxisMemory, coming: Matrix, torques: Buffer, share: float,
    budget: float, found: Buffer,
) -> None:  # fmt: skip
    """Writes torques of which axes that move against theirs get more than the share of all.

    Such an axis takes energy in, independent of the others; without it no group would begin from an empty account, as
    the first torque of an axis at rest gives out F^2 T^2 / 2m. The force of a group turns by it while the account
    is short. What costs nothing at all is sent in debt as well.

    Args:
        axes: What the certificates know of the motor axes.
        limits: Of the group.
        memory: After `take_sent`.
        coming: Motion of a mover in the holds to come, (holds, axes) [m or rad].
        torques: W, (axes,) [N*m or N].
        share: That all axes may have.
        budget: [J].
        found: Written, (axes,).
    """
    count = len(torques)
    for i in range(count):
        found[i] = share * torques[i]
        memory.new[i] = memory.starts[i][0 if torques[i] > 0.0 else 1] * abs(torques[i])
    budget = max(budget, needed_by_hand(axes, limits, memory, coming))
    for _ in range(count):  # the axis that brings in most first
        axis = 0
        for i in range(1, count):
            if memory.new[i] < memory.new[axis]:
                axis = i
        if not memory.new[axis] < 0.0:
            return
        memory.new[axis] = 0.0
        for i in range(count):
            memory.alone[i] = torques[i] if i == axis else 0.0
            memory.others[i] = 0.0 if i == axis else found[i]
        write_cells(axes, limits, memory, coming, memory.alone, memory.others)
        found[axis] = max(share, largest_share(memory, budget)) * torques[axis]


def write_needs(limits: PerAxisLimits, memory: PerAxisMemory, torques: Buffer, squared: bool) -> None:
    """Writes sums over all holds of |f_i| or f_i^2 by the torques under way, and what l or l^2 of new ones adds.

    Args:
        limits: Of the group.
        memory: Its `old` and `new` are written.
        torques: W, (axes,); zeros for those under way alone.
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


def taken_at_most(limits: PerAxisLimits, memory: PerAxisMemory, coming: Matrix, torques: Buffer) -> tuple[float, float]:
    """Returns what a mover takes at most [J] of the torques under way, and how much more of new ones.

    Args:
        limits: Of the group.
        memory: After `take_sent`.
        coming: Motion of a mover in the holds to come, (holds, axes) [m or rad].
        torques: W, (axes,); zeros for those under way alone.
    """
    old = new = 0.0
    for index in range(limits.holds):
        for i in range(len(torques)):
            moved, held = coming[index][i], 0.0
            for place in range(first_of(limits, index + 1), end_of(limits, index + 1)):
                held = max(held, -memory.sent[place][i] * moved)
            old += held
            if index >= limits.delay:
                new += max(0.0, -torques[i] * moved - held)
    return old, new
