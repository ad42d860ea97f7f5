"""The energy account of a group of axes: one balance for all torques, and the energy reserved for queued torques.

It bounds what `group_certificates` leaves open: lost samples (G10), and torques that come late (G11, G12), by
`docs/theory/torques_of_a_group.md`, which has the terms too.
"""

from dataclasses import dataclass
from math import inf, sqrt
from typing import NamedTuple

from canhaptic.control.certificates.certified_torque import keep
from canhaptic.control.certificates.scalar_bounds import hand_force_bound
from canhaptic.control.multi_axis import group_certificates
from canhaptic.control.multi_axis.group_certificates import (
    Acting,
    AxisLimits,
    damping_need,
    needed_by_hand,
    pass_range,
    path_need,
    response_to_late,
    share_per_axis,
    take_sent,
    taken_at_most,
    taken_by_mover,
    work_base,
    work_gain,
    work_of_last_hold,
    write_needs,
)
from canhaptic.control.multi_axis.group_kernel import GroupHolds
from canhaptic.control.port_hamiltonian.network import dot
from canhaptic.kernels import Buffer, Matrix, list_of_zeros, new, zeros


class Gap(NamedTuple):
    """Motion of one axis over several holds, and in the hold before them."""

    holds: int
    moved: float  # in all of them [m or rad]
    start: float  # in the hold before [m or rad]
    error: float  # uncertainty of `moved` [m or rad]
    position_uncertainty: float  # uncertainty of `start` [m or rad]
    step: float  # how far a hold may go beyond the hold before [m or rad]
    lost: float  # largest share of a motion that friction takes from the next hold


def farthest(gap: Gap, sign: float, hold: int, along: bool) -> float:
    """Return an upper bound on the displacement in one of several holds, counted along `sign` [m or rad].

    Args:
        gap: Holds of the axis.
        sign: 1 or -1.
        hold: Index of the hold, 1 for the first; never the last hold.
        along: Whether the torque of that hold acts along `sign`; otherwise the last hold's torque acts against it.
    """
    holds, moved, start, error, position_uncertainty, step, lost = gap
    start, moved = sign * start, sign * moved
    first = start + position_uncertainty
    if along:
        return first + hold * (step + lost * (-first if first < 0.0 else 0.0))
    later = holds - hold
    least = start - position_uncertainty
    pairs = hold * (hold - 1) + later * (later + 1)
    total = moved + error - (hold - 1) * least + 0.5 * pairs * step
    total += 0.5 * hold * (hold - 1) * lost * (least if least > 0.0 else 0.0)
    if total <= 0.0:
        return total / (later + 1)  # nothing that friction could take
    kept, power, series = 1.0 - lost, 1.0, 0.0
    for _ in range(later + 1):
        series += power
        power *= kept
    return total / series


def uncertainty_of(gap: Gap, hold: int, torque: float, last: float) -> float:
    """Return the most by which the energy booked for one hold is too high, if a given torque acted in it [J].

    Args:
        gap: Holds of the axis.
        hold: Index of the hold, 1 for the first; never the last hold.
        torque: Torque that may have acted in that hold [N or N*m].
        last: Torque of the last hold, with which the energy of all holds was booked [N or N*m].
    """
    more = torque - last
    if more > 0.0:
        return more * farthest(gap, 1.0, hold, torque > 0.0)
    if more < 0.0:
        return -more * farthest(gap, -1.0, hold, torque < 0.0)
    return 0.0


class AccountMemory(NamedTuple):
    """Buffers of the account, shapes (axes,) where no other is given."""

    displacement: Buffer  # of the hold that ended [rad or m]
    torques: Buffer  # held in it [N*m or N]
    position_uncertainty: Buffer  # uncertainty of its displacement beyond a count [rad or m]
    before: Acting  # at the SYNC at which it began, where torques come late
    now: Acting  # buffer for the range at a later SYNC
    mover_motion: Matrix  # motion of a mover in future holds as one of the motors, (holds, axes) [rad or m]
    passing: Buffer  # buffer for the motion in one hold
    nothing: Buffer  # zeros
    sized: Buffer  # buffer for a part of torques
    apart: group_certificates.PerAxisMemory


