"""The account of a group between holds: one scalar balance for all its torques, and the certificates of the next."""

from dataclasses import dataclass
from math import inf, sqrt
from typing import NamedTuple

from canhaptic.control.certificates.lost_samples import Gap, doubt_of
from canhaptic.control.certificates.scalar_bounds import hand_force_bound
from canhaptic.control.certificates.torque_bound import keep
from canhaptic.control.multi_axis.group_certificates import (
    AxisLimits,
    along_last,
    base_of,
    damping_need,
    gain_of,
    path_need,
    taken_by_mover,
)
from canhaptic.control.multi_axis.group_commands import GroupHolds
from canhaptic.control.multi_axis.per_axis_certificates import (
    PerAxisLimits,
    PerAxisMemory,
    needed_by_hand,
    share_by_hand,
    take_sent,
    taken_at_most,
    write_needs,
)
from canhaptic.kernels import Buffer, Matrix


@dataclass(slots=True)
class GroupAccount:
    """Store, surplus and what is not known for certain."""

    h_s: float = 0.0  # stored energy that the network may still give [J]
    h_dis: float = 0.0  # surplus still to be dissipated [J]
    dissipated: float = 0.0  # by the devices for certain, and not forgotten [J]
    changes: float = 0.0  # energy that encoders leave unsure, up to the last change of torque [J]
    unsure: float = 0.0  # how much less than booked may have come in so far [J]: encoder counts and lost samples
    kept_back: float = 0.0  # dissipated or leaked, and not paid [J]
    resolution: float = 0.0  # width of what is known of the energy, where torques come late [J]


class AccountSettings(NamedTuple):
    """What is fixed for a run."""

    axes: AxisLimits
    apart: PerAxisLimits
    moves: bool  # whether a mover may give or take energy


class AccountMemory(NamedTuple):
    """Buffers of the account."""

    displacement: Buffer  # of the hold that ended, (axes,) [rad or m]
    torques: Buffer  # held in it [N*m or N]
    blur: Buffer  # by which its displacement is unsure beyond a count [rad or m]
    older: Buffer  # how far torques that acted at its end were from the one held, at most [N*m or N]
    coming: Matrix  # motion of a mover in the holds to come as one of the motors, (holds, axes) [rad or m]
    passing: Buffer  # room for that of one hold, (axes,)
    apart: PerAxisMemory


class UnderWay(NamedTuple):
    """Torques that act before the next command."""

    torques: Matrix  # a ring, (delay + 1, axes) [N*m or N]
    first: int  # place of the one that acts next; below 0 it wraps
    holds: int


def end_group_hold(settings: AccountSettings, account: GroupAccount, memory: AccountMemory, ended: GroupHolds) -> float:
    """Takes one hold, its displacements and the torques applied in it; returns `doubt_of_late_group` [J]."""
    axes = settings.axes
    doubt = 0.0 if axes.is_ideal else doubt_of_late_group(axes, account, memory, ended)
    unsure = 0.0
    for i in range(len(ended.applied)):
        torque, count = ended.applied[i], axes.counts[i]
        if axes.by_damping or axes.coarse:
            certain = abs(ended.displacement[i]) - count
            if certain > 0.0:
                account.dissipated += axes.damping[i] * certain * certain
            account.changes += 0.5 * count * abs(torque - memory.torques[i])
            unsure += 0.5 * count * abs(torque)
        memory.displacement[i], memory.torques[i], memory.blur[i] = ended.displacement[i], torque, 0.0
    account.unsure = account.changes + unsure
    return doubt


