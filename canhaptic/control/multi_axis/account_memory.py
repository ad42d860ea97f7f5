"""Buffers of the account of a group, by axis."""

from typing import NamedTuple

from canhaptic.control.multi_axis.group_certificates import Acting
from canhaptic.control.multi_axis.per_axis_memory import PerAxisLimits, PerAxisMemory, per_axis_memory
from canhaptic.kernels import Buffer, Matrix, list_of_zeros, zeros


class AccountMemory(NamedTuple):
    """Buffers of the account, shapes (axes,) where no other is given."""

    displacement: Buffer  # of the hold that ended [rad or m]
    torques: Buffer  # held in it [N*m or N]
    blur: Buffer  # uncertainty of its displacement beyond a count [rad or m]
    before: Acting  # at the SYNC at which it began, where torques come late
    now: Acting  # buffer for the range at a later SYNC
    coming: Matrix  # motion of a mover in future holds as one of the motors, (holds, axes) [rad or m]
    passing: Buffer  # buffer for the motion in one hold
    nothing: Buffer  # zeros
    sized: Buffer  # buffer for a part of torques
    apart: PerAxisMemory


def account_memory(limits: PerAxisLimits) -> AccountMemory:
    """Return empty buffers."""
    axes, one = len(limits.roots), list_of_zeros
    return AccountMemory(
        one(axes), one(axes), one(axes), Acting(one(axes), one(axes)), Acting(one(axes), one(axes)),
        zeros(limits.holds, axes), one(axes), one(axes), one(axes), per_axis_memory(limits),
    )  # fmt: skip