def account_memory(limits: group_certificates.PerAxisLimits) -> AccountMemory:
    """Return the buffers of the account, filled with zeros."""
    axes, one = len(limits.roots), list_of_zeros
    return AccountMemory(
        one(axes), one(axes), one(axes), Acting(one(axes), one(axes)), Acting(one(axes), one(axes)),
        zeros(limits.holds, axes), one(axes), one(axes), one(axes), group_certificates.per_axis_memory(limits),
    )  # fmt: skip


class QueuedTorques(NamedTuple):
    """Commands already sent that act before the command computed next."""

    torques: Matrix  # a ring, (delay + 1, axes) [N*m or N]
    first: int  # place of the one that acts next; below 0 it wraps
    holds: int


class LateShare(NamedTuple):
    """Upper bound a + b l + c l^2 on the energy older torques give out, if the share l of the new ones is sent [J]."""

    constant: float
    linear: float
    square: float


class Norms(NamedTuple):
    """Upper bound least + more l on N + h, the norm of the acting torques plus the norm of the hand's force."""

    least: float
    more: float


def copy_range(axes: AxisLimits, memory: AccountMemory, ended: bool) -> None:
    """Set `memory.now` to the range of torques that may act when the last hold began, or with `ended` when it ended."""
    now, before = memory.now, memory.before
    for i in range(len(memory.torques)):
        now.highest[i], now.lowest[i] = before.highest[i], before.lowest[i]
    if ended:
        pass_range(axes, now.highest, now.lowest, memory.torques)


def norms_of(axes: AxisLimits, memory: AccountMemory, under_way: QueuedTorques, torques: Buffer, size: float) -> Norms:
    """Return an upper bound on the norm of all torques that may act (older, queued, new) plus the hand's force.

    Args:
        axes: Properties of the motor axes.
        memory: Buffers of the account.
        under_way: Queued torques, which act before W.
        torques: Requested torques W of the next free hold, (axes,) [N*m or N].
        size: Share of W that corresponds to l = 1.
    """
    total = added = 0.0
    for i in range(len(torques)):
        most = max(abs(memory.torques[i]), memory.before.highest[i], -memory.before.lowest[i])
        for place in range(under_way.first, under_way.first + under_way.holds):
            most = max(most, abs(under_way.torques[place][i]))
        root, torque = axes.timing.roots[i], size * torques[i]
        total += root * root * most * most
        added += root * root * max(0.0, torque * torque - most * most)
    return new(Norms, (sqrt(total) + axes.timing.hand, sqrt(added)))


def reach_of(axes: AxisLimits, memory: AccountMemory, i: int, sign: float, hold: int, norm: float) -> float:
    """Return X of G12: how far an axis may move under older torques in a hold, counted from 1 = next [rad or m]."""
    timing = axes.timing
    share, step, before = timing.share[i], timing.roots[i] * norm, hold - 1
    start = sign * memory.displacement[i] + axes.counts[i] + memory.position_uncertainty[i]
    if start < 0.0:
        start /= timing.growth
        for _ in range(before):
            start -= axes.lost[i] * start
    moved = start + before * step
    reach = share * (0.5 + share) * step
    return reach + share * moved if moved > 0.0 else reach


def given_late(
    axes: AxisLimits, memory: AccountMemory, held: Buffer, fixed: float, size: float, hold: int, norms: Norms, end: bool
) -> LateShare:
    """Return a bound on the energy that older torques give out in one hold, beyond that of its own torques; see G11.

    Args:
        axes: Properties of the motor axes.
        memory: Buffers of the account; `now` is the range of acting torques at the SYNC where the hold begins.
        held: Torques of the hold, (axes,) [N*m or N]; the share fixed + l size of them is sent.
        fixed: 1 if they are sent in full for every l, else 0.
        size: 0 if `fixed` is 1, else the share of them that corresponds to l = 1.
        hold: Index of the hold from now, the next being 1.
        norms: Bound on the norms of the acting torques and of the hand.
        end: Whether to bound the hold after that one instead: all that the torques still give out if none follows.
    """
    constant = linear = square = 0.0
    for i in range(len(held)):
        share, left = axes.timing.share[i], axes.timing.left[i]
        further = share * (1.0 + share if end else share) * axes.timing.roots[i] * norms.more
        for side in range(2):
            sign = 1.0 if side == 0 else -1.0
            older = memory.now.highest[i] if side == 0 else -memory.now.lowest[i]
            if end:
                torque, apart = sign * size * held[i], max(0.0, left * older)
                change = max(0.0, torque + left * max(0.0, older - torque)) - apart
            else:
                apart = max(0.0, older - sign * (fixed * held[i]))
                change = max(0.0, older - sign * ((fixed + size) * held[i])) - apart
            if apart != 0.0 or change != 0.0:
                reach = reach_of(axes, memory, i, sign, hold + end, norms.least)
                constant += apart * reach
                linear += change * reach + apart * further
                square += change * further
    return new(LateShare, (constant, linear, square))