def doubt_of_late_group(axes: AxisLimits, account: GroupAccount, memory: AccountMemory, ended: GroupHolds) -> float:
    """Returns how much less than booked may have come in by a hold in which torques came late [J].

    As `certificates.hold_timing` has it for one axis: older torques, apart from the one held by their changes, act for
    a part of the hold, in which an axis moves no further than its displacements and the torques and the hand take it.
    """
    push = total = 0.0
    for i in range(len(ended.applied)):
        largest = abs(ended.applied[i]) + abs(memory.torques[i]) + memory.older[i]
        push += (axes.before[i] + axes.during[i]) * largest * largest
    push = sqrt(push) + axes.hand
    for i in range(len(ended.applied)):
        share = axes.late[i]
        apart = abs(ended.applied[i] - memory.torques[i]) + memory.older[i]
        memory.older[i] = axes.left[i] * apart
        moved = max(abs(ended.displacement[i]), abs(memory.displacement[i])) + axes.counts[i] + memory.blur[i]
        if axes.by_hand:
            further = (0.5 + share) * sqrt(axes.before[i] + axes.during[i]) * push
            total += apart * share * ((1.0 + axes.lost[i]) * moved + further)
        elif axes.path > 0.0:
            total += apart * share * axes.path
        else:
            total += apart * share * (moved + apart / (4.0 * axes.damping[i]))
    account.resolution += 2.0 * total
    return total


def end_group_gap(
    settings: AccountSettings, account: GroupAccount, memory: AccountMemory, ended: GroupHolds, missed: int
) -> float:
    """Takes several holds of which only the whole displacement is known; returns how much less may have come in [J].

    In every hold but the last, whose torque was read back, each axis may have held any torque sent for it until
    then, or the one of the hold before (`lost_samples`).
    """
    axes, holds = settings.axes, missed + 1
    push = 0.0
    for i in range(len(ended.applied)):
        largest = largest_of(memory, ended, missed, i)
        push += (axes.before[i] + axes.during[i]) * largest * largest
    push = sqrt(push) + axes.hand
    doubt = unsure = 0.0
    for i in range(len(ended.applied)):
        moved, count, last = ended.displacement[i], axes.counts[i], ended.applied[i]
        largest = largest_of(memory, ended, missed, i)
        step = sqrt(axes.before[i] + axes.during[i]) * push if axes.by_hand else 0.0
        start, blur = memory.displacement[i], memory.blur[i] + count
        gap = Gap(holds, moved, start, count, blur, step, axes.lost[i])
        doubt += doubt_of_axis(axes, memory, ended, gap, missed, i)
        excursion = abs(moved) + count + holds * (abs(start) + blur + holds * step)
        memory.blur[i] = 0.5 * missed * step + axes.lost[i] * holds * excursion if axes.by_hand else 0.0
        account.changes += holds * count * largest
        certain = abs(moved) - count
        if certain > 0.0:
            account.dissipated += axes.damping[i] * certain * certain / holds
        unsure += 0.5 * count * abs(last)
    for i in range(len(ended.applied)):
        memory.displacement[i], memory.torques[i] = ended.displacement[i] / holds, ended.applied[i]
    account.unsure = account.changes + unsure
    return doubt


def largest_of(memory: AccountMemory, ended: GroupHolds, missed: int, axis: int) -> float:
    """Returns the size of the largest torque that may have acted in the holds that ended, or before [N*m or N]."""
    most = max(abs(memory.torques[axis]), abs(ended.applied[axis]))
    for place in range(min(missed, len(ended.lost))):
        most = max(most, abs(ended.lost[place][axis]))
    return most


def doubt_of_axis(
    axes: AxisLimits, memory: AccountMemory, ended: GroupHolds, gap: Gap, missed: int, axis: int
) -> float:
    """Returns how much less than booked may have come in by one axis over several holds [J].

    Below 0 where more has for certain. By hand speed |D_j| <= v_max T; see `lost_samples` for the others.
    """
    last, damping, total = ended.applied[axis], axes.damping[axis], 0.0
    for hold in range(1, missed + 1):
        most = largest = -inf
        square = 0.0
        for place in range(-1, min(hold, len(ended.lost))):
            torque = memory.torques[axis] if place < 0 else ended.lost[place][axis]
            more = torque - last
            if axes.by_hand:
                most = max(most, doubt_of(gap, hold, torque, last))
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


