"""Energy given out by late torques in a group; `group_certificates` bounds that of the torques held.

Let W be the torques of the next free hold, l W those sent, and g_i in [lowest_i, highest_i] the older torques that
axis i still has at its SYNC. With p_i as in (1) of `hold_timing`, different for every axis, the motors give out in
that hold

    l W . D + sum of integral(p_i (g_i - l W_i) v_i) <= l W . D + sum of max(0, highest_i - l W_i) X_i+
                                                                    + max(0, l W_i - lowest_i) X_i-            (1)

with X_i+ and X_i- the most that p_i |v_i| can integrate to along + and -. An axis gains in a time t no more speed than
t m_i^(-1/2) (N + h), N the largest |f|_P of torques that act and h that of the hand (`per_axis_certificates`), so that
with D_i its displacement along the sign in the hold before, s = theta_i / T and step_i = T^2 m_i^(-1/2) (N + h)

    X_i <= s max(0, D_i) + s (1/2 + s) step_i,      D_i in the j-th hold from now <= r D_i0 + j step_i.             (2)

**A hand without limit inwards**, where M does not couple the axes and all torques of an axis have one sign: what the
motor gives out grows with v_i, which is no larger than with F_h along the torque throughout; (2) holds for that motion.

**The hold after it.** Of l W and older torques no more is left than (highest', lowest') of the next SYNC, and they
give out highest' X' and -lowest' X' at most, as if no torque followed. That counts with W. A smaller torque, and none
at all, then has what the larger one leaves running.

**The share l.** What older torques exceed l W by is convex in l and lies below its chord between l = 0 and l = 1, and
N <= N_0 + l N_1 as in `per_axis_certificates`, so that all together stay below a parabola a + b l + c l^2, c >= 0, for
every l up to 1; l is the largest for which it stays in the budget. Where even a is not in it, what runs on was
certified before, and l W adds to that its own energy, l W . D - l sum of integral(p_i W_i v_i) with its tail, and what
older torques give out over the motion that it adds. As long as that is below zero for certain, it is sent: without it
no debt would end (`given_in_debt`). The chord of a smaller W is nearer, so that one of the size of the older torques
is asked as well.

**The hold that ended.** Of that D_i is known, and the way back inside it is no longer than `swing` times
s (D_i + step_i / 2) (`hold_timing`): `doubt_of_late_group`. By device damping and hand speed it is as of one axis.
"""

from math import sqrt
from typing import NamedTuple

from canhaptic.control.multi_axis.account_memory import AccountMemory
from canhaptic.control.multi_axis.group_certificates import AxisLimits, pass_range, response_to_late
from canhaptic.control.multi_axis.group_commands import GroupHolds
from canhaptic.kernels import Buffer, Matrix, new


class LateShare(NamedTuple):
    """A parabola a + b l + c l^2 above the energy that older torques give out [J]."""

    constant: float
    linear: float
    square: float


class Norms(NamedTuple):
    """Norm of the torques that act and of the hand: N + h <= least + more l."""

    least: float
    more: float


def copy_range(axes: AxisLimits, memory: AccountMemory, ended: bool) -> None:
    """Copy the range of torques from the SYNC at the beginning of the hold that ended, or from the SYNC at its end."""
    now, before = memory.now, memory.before
    for i in range(len(memory.torques)):
        now.highest[i], now.lowest[i] = before.highest[i], before.lowest[i]
    if ended:
        pass_range(axes, now.highest, now.lowest, memory.torques)


def norms_of(
    axes: AxisLimits, memory: AccountMemory, under_way: Matrix, first: int, holds: int, torques: Buffer, size: float
) -> Norms:
    """Return the norms of torques under way, and the part of W that l = 1 replaces."""
    total = added = 0.0
    for i in range(len(torques)):
        most = max(abs(memory.torques[i]), memory.before.highest[i], -memory.before.lowest[i])
        for place in range(first, first + holds):
            most = max(most, abs(under_way[place][i]))
        root, torque = axes.timing.roots[i], size * torques[i]
        total += root * root * most * most
        added += root * root * max(0.0, torque * torque - most * most)
    return new(Norms, (sqrt(total) + axes.timing.hand, sqrt(added)))