def share_of_late(
    axes: AxisLimits, memory: AccountMemory, under_way: QueuedTorques, torques: Buffer, size: float
) -> LateShare:
    """Return a bound on the energy older torques give out from now on, as a function of the sent share of new torques.

    Args:
        axes: Properties of the motor axes.
        memory: Buffers of the account; `now` is changed.
        under_way: Queued torques, which act before W.
        torques: Requested torques W, (axes,).
        size: Share of W that corresponds to l = 1.
    """
    norms = norms_of(axes, memory, under_way, torques, size)
    copy_range(axes, memory, True)
    constant, hold = 0.0, under_way.holds + 1
    for place in range(under_way.holds):
        held = under_way.torques[under_way.first + place]
        constant += given_late(axes, memory, held, 1.0, 0.0, place + 1, norms, False).constant
        pass_range(axes, memory.now.highest, memory.now.lowest, held)
    highest, lowest = memory.now.highest, memory.now.lowest
    early = given_late(axes, memory, torques, 0.0, size, hold, norms, False)
    after = given_late(axes, memory, torques, 0.0, size, hold, norms, True)
    none = size * response_to_late(axes, torques, highest, lowest, memory.nothing, axes.during)
    for i in range(len(torques)):
        memory.sized[i] = size * torques[i]
    whole = size * response_to_late(axes, torques, highest, lowest, memory.sized, axes.during)
    constant += early.constant + after.constant
    return new(LateShare, (
        constant, none + early.linear + after.linear, whole - none + early.square + after.square
    ))  # fmt: skip


def given_in_debt(axes: AxisLimits, memory: AccountMemory, under_way: QueuedTorques, torques: Buffer) -> LateShare:
    """Return a bound on the energy that a share l of the new torques W adds, beyond l base + l^2 gain; for a debt."""
    norms, full, cross = norms_of(axes, memory, under_way, torques, 1.0), 0.0, 0.0
    highest, lowest = memory.now.highest, memory.now.lowest
    none = response_to_late(axes, torques, highest, lowest, memory.nothing, axes.during)
    whole = response_to_late(axes, torques, highest, lowest, torques, axes.during)
    for i in range(len(torques)):
        full += axes.timing.roots[i] * axes.timing.roots[i] * torques[i] * torques[i]
    full = sqrt(full)
    for i in range(len(torques)):
        share, older = axes.timing.share[i], max(highest[i], -lowest[i])
        cross += older * share * (share + axes.timing.left[i] * (1.0 + share)) * axes.timing.roots[i] * full
        highest[i] = lowest[i] = 0.0
    norms = new(Norms, (norms.least, full))
    early = given_late(axes, memory, torques, 0.0, 1.0, under_way.holds + 1, norms, False)
    after = given_late(axes, memory, torques, 0.0, 1.0, under_way.holds + 1, norms, True)
    linear = none + cross + early.linear + after.linear
    return new(LateShare, (0.0, linear, whole - none + early.square + after.square))


def older_size(axes: AxisLimits, memory: AccountMemory, torques: Buffer) -> float:
    """Return the norm |f|_P of the older torques at the SYNC of the new torques W, divided by the norm of W."""
    older = size = 0.0
    for i in range(len(torques)):
        most = max(memory.now.highest[i], -memory.now.lowest[i])
        older += axes.during[i] * most * most
        size += axes.during[i] * torques[i] * torques[i]
    return sqrt(older / size) if size > 0.0 else 0.0


