"""The certificates of a group: the energy reserved for torques under way, and the certified share of the next ones."""

from math import sqrt
from typing import NamedTuple

from canhaptic.control.certificates.scalar_bounds import hand_force_bound
from canhaptic.control.multi_axis.account_memory import AccountMemory
from canhaptic.control.multi_axis.group_account import AccountSettings, GroupAccount, quotient
from canhaptic.control.multi_axis.group_certificates import (
    AxisLimits,
    along_last,
    base_of,
    damping_need,
    gain_of,
    path_need,
    response_to_late,
    taken_by_mover,
)
from canhaptic.control.multi_axis.late_group import (
    LateShare,
    copy_range,
    given_in_debt,
    older_needs,
    older_size,
    share_of_late,
)
from canhaptic.control.multi_axis.per_axis_certificates import (
    needed_by_hand,
    share_by_hand,
    take_sent,
    taken_at_most,
    write_needs,
)
from canhaptic.kernels import Buffer, Matrix


class UnderWay(NamedTuple):
    """Torques that act before the next command."""

    torques: Matrix  # a ring, (delay + 1, axes) [N*m or N]
    first: int  # place of the one that acts next; below 0 it wraps
    holds: int


def worst_case(
    settings: AccountSettings, memory: AccountMemory, torques: Buffer, under_way: UnderWay, count: int
) -> float:
    """Return the base of torques that act after some of those under way [J]; see `base_of`."""
    axes, sent, first = settings.axes, under_way.torques, under_way.first
    along = along_last(axes, torques, memory.displacement, memory.blur)
    if not axes.timing.is_ideal:
        copy_range(axes, memory, False)
    return base_of(axes, torques, memory.displacement, along, memory.torques, sent, first, count, memory.now)


def extraction_of(settings: AccountSettings, memory: AccountMemory, under_way: UnderWay, hold: int) -> float:
    """Return the most energy [J] that the torques of one of the holds under way may take out in it."""
    axes, torques = settings.axes, under_way.torques[under_way.first + hold]
    taken = worst_case(settings, memory, torques, under_way, hold) + gain_of(axes, torques)
    if not axes.timing.is_ideal:
        taken += response_to_late(axes, torques, memory.now.highest, memory.now.lowest, torques, axes.during)
    return taken + taken_by_mover(torques, memory.coming[hold]) if settings.moves else taken


def moved_at_most(settings: AccountSettings, memory: AccountMemory, under_way: UnderWay) -> float:
    """Energy that a mover takes [J] in the holds of torques under way, where that is positive."""
    total = 0.0
    if settings.moves:
        for hold in range(under_way.holds):
            total += max(0.0, taken_by_mover(under_way.torques[under_way.first + hold], memory.coming[hold]))
    return total


def needed_under_way(settings: AccountSettings, memory: AccountMemory, under_way: UnderWay) -> float:
    """Return the most energy [J] that the torques under way may give out to a hand within its force."""
    worst = given = 0.0
    for hold in range(under_way.holds):
        given += extraction_of(settings, memory, under_way, hold)
        worst = max(worst, given)
    return (
        worst
        if settings.axes.timing.is_ideal
        else worst + late_of(settings, memory, under_way, memory.nothing, 1.0).constant
    )


def late_of(
    settings: AccountSettings, memory: AccountMemory, under_way: UnderWay, torques: Buffer, size: float
) -> LateShare:
    """Energy that older torques give out besides those held, by the share of a part of new ones."""
    return share_of_late(settings.axes, memory, under_way.torques, under_way.first, under_way.holds, torques, size)


def free_energy(
    settings: AccountSettings, account: GroupAccount, memory: AccountMemory, under_way: UnderWay, energy: float
) -> float:
    """Part of `energy` [J] that the certificates of the torques under way do not need."""
    axes = settings.axes
    if settings.apart.is_apart:
        return free_if_apart(settings, account, memory, under_way, energy)
    free, moved = 0.0, moved_at_most(settings, memory, under_way)
    if axes.by_hand:
        free = max(free, energy - needed_under_way(settings, memory, under_way))
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


def shares(
    settings: AccountSettings, account: GroupAccount, memory: AccountMemory, under_way: UnderWay, torques: Buffer,
    energy: float,
) -> tuple[float, float, float]:  # fmt: skip
    """Share of the torques that each certificate admits: hand force, device damping, hand speed; may be > 1.

    Args:
        settings: Constants of the account.
        account: Account of the group.
        memory: Buffers of the account.
        under_way: Torques that act before these.
        torques: W, for the next free hold [N*m or N].
        energy: Energy budget [J].
    """
    axes = settings.axes
    if settings.apart.is_apart:
        return shares_if_apart(settings, account, memory, under_way, torques, energy)
    by_force = by_damping = by_speed = moved = 0.0
    if settings.moves:
        moved = taken_by_mover(torques, memory.coming[under_way.holds])
    if axes.by_hand:
        by_force = by_hand_force(settings, memory, under_way, torques, energy, moved)
    if axes.by_damping or axes.path > 0.0:
        more, taken = max(0.0, moved), moved_at_most(settings, memory, under_way)
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


