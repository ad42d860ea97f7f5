"""Common part of the kernels of groups, for any algorithm."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from math import inf
from typing import Any, Final, NamedTuple

from canhaptic.control.balance import EnergyBalance
from canhaptic.control.multi_axis.group_commands import (
    GroupCommands,
    GroupHolds,
    no_group_commands,
    no_group_holds,
)
from canhaptic.control.multi_axis.group_motion import (
    GroupMotion,
    MotionMemory,
    MotionSettings,
    World,
    motion_memory,
    motion_settings,
)
from canhaptic.control.passivity.controller import LoopProperties
from canhaptic.control.recovery import damping_cap
from canhaptic.kernels import Buffer, Matrix

_NO_CAP: Final = 1e12
"""Cap of the damping when the moving mass is unknown [N*s/m, N*m*s/rad]: finite, so that at rest it gives no force."""


class GroupLoop(NamedTuple):
    """Constants of a run, the same for every algorithm."""

    delay: int  # whole holds between computation and action
    caps: Buffer  # of the damping, (axes,) [N*s/m or N*m*s/rad]
    least_cap: float
    most_cap: float
    largest: Buffer  # torques that limiters and drives let act, (axes,) [N*m or N]
    rises: Buffer  # largest rise of a torque from SYNC to SYNC, (axes,) [N*m or N]
    powers: Buffer  # that it may put into the user's side, (axes,) [W]
    motion: MotionSettings


@dataclass(slots=True)
class Group:
    """State kept from SYNC to SYNC by every algorithm."""

    started: bool = False
    oldest: int = 0  # place of the command whose hold ends next
    motion: GroupMotion = field(default_factory=GroupMotion)


class GroupMemory(NamedTuple):
    """Buffers of every algorithm."""

    commands: GroupCommands
    ended: GroupHolds
    motion: MotionMemory


class GroupHold(NamedTuple):
    """Account of the hold that ended, for a group; see `GroupBalance`."""

    account: EnergyBalance
    supplied: float
    unsure: float
    further: float  # largest excess of the energy beyond the subtracted uncertainty [J]
    limit: int
    place: int  # of the torques that it sent, in the rings of the commands


class GroupKernel(NamedTuple):
    """A passivity algorithm of a group as functions; see `canhaptic.kernels.Kernel`."""

    settings: Callable[..., Any]  # (world, parameters, loops) -> constants of a run; has `loop`
    state: Callable[[], Any]  # () -> state at rest
    memory: Callable[..., Any]  # (world, settings) -> buffers; has `group`
    step: Callable[..., GroupHold]  # (world, settings, state, memory, samples lost before, positions, torques applied)


def group_loop(world: World, loops: tuple[LoopProperties, ...]) -> GroupLoop:
    """Constants of a run."""
    sample_time, delay = loops[0].sample_time, loops[0].delay
    caps = [min(_NO_CAP, damping_cap(delay, loop.moving_mass, sample_time)) for loop in loops]
    largest = [loop.torque_limit or inf for loop in loops]
    rises = [(loop.torque_rate_limit or inf) * sample_time for loop in loops]
    powers = [loop.power_limit or inf for loop in loops]
    return GroupLoop(delay, caps, min(caps), max(caps), largest, rises, powers, motion_settings(world, loops))


def group_memory(world: World, loop: GroupLoop, ports: int) -> GroupMemory:
    """Return the buffers of a group at rest; `ports` of the commands are kept."""
    axes = len(loop.caps)
    return GroupMemory(
        no_group_commands(axes, ports, loop.delay), no_group_holds(axes, loop.delay), motion_memory(world, loop.motion)
    )


class GroupRun(NamedTuple):
    """A kernel from its first SYNC on."""

    step: Callable[[int, Sequence[float], Sequence[float]], GroupHold]
    torques: Matrix  # rows of the commands
    interactions: Buffer
    withhold: Callable[[int], object]  # takes a command back, by its place