def uncertainty_of_late_group(
    axes: AxisLimits, memory: AccountMemory, moved: Buffer, held: Buffer
) -> tuple[float, float]:
    """Return by how much less energy than booked may have been received in a hold, because torques came late [J].

    Args:
        axes: Properties of the motor axes.
        memory: Buffers of the account before the hold; `before` is set to the range of torques at the hold's start.
        moved: Displacement in the hold, (axes,) [rad or m].
        held: Torques held in the hold [N*m or N].

    Returns:
        The shortfall by the declared hand force or speed (by damping if neither is declared), and the shortfall by
        the damping of the devices, 0 where it is not known.
    """
    timing, push, total, damped = axes.timing, 0.0, 0.0, 0.0
    for i in range(len(held)):
        most = max(abs(held[i]), abs(memory.torques[i]), memory.before.highest[i], -memory.before.lowest[i])
        push += timing.roots[i] * timing.roots[i] * most * most
    push = sqrt(push) + timing.hand
    highest, lowest = memory.before.highest, memory.before.lowest
    for i in range(len(held)):
        share, older = timing.share[i], max(highest[i] - memory.torques[i], memory.torques[i] - lowest[i])
        apart = abs(held[i] - memory.torques[i]) + timing.left[i] * max(0.0, older)
        count, path = axes.counts[i], abs(moved[i]) + axes.counts[i]
        if axes.by_hand:
            start = abs(memory.displacement[i]) + memory.position_uncertainty[i] + count
            further = timing.swing[i] * (0.5 + share) * timing.roots[i] * push
            total += apart * share * (max(start, timing.swing[i] * path) + further)
        elif axes.path > 0.0:
            total += apart * share * axes.path
        if axes.by_damping:
            damped += apart * share * (path + apart / (4.0 * axes.damping[i]))
    pass_range(axes, highest, lowest, memory.torques)
    return (total if axes.by_hand or axes.path > 0.0 else damped), damped


def uncertainty_of_late_gap(
    axes: AxisLimits, memory: AccountMemory, ended: GroupHolds, missed: int, axis: int, excursion: float
) -> float:
    """Return the most by which late torques make one axis's booked energy over several holds too high or too low [J].

    It is added to the result of `uncertainty_of_axis`, and grows with the largest difference of two torques that may
    have acted. `memory.before` is set to the range of torques at the SYNC at which the last hold began.

    Args:
        axes: Properties of the motor axes.
        memory: Buffers of the account before the holds.
        ended: The holds that ended.
        missed: Number of lost samples.
        axis: Index of the axis.
        excursion: Largest displacement of the axis in any hold [m or rad].
    """
    timing, before, last = axes.timing, memory.before, ended.applied[axis]
    highest, lowest = max(before.highest[axis], memory.torques[axis]), min(before.lowest[axis], memory.torques[axis])
    for place in range(min(missed, len(ended.lost))):
        highest, lowest = max(highest, ended.lost[place][axis]), min(lowest, ended.lost[place][axis])
    before.highest[axis], before.lowest[axis] = highest, lowest
    apart, share, holds = max(highest, last) - min(lowest, last), timing.share[axis], missed + 1
    if axes.by_hand:
        return holds * apart * share * timing.swing[axis] * 2.0 * excursion
    if axes.path > 0.0:
        return holds * apart * share * axes.path
    moved = abs(ended.displacement[axis]) + axes.counts[axis]
    return apart * share * (moved + holds * 3.0 * apart / (4.0 * axes.damping[axis]))


def older_needs(axes: AxisLimits, memory: AccountMemory) -> tuple[float, float]:
    """Return the energy to reserve for older torques of the last SYNC, by device damping and by hand speed [J]."""
    damped = paths = 0.0
    if not axes.timing.is_uneven:
        return damped, paths
    copy_range(axes, memory, ended=True)
    for i in range(len(memory.torques)):
        older = max(memory.now.highest[i], -memory.now.lowest[i])
        paths += older * axes.timing.tail_path
        if axes.by_damping:
            damped += older * older * axes.timing.tail[i] / axes.squares[i]
    return damped, paths


@dataclass(slots=True)
class GroupAccount:
    """State of the account: stored energy, surplus, and the uncertain part of the energy."""

    h_s: float = 0.0  # stored energy that the network may still give [J]
    h_dis: float = 0.0  # surplus still to be dissipated [J]
    dissipated: float = 0.0  # by the devices for certain, and not forgotten [J]
    changes: float = 0.0  # uncertain energy due to encoders, up to the last change of torque [J]
    uncertainty: float = 0.0  # largest shortfall of the energy that came in so far [J]: encoder counts and lost samples
    unrecovered: float = 0.0  # dissipated or leaked, and not paid [J]


