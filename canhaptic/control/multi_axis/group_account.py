"""The account of a group between holds: one scalar balance for all its torques."""

from dataclasses import dataclass
from math import inf, sqrt
from typing import NamedTuple

from canhaptic.control.certificates.lost_samples import Gap, doubt_of
from canhaptic.control.certificates.torque_bound import keep
from canhaptic.control.multi_axis.account_memory import AccountMemory
from canhaptic.control.multi_axis.group_certificates import AxisLimits
from canhaptic.control.multi_axis.group_commands import GroupHolds
from canhaptic.control.multi_axis.late_group import doubt_of_late_gap, doubt_of_late_group
from canhaptic.control.multi_axis.per_axis_memory import PerAxisLimits


@dataclass(slots=True)
class GroupAccount:
    """Store, surplus and the uncertain part of the energy."""

    h_s: float = 0.0  # stored energy that the network may still give [J]
    h_dis: float = 0.0  # surplus still to be dissipated [J]
    dissipated: float = 0.0  # by the devices for certain, and not forgotten [J]
    changes: float = 0.0  # uncertain energy due to encoders, up to the last change of torque [J]
    unsure: float = 0.0  # largest shortfall of the energy that came in so far [J]: encoder counts and lost samples
    kept_back: float = 0.0  # dissipated or leaked, and not paid [J]


class AccountSettings(NamedTuple):
    """Constants of a run."""

    axes: AxisLimits
    apart: PerAxisLimits
    moves: bool  # whether a mover may give or take energy


def end_group_hold(settings: AccountSettings, account: GroupAccount, memory: AccountMemory, ended: GroupHolds) -> float:
    """Take one hold, its displacements and the torques applied in it.

    Returns:
        Largest shortfall of the energy that came in against the booked one, because torques came late [J].
    """
    axes = settings.axes
    doubt = 0.0
    if not axes.timing.is_ideal:
        doubt, damped = doubt_of_late_group(axes, memory, ended.displacement, ended.applied)
        if axes.by_damping:  # a promise to every hand rests on no hand
            account.dissipated += doubt - damped
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


def end_group_gap(
    settings: AccountSettings, account: GroupAccount, memory: AccountMemory, ended: GroupHolds, missed: int
) -> tuple[float, float]:
    """Take several holds of which only the total displacement is known; return the energy's largest shortfall [J].

    And its largest excess because torques came late; other excess is left to the meter of the axis.

    In every hold but the last, whose torque was read back, each axis may have held any torque sent for it until
    then, or the one of the hold before (`lost_samples`).
    """
    axes, holds, growth = settings.axes, missed + 1, settings.axes.timing.growth
    push = 0.0
    for i in range(len(ended.applied)):
        largest = largest_of(memory, ended, missed, i)
        push += (axes.before[i] + axes.during[i]) * largest * largest
    push = sqrt(push) + axes.hand
    doubt = unsure = further = 0.0
    for i in range(len(ended.applied)):
        moved, count, last = ended.displacement[i], axes.counts[i], ended.applied[i]
        largest = largest_of(memory, ended, missed, i)
        step = sqrt(axes.before[i] + axes.during[i]) * push if axes.by_hand else 0.0
        start, blur = memory.displacement[i], memory.blur[i] + count
        excursion = abs(moved) + count + holds * ((abs(start) + blur) * growth + holds * step)
        uneven = (growth - 1.0) * excursion
        gap = Gap(holds, moved, start, count + holds * uneven, blur + uneven, step, axes.lost[i])
        doubt += doubt_of_axis(axes, memory, ended, gap, missed, i)
        if not axes.timing.is_ideal:
            late = doubt_of_late_gap(axes, memory, ended, missed, i, excursion + step)
            doubt, further = doubt + late, further + late
        memory.blur[i] = 0.5 * missed * step + axes.lost[i] * holds * excursion + uneven if axes.by_hand else 0.0
        account.changes += holds * count * largest
        certain = abs(moved) - count
        if certain > 0.0:
            account.dissipated += axes.damping[i] * certain * certain / holds
        unsure += 0.5 * count * abs(last)
    for i in range(len(ended.applied)):
        memory.displacement[i], memory.torques[i] = ended.displacement[i] / holds, ended.applied[i]
    account.unsure = account.changes + unsure
    return doubt, further


def largest_of(memory: AccountMemory, ended: GroupHolds, missed: int, axis: int) -> float:
    """Return the size of the largest torque that may have acted in the holds that ended, or before [N*m or N]."""
    most = max(abs(memory.torques[axis]), abs(ended.applied[axis]))
    most = max(most, memory.before.highest[axis], -memory.before.lowest[axis])
    for place in range(min(missed, len(ended.lost))):
        most = max(most, abs(ended.lost[place][axis]))
    return most


def doubt_of_axis(
    axes: AxisLimits, memory: AccountMemory, ended: GroupHolds, gap: Gap, missed: int, axis: int
) -> float:
    """Largest shortfall of the energy that came in by one axis over several holds [J].

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
    """Largest shortfall of the energy given by a mover in one hold whose sample was lost [J].

    Args:
        memory: Buffers of the account, before `end_group_gap`; its `passing` is the motion of the mover in the hold.
        ended: The holds.
        hold: Index of the hold, 0 for the first.
    """
    last, moved, total = ended.applied, memory.passing, 0.0
    for i in range(len(last)):
        most = (last[i] - memory.torques[i]) * moved[i]
        for place in range(min(hold + 1, len(ended.lost))):
            most = max(most, (last[i] - ended.lost[place][i]) * moved[i])
        total += most
    return total


def certain_energy(account: GroupAccount, credit: float) -> float:
    """Return the energy [J] that the next torques may take out.

    What was dissipated or leaked is not available again, but it covers the uncertainty of the encoders.
    """
    energy = account.h_s - account.h_dis + credit
    lacking = account.unsure - account.kept_back
    return energy - lacking if lacking > 0.0 else energy


def fade(account: GroupAccount, share: float) -> None:
    """Keep, out of contact, a share of the devices' dissipation together with the account; a lack is kept in full."""
    if account.dissipated > 0.0:
        energy = account.h_s - account.h_dis
        keep(account, energy, share * max(0.0, energy + account.dissipated))


def quotient(budget: float, need: float) -> float:
    """Return budget / need; infinite where nothing is needed, 0 where there is no budget."""
    if not budget >= 0.0:
        return 0.0
    return budget / need if need > 0.0 else inf
