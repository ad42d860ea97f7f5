"""What the certificates of axes that may act apart work on; see `per_axis_certificates`."""

from math import sqrt
from typing import NamedTuple

from canhaptic.control.multi_axis.group_certificates import Acting, AxisLimits
from canhaptic.kernels import Buffer, Indices, Matrix, list_of_zeros, zeros


class PerAxisLimits(NamedTuple):
    """What is fixed for a run."""

    delay: int  # whole holds between computation and action
    losses: int  # consecutive cycles in which an axis may be without a new torque
    holds: int  # in which the next torque may act, counted from now
    first: float  # share of a whole response that a torque has in its first hold
    is_ideal: bool  # whether every hold is exact, and no torque late
    responses: Buffer  # T^2 / m of each axis
    roots: Buffer  # of these


class PerAxisMemory(NamedTuple):
    """The torques that may still act and what each axis may give out with them; [J] but for torques and starts."""

    sent: Matrix  # torques held in the hold that ended, and those under way, (delay + 1, axes) [N*m or N]
    largest: Buffer  # size of any of them on each axis, (axes,)
    starts: Matrix  # displacement of the hold that ended along + and -, encoder and blur included, (axes, 2) [m or rad]
    lost: Matrix  # what friction takes of it in a hold, (axes, 2)
    along: Matrix  # largest torque along + that may act in each hold, (holds, axes) [N*m or N]
    against: Matrix  # the same along -
    ends: Indices  # of each cell in the parabolas; a cell is one axis in one hold, (holds * axes,)
    constant: Buffer  # A of the parabolas A + B l + C l^2, (4 * holds * axes,)
    linear: Buffer  # B
    square: Buffer  # C
    old: Buffer  # sums over the holds by the torques under way, (axes,)
    new: Buffer  # and what new ones add
    nothing: Buffer  # zeros, (axes,)
    alone: Buffer  # a torque of one axis, (axes,)
    others: Buffer  # of all others
    older: Acting  # range of all torques at the last SYNC, (axes,) [N*m or N]


def per_axis_limits(axes: AxisLimits, delay: int, losses: int) -> PerAxisLimits:
    """Returns what is fixed for a run."""
    whole = [b + d for b, d in zip(axes.before, axes.during, strict=True)]
    first = max([d / r if r else 0.0 for d, r in zip(axes.during, whole, strict=True)])
    return PerAxisLimits(
        delay, losses, delay + 1 + losses, first, axes.timing.is_ideal, whole, [sqrt(r) for r in whole]
    )


def per_axis_memory(limits: PerAxisLimits) -> PerAxisMemory:
    """Returns empty buffers."""
    axes, one = len(limits.roots), list_of_zeros
    cells = limits.holds * axes if limits.losses else 0
    ends, pieces = (
        (cells, 4 * cells) if limits.is_ideal or not cells else (2 * cells + axes, 8 * cells + 8 * (cells + axes))
    )
    return PerAxisMemory(
        zeros(limits.delay + 1, axes), one(axes), zeros(axes, 2), zeros(axes, 2), zeros(limits.holds, axes),
        zeros(limits.holds, axes), [0] * ends, one(pieces), one(pieces), one(pieces), one(axes), one(axes), one(axes),
        one(axes), one(axes), Acting(one(axes), one(axes)),
    )  # fmt: skip