class AccountSettings(NamedTuple):
    """Constants of the account in one run."""

    axes: AxisLimits
    apart: group_certificates.PerAxisLimits
    moves: bool  # whether a mover may give or take energy


class Accounting(NamedTuple):
    """The account of a group at a SYNC."""

    settings: AccountSettings
    account: GroupAccount
    memory: AccountMemory
    under_way: QueuedTorques


def end_group_hold(settings: AccountSettings, account: GroupAccount, memory: AccountMemory, ended: GroupHolds) -> float:
    """Book one hold by its displacements and the torques applied in it.

    Returns:
        Largest shortfall of the energy received against the booked energy, because torques came late [J].
    """
    axes = settings.axes
    uncertainty = 0.0
    if axes.timing.is_uneven:
        uncertainty, damped = uncertainty_of_late_group(axes, memory, ended.displacement, ended.applied)
        if axes.by_damping:  # a promise to every hand rests on no hand
            account.dissipated += uncertainty - damped
    counted = 0.0
    for i in range(len(ended.applied)):
        torque, count = ended.applied[i], axes.counts[i]
        if axes.by_damping or axes.coarse:
            certain = abs(ended.displacement[i]) - count
            if certain > 0.0:
                account.dissipated += axes.damping[i] * certain * certain
            account.changes += 0.5 * count * abs(torque - memory.torques[i])
            counted += 0.5 * count * abs(torque)
        memory.displacement[i], memory.torques[i], memory.position_uncertainty[i] = ended.displacement[i], torque, 0.0
    account.uncertainty = account.changes + counted
    return uncertainty


def end_group_gap(
    settings: AccountSettings, account: GroupAccount, memory: AccountMemory, ended: GroupHolds, missed: int
) -> tuple[float, float]:
    """Book several holds of which only the total displacement is known.

    The torque of the last hold was read back. In every other hold each axis may have held any torque sent for it until
    then, or the torque of the hold before the first (see the module).

    Returns:
        Largest shortfall of the energy received against the booked energy, and its largest excess because torques came
        late [J]; excess for other reasons is added by the meter of each axis.
    """
    axes, holds, growth = settings.axes, missed + 1, settings.axes.timing.growth
    push = 0.0
    for i in range(len(ended.applied)):
        largest = largest_of(memory, ended, missed, i)
        push += (axes.before[i] + axes.during[i]) * largest * largest
    push = sqrt(push) + axes.hand
    uncertainty = counted = further = 0.0
    for i in range(len(ended.applied)):
        moved, count, last = ended.displacement[i], axes.counts[i], ended.applied[i]
        largest = largest_of(memory, ended, missed, i)
        step = sqrt(axes.before[i] + axes.during[i]) * push if axes.by_hand else 0.0
        start, position_uncertainty = memory.displacement[i], memory.position_uncertainty[i] + count
        excursion = abs(moved) + count + holds * ((abs(start) + position_uncertainty) * growth + holds * step)
        uneven = (growth - 1.0) * excursion
        gap = Gap(holds, moved, start, count + holds * uneven, position_uncertainty + uneven, step, axes.lost[i])
        uncertainty += uncertainty_of_axis(axes, memory, ended, gap, missed, i)
        if axes.timing.is_uneven:
            late = uncertainty_of_late_gap(axes, memory, ended, missed, i, excursion + step)
            uncertainty, further = uncertainty + late, further + late
        memory.position_uncertainty[i] = (
            0.5 * missed * step + axes.lost[i] * holds * excursion + uneven if axes.by_hand else 0.0
        )
        account.changes += holds * count * largest
        certain = abs(moved) - count
        if certain > 0.0:
            account.dissipated += axes.damping[i] * certain * certain / holds
        counted += 0.5 * count * abs(last)
    for i in range(len(ended.applied)):
        memory.displacement[i], memory.torques[i] = ended.displacement[i] / holds, ended.applied[i]
    account.uncertainty = account.changes + counted
    return uncertainty, further


def largest_of(memory: AccountMemory, ended: GroupHolds, missed: int, axis: int) -> float:
    """Return the largest |torque| that one axis may have had in the holds that ended, or before them [N*m or N]."""
    most = max(abs(memory.torques[axis]), abs(ended.applied[axis]))
    most = max(most, memory.before.highest[axis], -memory.before.lowest[axis])
    for place in range(min(missed, len(ended.lost))):
        most = max(most, abs(ended.lost[place][axis]))
    return most