def doubt_of_mover(memory: AccountMemory, ended: GroupHolds, hold: int) -> float:
    """Returns how much less than booked a mover may have given in one hold whose sample was lost [J].

    Args:
        memory: Of the account, before `end_group_gap`; its `passing` is the motion of the mover in the hold.
        ended: The holds.
        hold: 0 for the first one.
    """
    last, moved, total = ended.applied, memory.passing, 0.0
    for i in range(len(last)):
        most = (last[i] - memory.torques[i]) * moved[i]
        for place in range(min(hold + 1, len(ended.lost))):
            most = max(most, (last[i] - ended.lost[place][i]) * moved[i])
        total += most
    return total


def certain_energy(account: GroupAccount, credit: float) -> float:
    """Returns the energy [J] that the next torques may take out.

    What was dissipated or leaked is not available again, but it covers what the encoders leave unsure.
    """
    energy = account.h_s - account.h_dis + credit
    lacking = account.unsure - account.kept_back
    return energy - lacking if lacking > 0.0 else energy


def fade(account: GroupAccount, share: float) -> None:
    """Keeps a share of what the devices dissipated and the account together, out of contact."""
    if account.dissipated != 0.0:
        energy = account.h_s - account.h_dis
        keep(account, energy, share * max(0.0, energy + account.dissipated))


def worst_case(
    settings: AccountSettings, memory: AccountMemory, torques: Buffer, under_way: UnderWay, count: int
) -> float:
    """Returns the base of torques that act after some of those under way [J]; see `base_of`."""
    along = along_last(settings.axes, torques, memory.displacement, memory.blur)
    return base_of(
        settings.axes, torques, memory.displacement, along, memory.torques, under_way.torques, under_way.first, count
    )


def extraction_of(settings: AccountSettings, memory: AccountMemory, under_way: UnderWay, hold: int) -> float:
    """Returns the most energy [J] that the torques of one of the holds under way may take out in it."""
    torques = under_way.torques[under_way.first + hold]
    acts = False
    for torque in torques:
        if torque != 0.0:
            acts = True
    if not acts:
        return 0.0
    taken = worst_case(settings, memory, torques, under_way, hold) + gain_of(settings.axes, torques)
    return taken + taken_by_mover(torques, memory.coming[hold]) if settings.moves else taken


def moved_at_most(settings: AccountSettings, memory: AccountMemory, under_way: UnderWay) -> float:
    """Returns what a mover takes [J] in the holds of torques under way in which it takes anything."""
    total = 0.0
    if settings.moves:
        for hold in range(under_way.holds):
            taken = taken_by_mover(under_way.torques[under_way.first + hold], memory.coming[hold])
            if taken > 0.0:
                total += taken
    return total


def free_energy(
    settings: AccountSettings, account: GroupAccount, memory: AccountMemory, under_way: UnderWay, energy: float
) -> float:
    """Returns how much of `energy` [J] is not needed by the certificates of the torques under way."""
    axes = settings.axes
    if settings.apart.losses:
        return free_if_apart(settings, account, memory, under_way, energy)
    if under_way.holds == 0:
        return energy + account.dissipated
    free, moved = 0.0, moved_at_most(settings, memory, under_way)
    if axes.by_hand:
        worst = given = 0.0
        for hold in range(under_way.holds):
            given += extraction_of(settings, memory, under_way, hold)
            worst = max(worst, given)
        free = energy - worst
    paths = needs = 0.0
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
    return free if free > 0.0 else 0.0