def reach_of(axes: AxisLimits, memory: AccountMemory, i: int, sign: float, hold: int, norm: float) -> float:
    """Return X of an axis in a hold from now, the next being 1 [rad or m]; see (2)."""
    timing = axes.timing
    share, step, before = timing.share[i], timing.roots[i] * norm, hold - 1
    start = sign * memory.displacement[i] + axes.counts[i] + memory.blur[i]
    if start < 0.0:
        start /= timing.growth
        for _ in range(before):
            start -= axes.lost[i] * start
    moved = start + before * step
    reach = share * (0.5 + share) * step
    return reach + share * moved if moved > 0.0 else reach


def given_early(
    axes: AxisLimits, memory: AccountMemory, held: Buffer, fixed: float, size: float, hold: int, norms: Norms
) -> LateShare:
    """Energy that older torques give out in a hold, beyond that of the torques held in it; see (1).

    Args:
        axes: Properties of the motor axes.
        memory: Its `now` is the range at the SYNC at which the hold begins.
        held: Torques of the hold, (axes,) [N*m or N], of which fixed + l size are held.
        fixed: 1 where they are sent for every l, else 0.
        size: 0 then, else the share that l = 1 replaces.
        hold: Index of the hold from now, the next being 1.
        norms: Norms of the acting torques and of the hand.
    """
    constant = linear = square = 0.0
    for i in range(len(held)):
        least, most = fixed * held[i], (fixed + size) * held[i]
        share = axes.timing.share[i]
        further = share * share * axes.timing.roots[i] * norms.more
        for side in range(2):
            sign = 1.0 if side == 0 else -1.0
            older = memory.now.highest[i] if side == 0 else -memory.now.lowest[i]
            apart, change = max(0.0, older - sign * least), max(0.0, older - sign * most)
            change -= apart
            if apart != 0.0 or change != 0.0:
                reach = reach_of(axes, memory, i, sign, hold, norms.least)
                constant += apart * reach
                linear += change * reach + apart * further
                square += change * further
    return new(LateShare, (constant, linear, square))


def given_after(
    axes: AxisLimits, memory: AccountMemory, held: Buffer, size: float, hold: int, norms: Norms
) -> LateShare:
    """Energy that all torques give out in the hold after one, if none follows; arguments as for `given_early`."""
    constant = linear = square = 0.0
    for i in range(len(held)):
        share, left = axes.timing.share[i], axes.timing.left[i]
        further = share * (1.0 + share) * axes.timing.roots[i] * norms.more
        for side in range(2):
            sign = 1.0 if side == 0 else -1.0
            older = memory.now.highest[i] if side == 0 else -memory.now.lowest[i]
            torque, least = sign * size * held[i], max(0.0, left * older)
            change = max(0.0, torque + left * max(0.0, older - torque)) - least
            if least != 0.0 or change != 0.0:
                reach = reach_of(axes, memory, i, sign, hold + 1, norms.least)
                constant += least * reach
                linear += change * reach + least * further
                square += change * further
    return new(LateShare, (constant, linear, square))


def share_of_late(
    axes: AxisLimits, memory: AccountMemory, under_way: Matrix, first: int, holds: int, torques: Buffer, size: float
) -> LateShare:
    """Energy that older torques give out from now on, by the share of W that is sent.

    Args:
        axes: Properties of the motor axes.
        memory: Buffers of the account; `now` is changed.
        under_way: Torques that act before W, a ring (delay + 1, axes) [N*m or N].
        first: Place of the ones that act next; below 0 it wraps.
        holds: Number of holds.
        torques: W, (axes,).
        size: Part of W that l = 1 replaces.
    """
    norms = norms_of(axes, memory, under_way, first, holds, torques, size)
    copy_range(axes, memory, True)
    constant, hold = 0.0, holds + 1
    for place in range(holds):
        held = under_way[first + place]
        constant += given_early(axes, memory, held, 1.0, 0.0, place + 1, norms).constant
        pass_range(axes, memory.now.highest, memory.now.lowest, held)
    highest, lowest = memory.now.highest, memory.now.lowest
    early = given_early(axes, memory, torques, 0.0, size, hold, norms)
    after = given_after(axes, memory, torques, size, hold, norms)
    none = size * response_to_late(axes, torques, highest, lowest, memory.nothing, axes.during)
    for i in range(len(torques)):
        memory.sized[i] = size * torques[i]
    whole = size * response_to_late(axes, torques, highest, lowest, memory.sized, axes.during)
    constant += early.constant + after.constant
    return new(LateShare, (
        constant, none + early.linear + after.linear, whole - none + early.square + after.square
    ))  # fmt: skip


