"""Energy given out by late torques under per-axis certificates; see `per_axis_certificates`."""

from canhaptic.control.multi_axis.group_certificates import AxisLimits
from canhaptic.control.multi_axis.per_axis_memory import PerAxisLimits, PerAxisMemory
from canhaptic.kernels import Buffer


def write_parabolas(memory: PerAxisMemory, place: int, old: float, new: float, base: float, slope: float) -> int:
    """Write the energy of an axis that moves by base + slope l, with an old torque, and with l times a new one."""
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
    """Write the energy of older torques beyond those of each hold, and of all torques in the hold after the last.

    Args:
        axes: Properties of the motor axes.
        limits: Per-axis limits of the group.
        memory: Buffers of the certificates, after `take_sent`.
        torques: W, (axes,).
        fixed: Torques sent for every l, (axes,).
        norm: N_0 + h.
        more: N_1.
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
    """Write the energy of torques at the beginning of a hold as parabolas; return the index of the next.

    X = integral(p v) over v > 0 is convex in the displacement D before: s D + s (1/2 + s) a T^2 for D >= 0 and none
    where the axis still goes inward at the end of the hold, D <= -3/2 a T^2.
    """
    share, root, start = axes.timing.share[axis], axes.timing.roots[axis], memory.starts[axis][side]
    pace, rise = memory.lost[axis][side] + root * norm, root * more
    moved, grown = start + index * pace, rise * max(0, index - limits.delay)
    slope = share * (0.5 + share)
    pull, gain = slope * (moved / 1.5 + pace), slope * (grown / 1.5 + rise)
    place = write_parabolas(memory, place, older, new, pull, gain)
    return write_parabolas(memory, place, older, new, share * moved + slope * pace, share * grown + slope * rise)