def uncertainty_of_axis(
    axes: AxisLimits, memory: AccountMemory, ended: GroupHolds, gap: Gap, missed: int, axis: int
) -> float:
    """Return by how much less energy than booked one axis may have received over several holds [J].

    Negative if it certainly received more than booked. The bounds are derived in the module's docstring.
    """
    last, damping, total = ended.applied[axis], axes.damping[axis], 0.0
    for hold in range(1, missed + 1):
        most = largest = -inf
        square = 0.0
        for place in range(-1, min(hold, len(ended.lost))):
            torque = memory.torques[axis] if place < 0 else ended.lost[place][axis]
            more = torque - last
            if axes.by_hand:
                most = max(most, uncertainty_of(gap, hold, torque, last))
            elif axes.path > 0.0:
                most = max(most, abs(more))
            else:
                largest = max(largest, more * gap.moved + abs(more) * gap.error)
                square = max(square, more * more)
        if axes.by_hand or axes.path > 0.0:
            total += most
        else:
            total += largest / gap.holds
            total += square / (4.0 * damping)
    return total * axes.path if axes.path > 0.0 and not axes.by_hand else total


def uncertainty_of_mover(memory: AccountMemory, ended: GroupHolds, hold: int) -> float:
    """Return by how much less energy than booked the mover may have supplied in one hold whose sample was lost [J].

    Args:
        memory: Buffers of the account, before `end_group_gap`; `passing` is the motion of the mover in the hold.
        ended: The holds that ended.
        hold: Index of the hold, 0 for the first.
    """
    last, moved, total = ended.applied, memory.passing, 0.0
    for i in range(len(last)):
        most = (last[i] - memory.torques[i]) * moved[i]
        for place in range(min(hold + 1, len(ended.lost))):
            most = max(most, (last[i] - ended.lost[place][i]) * moved[i])
        total += most
    return total


def certain_energy(account: GroupAccount, allowance: float) -> float:
    """Return the energy that the next torques may give out [J].

    Energy dissipated or leaked earlier cannot be given out again. The uncertainty due to encoders is subtracted only
    as far as it exceeds that energy.
    """
    energy = account.h_s - account.h_dis + allowance
    lacking = account.uncertainty - account.unrecovered
    return energy - lacking if lacking > 0.0 else energy


def fade(account: GroupAccount, share: float) -> None:
    """Discard part of the devices' booked dissipation, out of contact; what covers a deficit is not discarded."""
    if account.dissipated > 0.0:
        energy = account.h_s - account.h_dis
        keep(account, energy, share * max(0.0, energy + account.dissipated))


def quotient(budget: float, need: float) -> float:
    """Return budget / need; infinite if nothing is needed, 0 if the budget is negative."""
    if not budget >= 0.0:
        return 0.0
    return budget / need if need > 0.0 else inf


def worst_case(at: Accounting, torques: Buffer, count: int) -> float:
    """Return the bound `work_base` for torques that act after the first `count` queued commands [J]."""
    axes, memory, sent, first = at.settings.axes, at.memory, at.under_way.torques, at.under_way.first
    along = work_of_last_hold(axes, torques, memory.displacement, memory.position_uncertainty)
    if axes.timing.is_uneven:
        copy_range(axes, memory, False)
    return work_base(axes, torques, memory.displacement, along, memory.torques, sent, first, count, memory.now)


def extraction_of(at: Accounting, hold: int) -> float:
    """Return the most energy that the torques of one queued command may give out during its hold [J]."""
    axes, memory, torques = at.settings.axes, at.memory, at.under_way.torques[at.under_way.first + hold]
    taken = worst_case(at, torques, hold) + work_gain(axes, torques)
    if axes.timing.is_uneven:
        taken += response_to_late(axes, torques, memory.now.highest, memory.now.lowest, torques, axes.during)
    return taken + taken_by_mover(torques, memory.mover_motion[hold]) if at.settings.moves else taken


def moved_at_most(at: Accounting) -> float:
    """Return the energy that a mover takes from the queued torques, summed over the holds in which it takes any [J]."""
    total, under_way = 0.0, at.under_way
    if at.settings.moves:
        for hold in range(under_way.holds):
            total += max(0.0, taken_by_mover(under_way.torques[under_way.first + hold], at.memory.mover_motion[hold]))
    return total