def by_hand_force(
    settings: AccountSettings, memory: AccountMemory, under_way: UnderWay, torques: Buffer, energy: float, moved: float
) -> float:
    """Return the share by hand force; up to 1 where torques come late, see `late_group`.

    `moved` is what a mover takes of the torques [J]; the other arguments are those of `shares`.
    """
    axes = settings.axes
    for hold in range(under_way.holds):
        extraction = extraction_of(settings, memory, under_way, hold)
        acting, along = under_way.torques[under_way.first + hold], 0.0
        for i in range(len(torques)):
            along += acting[i] * torques[i]
        energy -= extraction if along >= 0.0 else max(0.0, extraction)
    base, gain = worst_case(settings, memory, torques, under_way, under_way.holds) + moved, gain_of(axes, torques)
    if axes.timing.is_ideal:
        return hand_force_bound(energy, base, gain)
    late = late_of(settings, memory, under_way, torques, 1.0)
    if not energy >= late.constant:
        return share_in_debt(axes, memory, under_way, torques, base, gain)
    share = share_beyond(energy, base, gain, late, 1.0)
    size = min(1.0, older_size(axes, memory, torques))
    if share < 1.0 and size > 0.0:
        late = late_of(settings, memory, under_way, torques, size)
        if energy >= late.constant:
            share = max(share, share_beyond(energy, base, gain, late, size))
    return share


def share_beyond(energy: float, base: float, gain: float, late: LateShare, size: float) -> float:
    """Return the share, up to `size`, of torques beyond what the older ones give out.

    `late` is that of `size`, its constant no more than the energy; `base` and `gain` are those of all of the torques.
    """
    start, more = size * base + late.linear, max(0.0, size * size * gain + late.square)
    return size * min(1.0, hand_force_bound(energy - late.constant, start, more))


def share_in_debt(
    axes: AxisLimits, memory: AccountMemory, under_way: UnderWay, torques: Buffer, base: float, gain: float
) -> float:
    """Return the share of torques that takes energy in for certain, where older ones may give out more than there is.

    `memory.now` is the range at the SYNC of the torques; the other arguments are those of `by_hand_force`.
    """
    own = given_in_debt(axes, memory, under_way.torques, under_way.first, under_way.holds, torques)
    return min(1.0, hand_force_bound(0.0, base + own.linear, max(0.0, gain + own.square)))


def damping_need_of(axes: AxisLimits, squares: Buffer) -> float:
    """Return sum((T + theta_i) / 4 b_i times the sum of squares of an axis) [J]."""
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


def take_all_sent(settings: AccountSettings, memory: AccountMemory, under_way: UnderWay) -> None:
    """Take the hold that ended and the torques that may still act, for per-axis certificates."""
    copy_range(settings.axes, memory, True)
    take_sent(
        settings.axes, settings.apart, memory.apart, memory.displacement, memory.blur, memory.torques,
        under_way.torques, under_way.first, memory.now,
    )  # fmt: skip


def free_if_apart(
    settings: AccountSettings, account: GroupAccount, memory: AccountMemory, under_way: UnderWay, energy: float
) -> float:
    """`free_energy` for per-axis certificates."""
    axes, limits, apart, free = settings.axes, settings.apart, memory.apart, 0.0
    take_all_sent(settings, memory, under_way)
    older_damped, older_paths = older_needs(axes, memory)
    moved = taken_at_most(limits, apart, memory.coming, apart.nothing)[0] if settings.moves else 0.0
    if axes.by_hand:
        free = max(free, energy - needed_by_hand(axes, limits, apart, memory.coming))
    if axes.path > 0.0:
        write_needs(limits, apart, apart.nothing, squared=False)
        free = max(free, energy - moved - axes.path * size_of(apart.old) - older_paths)
    if axes.by_damping:
        write_needs(limits, apart, apart.nothing, squared=True)
        free = max(free, energy + account.dissipated - moved - damping_need_of(axes, apart.old) - older_damped)
    return free


def shares_if_apart(
    settings: AccountSettings, account: GroupAccount, memory: AccountMemory, under_way: UnderWay, torques: Buffer,
    energy: float,
) -> tuple[float, float, float]:  # fmt: skip
    """`shares` for per-axis certificates; none is above 1 by hand force."""
    axes, limits, apart = settings.axes, settings.apart, memory.apart
    take_all_sent(settings, memory, under_way)
    older_damped, older_paths = older_needs(axes, memory)
    by_force = by_damping = by_speed = moved = more = 0.0
    if settings.moves:
        moved, more = taken_at_most(limits, apart, memory.coming, torques)
    if axes.by_hand:
        by_force = share_by_hand(axes, limits, apart, memory.coming, torques, energy)
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