def shares(
    settings: AccountSettings, account: GroupAccount, memory: AccountMemory, under_way: UnderWay, torques: Buffer,
    energy: float,
) -> tuple[float, float, float]:  # fmt: skip
    """Returns how much of the torques each certificate admits: hand force, device damping, hand speed; may be > 1.

    Args:
        settings: Of the run.
        account: Of the group.
        memory: Of the account.
        under_way: Torques that act before these.
        torques: W, for the next free hold [N*m or N].
        energy: That may be taken out [J].
    """
    axes = settings.axes
    if settings.apart.losses:
        return shares_if_apart(settings, account, memory, under_way, torques, energy)
    by_force = by_damping = by_speed = moved = 0.0
    if settings.moves:
        moved = taken_by_mover(torques, memory.coming[under_way.holds])
    if axes.by_hand:
        budget = energy
        for hold in range(under_way.holds):
            extraction = extraction_of(settings, memory, under_way, hold)
            acting, along = under_way.torques[under_way.first + hold], 0.0
            for i in range(len(torques)):
                along += acting[i] * torques[i]
            budget -= extraction if along >= 0.0 else max(0.0, extraction)
        base = worst_case(settings, memory, torques, under_way, under_way.holds) + moved
        by_force = hand_force_bound(budget, base, gain_of(axes, torques))
    if axes.by_damping or axes.path > 0.0:
        more, taken = max(0.0, moved), moved_at_most(settings, memory, under_way)
        needs = paths = 0.0
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


def damping_need_of(axes: AxisLimits, squares: Buffer) -> float:
    """Returns sum(T / 4 b_i times the sum of squares of an axis) [J]."""
    total = 0.0
    for i in range(len(squares)):
        total += squares[i] / (4.0 * axes.damping[i])
    return total


def size_of(values: Buffer) -> float:
    """Returns the sum of values."""
    total = 0.0
    for value in values:
        total += value
    return total


def free_if_apart(
    settings: AccountSettings, account: GroupAccount, memory: AccountMemory, under_way: UnderWay, energy: float
) -> float:
    """Returns `free_energy` for axes that may act apart."""
    axes, limits, apart, free = settings.axes, settings.apart, memory.apart, 0.0
    take_sent(axes, limits, apart, memory.displacement, memory.blur, memory.torques, under_way.torques, under_way.first)
    moved = taken_at_most(limits, apart, memory.coming, apart.nothing)[0] if settings.moves else 0.0
    if axes.by_hand:
        free = energy - needed_by_hand(axes, limits, apart, memory.coming)
    if axes.path > 0.0:
        write_needs(limits, apart, apart.nothing, squared=False)
        free = max(free, energy - moved - axes.path * size_of(apart.old))
    if axes.by_damping:
        write_needs(limits, apart, apart.nothing, squared=True)
        free = max(free, energy + account.dissipated - moved - damping_need_of(axes, apart.old))
    return free if free > 0.0 else 0.0


def shares_if_apart(
    settings: AccountSettings, account: GroupAccount, memory: AccountMemory, under_way: UnderWay, torques: Buffer,
    energy: float,
) -> tuple[float, float, float]:  # fmt: skip
    """Returns `shares` for axes that may act apart; none is above 1 by hand force."""
    axes, limits, apart = settings.axes, settings.apart, memory.apart
    take_sent(axes, limits, apart, memory.displacement, memory.blur, memory.torques, under_way.torques, under_way.first)
    by_force = by_damping = by_speed = moved = more = 0.0
    if settings.moves:
        moved, more = taken_at_most(limits, apart, memory.coming, torques)
    if axes.by_hand:
        by_force = share_by_hand(axes, limits, apart, memory.coming, torques, energy)
    if axes.by_damping:
        write_needs(limits, apart, torques, squared=True)
        budget = energy + account.dissipated - moved - more
        budget -= damping_need_of(axes, apart.old)
        by_damping = sqrt(quotient(budget, damping_need_of(axes, apart.new)))
    if axes.path > 0.0:
        write_needs(limits, apart, torques, squared=False)
        budget = energy - moved - axes.path * size_of(apart.old)
        by_speed = quotient(budget, axes.path * size_of(apart.new) + more)
    return by_force, by_damping, by_speed


def quotient(budget: float, need: float) -> float:
    """Returns budget / need; infinite where nothing is needed, 0 where there is no budget."""
    if not budget >= 0.0:
        return 0.0
    return budget / need if need > 0.0 else inf
