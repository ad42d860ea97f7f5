"""Buffers of the per-axis certificates; see `per_axis_certificates`."""

from math import sqrt
from typing import NamedTuple

from canhaptic.control.multi_axis.group_certificates import Acting, AxisLimits
from canhaptic.kernels import Buffer, Indices, Matrix, list_of_zeros, zeros


class PerAxisLimits(NamedTuple):
    """Constants of a run."""

    delay: int  # whole holds between computation and action
    losses: int  # consecutive cycles in which an axis may be without a new torque
    holds: int  # in which the next torque may act, counted from now
    first: float  # share of a whole response that a torque has in its first hold
    is_ideal: bool  # whether every hold is exact, and no torque late
    is_apart: bool  # whether axes are certified one by one
    is_late: bool  # whether any torque comes late
    responses: Buffer  # T^2 / m of each axis
    roots: Buffer  # of these


class PerAxisMemory(NamedTuple):
    """Torques that may still act, and the energy of each axis with them; [J] but for torques and starts."""

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
    """Constants of a run."""
    whole = [b + d for b, d in zip(axes.before, axes.during, strict=True)]
    first = max([d / r if r else 0.0 for d, r in zip(axes.during, whole, strict=True)])
    is_late = any(axes.timing.share)
    is_apart = losses > 0 or (len(whole) > 1 and not is_late)
    return PerAxisLimits(
        delay, losses, delay + 1 + losses, first, axes.timing.is_ideal, is_apart, is_late, whole,
        [sqrt(r) for r in whole],
    )  # fmt: skip


def per_axis_memory(limits: PerAxisLimits) -> PerAxisMemory:
    """Return empty buffers."""
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