def given_in_debt(
    axes: AxisLimits, memory: AccountMemory, under_way: Matrix, first: int, holds: int, torques: Buffer
) -> LateShare:
    """Increase by l W of the energy that all torques give out, beyond l W . D of `base_of` and its gain."""
    norms, full, cross = norms_of(axes, memory, under_way, first, holds, torques, 1.0), 0.0, 0.0
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
    early = given_early(axes, memory, torques, 0.0, 1.0, holds + 1, norms)
    after = given_after(axes, memory, torques, 1.0, holds + 1, norms)
    linear = none + cross + early.linear + after.linear
    return new(LateShare, (0.0, linear, whole - none + early.square + after.square))


def older_size(axes: AxisLimits, memory: AccountMemory, torques: Buffer) -> float:
    """Return the size of the older torques at the SYNC of W over that of W, in the norm |f|_P."""
    older = size = 0.0
    for i in range(len(torques)):
        most = max(memory.now.highest[i], -memory.now.lowest[i])
        older += axes.during[i] * most * most
        size += axes.during[i] * torques[i] * torques[i]
    return sqrt(older / size) if size > 0.0 else 0.0


def doubt_of_late_group(axes: AxisLimits, memory: AccountMemory, moved: Buffer, held: Buffer) -> tuple[float, float]:
    """Largest shortfall of the energy that came in in a hold whose torques came late [J].

    Args:
        axes: Properties of the motor axes.
        memory: Buffers of the account before the hold; `before` becomes the range at its beginning.
        moved: Displacement in it, (axes,) [rad or m].
        held: Torques held in it [N*m or N].

    Returns:
        The shortfall by the declared hand, and by the damping of the devices.
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
            start = abs(memory.displacement[i]) + memory.blur[i] + count
            further = timing.swing[i] * (0.5 + share) * timing.roots[i] * push
            total += apart * share * (max(start, timing.swing[i] * path) + further)
        elif axes.path > 0.0:
            total += apart * share * axes.path
        if axes.by_damping:
            damped += apart * share * (path + apart / (4.0 * axes.damping[i]))
    pass_range(axes, highest, lowest, memory.torques)
    return (total if axes.by_hand or axes.path > 0.0 else damped), damped


def doubt_of_late_gap(
    axes: AxisLimits, memory: AccountMemory, ended: GroupHolds, missed: int, axis: int, excursion: float
) -> float:
    """Largest excess of an axis's energy over several holds, beyond `lost_samples`, as torques came late [J].

    Any two torques that may have acted differ by `apart` at most, in each hold for as long as in one. The range of
    torques at the SYNC at which the last hold began is taken.

    Args:
        axes: Properties of the motor axes.
        memory: Buffers of the account before the holds.
        ended: The holds.
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
    """Need of the torques at the last SYNC by the damping of the devices, and by the hand's speed [J]."""
    damped = paths = 0.0
    if axes.timing.is_ideal:
        return damped, paths
    copy_range(axes, memory, ended=True)
    for i in range(len(memory.torques)):
        older = max(memory.now.highest[i], -memory.now.lowest[i])
        paths += older * axes.timing.tail_path
        if axes.by_damping:
            damped += older * older * axes.timing.tail[i] / axes.squares[i]
    return damped, paths