def needed_under_way(at: Accounting) -> float:
    """Return the most energy that the queued torques may give out to a hand within its declared force [J]."""
    axes, memory, worst, given = at.settings.axes, at.memory, 0.0, 0.0
    for hold in range(at.under_way.holds):
        given += extraction_of(at, hold)
        worst = max(worst, given)
    if not axes.timing.is_uneven:
        return worst
    return worst + share_of_late(axes, memory, at.under_way, memory.nothing, 1.0).constant


def free_energy(at: Accounting, energy: float) -> float:
    """Return the part of `energy` that need not be reserved for the queued torques [J]."""
    settings, account, memory, under_way = at
    axes = settings.axes
    if settings.apart.is_apart:
        free = free_energy_per_axis(at, energy)
        return max(free, energy - needed_under_way(at)) if has_two_bounds(at) else free
    free, moved = 0.0, moved_at_most(at)
    if axes.by_hand:
        free = max(free, energy - needed_under_way(at))
    needs, paths = older_needs(axes, memory)
    for hold in range(under_way.holds):
        torques = under_way.torques[under_way.first + hold]
        if axes.path > 0.0:
            paths += path_need(axes, torques)
        if axes.by_damping:
            needs += damping_need(axes, torques)
    if axes.path > 0.0:
        free = max(free, energy - moved - paths)
    if axes.by_damping:
        free = max(free, energy + account.dissipated - (moved + needs))
    return free


def has_two_bounds(at: Accounting) -> bool:
    """Return whether the axes together bound the same queue as the axes one by one, so that the larger share counts.

    Both bound the energy of all that is queued and of the new torques, from one measured state and with one budget. It
    does not matter by which of them the queue was admitted. With losses the axes one by one bound more queues.
    """
    axes, apart = at.settings.axes, at.settings.apart
    return axes.by_hand and apart.losses == 0 and not axes.timing.is_uneven and not at.settings.moves


def shares(at: Accounting, torques: Buffer, energy: float) -> tuple[float, float, float]:
    """Return the share of torques that each certificate permits: hand force, device damping, hand speed; may exceed 1.

    Args:
        at: Account of the group.
        torques: Requested torques W of the next free hold [N*m or N].
        energy: Energy that torques may give out [J].
    """
    settings, account, memory, under_way = at
    axes = settings.axes
    if settings.apart.is_apart:
        by_force, by_damping, by_speed = shares_per_axis(at, torques, energy)
        if by_force < 1.0 and has_two_bounds(at) and energy >= needed_under_way(at):
            by_force = max(by_force, by_hand_force(at, torques, energy, 0.0))
        return by_force, by_damping, by_speed
    by_force = by_damping = by_speed = moved = 0.0
    if settings.moves:
        moved = taken_by_mover(torques, memory.mover_motion[under_way.holds])
    if axes.by_hand:
        by_force = by_hand_force(at, torques, energy, moved)
    if axes.by_damping or axes.path > 0.0:
        more, taken = max(0.0, moved), moved_at_most(at)
        needs, paths = older_needs(axes, memory)
        for hold in range(under_way.holds):
            acting = under_way.torques[under_way.first + hold]
            needs += damping_need(axes, acting) if axes.by_damping else 0.0
            paths += path_need(axes, acting)
        if axes.by_damping:
            budget = energy + account.dissipated - more - taken - needs
            by_damping = sqrt(quotient(budget, damping_need(axes, torques)))
        if axes.path > 0.0:
            budget = energy - taken - paths
            by_speed = quotient(budget, path_need(axes, torques) + more)
    return by_force, by_damping, by_speed


def by_hand_force(at: Accounting, torques: Buffer, energy: float, moved: float) -> float:
    """Return the share of torques that the hand-force certificate permits; at most 1 where torques come late.

    `moved` is the energy that a mover takes from the torques [J]; the other arguments are as for `shares`.
    """
    axes, memory, under_way = at.settings.axes, at.memory, at.under_way
    for hold in range(under_way.holds):
        extraction = extraction_of(at, hold)
        along = dot(under_way.torques[under_way.first + hold], torques)
        energy -= extraction if along >= 0.0 else max(0.0, extraction)
    base, gain = worst_case(at, torques, under_way.holds) + moved, work_gain(axes, torques)
    if not axes.timing.is_uneven:
        return hand_force_bound(energy, base, gain)
    late = share_of_late(axes, memory, under_way, torques, 1.0)
    if not energy >= late.constant:
        own = given_in_debt(axes, memory, under_way, torques)  # the share that certainly absorbs energy
        return min(1.0, hand_force_bound(0.0, base + own.linear, max(0.0, gain + own.square)))
    share = share_beyond(energy, base, gain, late, 1.0)
    size = min(1.0, older_size(axes, memory, torques))
    if share < 1.0 and size > 0.0:
        late = share_of_late(axes, memory, under_way, torques, size)
        if energy >= late.constant:
            share = max(share, share_beyond(energy, base, gain, late, size))
    return share


def share_beyond(energy: float, base: float, gain: float, late: LateShare, size: float) -> float:
    """Return the largest share, up to `size`, of new torques that the energy covers in addition to older torques.

    `late` bounds the energy of older torques, l = 1 at share `size`; its constant is at most `energy`. `base` and
    `gain` are those of all new torques.
    """
    start, more = size * base + late.linear, max(0.0, size * size * gain + late.square)
    return size * min(1.0, hand_force_bound(energy - late.constant, start, more))


def damping_need_of(axes: AxisLimits, squares: Buffer) -> float:
    """Return the energy that device damping must cover, given each axis's sum of F^2: sum(F^2 (T + theta) / 4b) [J]."""
    total = 0.0
    for i in range(len(squares)):
        total += squares[i] / axes.squares[i]
    return total


def size_of(values: Buffer) -> float:
    """Return the sum of values."""
    total = 0.0
    for value in values:
        total += value
    return total


def take_all_sent(at: Accounting) -> None:
    """Copy the hold that ended and the torques that may still act to the buffers of the per-axis certificates."""
    settings, _, memory, under_way = at
    copy_range(settings.axes, memory, True)
    take_sent(
        settings.axes, settings.apart, memory.apart, memory.displacement, memory.position_uncertainty, memory.torques,
        under_way.torques, under_way.first, memory.now,
    )  # fmt: skip


def free_energy_per_axis(at: Accounting, energy: float) -> float:
    """Return the result of `free_energy` by the per-axis certificates."""
    settings, account, memory, _ = at
    axes, limits, apart, free = settings.axes, settings.apart, memory.apart, 0.0
    take_all_sent(at)
    older_damped, older_paths = older_needs(axes, memory)
    moved = taken_at_most(limits, apart, memory.mover_motion, apart.nothing)[0] if settings.moves else 0.0
    if axes.by_hand:
        free = max(free, energy - needed_by_hand(axes, limits, apart, memory.mover_motion))
    if axes.path > 0.0:
        write_needs(limits, apart, apart.nothing, squared=False)
        free = max(free, energy - moved - axes.path * size_of(apart.old) - older_paths)
    if axes.by_damping:
        write_needs(limits, apart, apart.nothing, squared=True)
        free = max(free, energy + account.dissipated - moved - damping_need_of(axes, apart.old) - older_damped)
    return free


def shares_per_axis(at: Accounting, torques: Buffer, energy: float) -> tuple[float, float, float]:
    """Return the result of `shares` by the per-axis certificates; the share by hand force is at most 1."""
    settings, account, memory, _ = at
    axes, limits, apart = settings.axes, settings.apart, memory.apart
    take_all_sent(at)
    older_damped, older_paths = older_needs(axes, memory)
    by_force = by_damping = by_speed = moved = more = 0.0
    if settings.moves:
        moved, more = taken_at_most(limits, apart, memory.mover_motion, torques)
    if axes.by_hand:
        by_force = share_per_axis(axes, limits, apart, memory.mover_motion, torques, energy)
    if axes.by_damping:
        write_needs(limits, apart, torques, squared=True)
        budget = energy + account.dissipated - moved - more
        budget -= damping_need_of(axes, apart.old) + older_damped
        by_damping = sqrt(quotient(budget, damping_need_of(axes, apart.new)))
    if axes.path > 0.0:
        write_needs(limits, apart, torques, squared=False)
        budget = energy - moved - axes.path * size_of(apart.old) - older_paths
        by_speed = quotient(budget, axes.path * size_of(apart.new) + more)
    return by_force, by_damping, by_speed
