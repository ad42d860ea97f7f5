"""Common part of the kernels of groups, for any algorithm.

The torques of a group, with their components, from computation to the end of the hold in which they acted.

An algorithm of a group in the cycle: keeps the state of the kernel, and refuses values that are not finite.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from math import inf, isfinite, sqrt
from typing import Any, ClassVar, Final, NamedTuple

from canhaptic.control.balance import AT_REST, Branch, EnergyBalance
from canhaptic.control.damping import damping_cap
from canhaptic.control.mechanisms.kinematics import Kinematics
from canhaptic.control.multi_axis.group_controller import GroupBalance, NetworkEnvironment, group_at_rest
from canhaptic.control.multi_axis.group_motion import (
    GroupModel,
    GroupMotion,
    MotionMemory,
    MotionSettings,
    motion_memory,
    motion_settings,
    world_of,
)
from canhaptic.control.passivity.controller import LoopProperties
from canhaptic.errors import ControlError
from canhaptic.kernels import Buffer, Matrix, list_of_zeros, with_quick_fields, zeros
from canhaptic.units import Parameters


class GroupCommands(NamedTuple):
    """Commands of the holds that have not ended, rings of delay + 1 rows; see `in_flight.Commands`.

    torque = -(spring + damper + modulated), per motor axis [N*m or N].
    """

    torques: Matrix
    dampers: Matrix  # efforts of the network's dissipators
    modulated: Matrix  # of eq. 19
    ports: Matrix  # effort at each port of the network
    power: Buffer  # of the dampers at the velocities they came from, times the sample time (eq. 18) [J]


class GroupHolds(NamedTuple):
    """The hold that ended, or several where samples were lost."""

    displacement: Buffer  # in all of them, (axes,) [rad or m]
    position: Buffer  # at their end, (axes,) [rad or m]
    applied: Buffer  # torques held in the last one, (axes,) [N*m or N]
    lost: Matrix  # torques of the first delay + 1 commands whose samples were lost; those after it are the last again
    interactions: Buffer  # energy that came in by each axis [J]


def no_group_commands(axes: int, ports: int, delay: int) -> GroupCommands:
    """Return the commands of a group at rest."""
    rows = delay + 1
    return GroupCommands(
        zeros(rows, axes), zeros(rows, axes), zeros(rows, axes), zeros(rows, ports), list_of_zeros(rows)
    )


def no_group_holds(axes: int, delay: int) -> GroupHolds:
    """Return the buffers of the holds that ended."""
    one = list_of_zeros
    return GroupHolds(one(axes), one(axes), one(axes), zeros(delay + 1, axes), one(axes))


def end_holds(
    commands: GroupCommands, ended: GroupHolds, largest: Buffer, oldest: int, missed: int, positions: Buffer,
    applied: Buffer,
) -> int:  # fmt: skip
    """Take the holds that ended; return the index of the command that acted in the last of them.

    The efforts at that place are afterwards those inside the torques applied: a torque that was cut had as much less
    of each of them.

    Args:
        commands: Commands of the group.
        ended: Receives displacement, torques and energy of each axis.
        largest: Torque of each axis that limiter and drive let act [N*m or N].
        oldest: Index of the command whose hold ended first.
        missed: Number of lost samples.
        positions: Positions at the end [rad or m].
        applied: Torques in the last hold [N*m or N].
    """
    for lost in range(missed):
        newest = oldest - 1
        for i in range(len(applied)):
            if lost < len(ended.lost):
                ended.lost[lost][i] = min(max(commands.torques[oldest][i], -largest[i]), largest[i])
            commands.torques[oldest][i] = commands.torques[newest][i]
            commands.dampers[oldest][i] = commands.dampers[newest][i]
            commands.modulated[oldest][i] = commands.modulated[newest][i]
        for j in range(len(commands.ports[oldest])):
            commands.ports[oldest][j] = commands.ports[newest][j]
        commands.power[oldest] = commands.power[newest]
        oldest = next_place(commands, oldest)
    torques, as_sent = commands.torques[oldest], True
    for i in range(len(applied)):
        torque = applied[i]
        displacement = positions[i] - ended.position[i]
        ended.displacement[i], ended.position[i], ended.applied[i] = displacement, positions[i], torque
        ended.interactions[i] = -torque * displacement
        if torque != torques[i]:
            as_sent = False
    if not as_sent:
        take_applied(commands, oldest, applied)
    return oldest


def next_place(commands: GroupCommands, place: int) -> int:
    """Return the next index in the rings."""
    return place + 1 if place + 1 < len(commands.power) else 0


def take_applied(commands: GroupCommands, place: int, applied: Buffer) -> None:
    """Scale the efforts of a command, axis by axis, to torques that were not applied as sent."""
    torques, sent, along = commands.torques[place], 0.0, 0.0
    for i in range(len(applied)):
        torque = torques[i]
        sent += torque * torque
        along += applied[i] * torque
        share = share_of(applied[i], torque)
        commands.dampers[place][i] *= share
        commands.modulated[place][i] *= share
        torques[i] = applied[i]
    whole = share_of(along, sent)
    for j in range(len(commands.ports[place])):
        commands.ports[place][j] *= whole
    commands.power[place] *= whole * whole


def share_of(part: float, whole: float) -> float:
    """Return part / whole, limited to 0..1; 0 where the whole is 0."""
    return min(1.0, max(0.0, part / whole)) if whole != 0.0 else 0.0


def torque_held(ended: GroupHolds, hold: int, missed: int, axis: int) -> float:
    """Return the torque sent for one of the holds that ended, counted from 0 [N*m or N]."""
    if hold >= missed:
        return ended.applied[axis]
    return ended.lost[min(hold, len(ended.lost) - 1)][axis]


def send_nothing(commands: GroupCommands, place: int) -> int:
    """Store zero torque at an index; return the index of the next oldest command."""
    for i in range(len(commands.torques[place])):
        commands.torques[place][i] = commands.dampers[place][i] = commands.modulated[place][i] = 0.0
    for j in range(len(commands.ports[place])):
        commands.ports[place][j] = 0.0
    commands.power[place] = 0.0
    return next_place(commands, place)


def norm(values: Sequence[float]) -> float:
    """Return the Euclidean norm."""
    total = 0.0
    for value in values:
        total += value * value
    return sqrt(total)


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
    uncertainty: float
    further: float  # largest excess of the energy beyond the subtracted uncertainty [J]
    limit: int
    place: int  # of the torques that it sent, in the rings of the commands


class GroupKernel(NamedTuple):
    """A passivity algorithm of a group as functions; see `canhaptic.kernels.Kernel`."""

    settings: Callable[..., Any]  # (world, parameters, loops) -> constants of a run; has `loop`
    state: Callable[[], Any]  # () -> state at rest
    memory: Callable[..., Any]  # (world, settings) -> buffers; has `group`
    step: Callable[..., GroupHold]  # (world, settings, state, memory, samples lost before, positions, torques applied)


def group_loop(world: GroupModel, loops: tuple[LoopProperties, ...]) -> GroupLoop:
    """Constants of a run."""
    sample_time, delay = loops[0].sample_time, loops[0].delay
    caps = [min(_NO_CAP, damping_cap(delay, loop.moving_mass, sample_time)) for loop in loops]
    largest = [loop.torque_limit or inf for loop in loops]
    rises = [(loop.torque_rate_limit or inf) * sample_time for loop in loops]
    powers = [loop.power_limit or inf for loop in loops]
    return GroupLoop(delay, caps, min(caps), max(caps), largest, rises, powers, motion_settings(world, loops))


def group_memory(world: GroupModel, loop: GroupLoop, ports: int) -> GroupMemory:
    """Return the buffers of a group at rest; the efforts at the ports are kept."""
    axes = len(loop.caps)
    return GroupMemory(
        no_group_commands(axes, ports, loop.delay), no_group_holds(axes, loop.delay), motion_memory(world, loop.motion)
    )


class GroupRun(NamedTuple):
    """A run of a kernel, from its first SYNC."""

    step: Callable[[int, Sequence[float], Sequence[float]], GroupHold]
    torques: Matrix  # rows of the commands
    interactions: Buffer
    withhold: Callable[[int], object]  # takes a command back, by its place


_HELD = Branch.HELD.value


def interpreted_run(kernel: GroupKernel, world: GroupModel, settings: Any) -> Callable[[], GroupRun]:
    """Return the function that begins an interpreted run."""
    fixed = with_quick_fields(world), with_quick_fields(settings)

    def begin() -> GroupRun:
        memory = with_quick_fields(kernel.memory(world, settings))
        step = partial(kernel.step, *fixed, kernel.state(), memory)
        commands = memory.group.commands
        return GroupRun(step, commands.torques, memory.group.ended.interactions, partial(send_nothing, commands))

    return begin


class SteppedGroup:
    """A kernel with the state of one group; see `GroupController`.

    Attributes:
        energy_resolution: Largest excess of the energy that came in, due to late torques and lost samples [J].
    """

    parameters_type: ClassVar[type[Parameters]]
    kernel: ClassVar[GroupKernel]

    def __init__(
        self,
        environment: NetworkEnvironment,
        kinematics: Kinematics,
        parameters: Any,
        loops: tuple[LoopProperties, ...],
    ) -> None:
        """Prepare a run; `parameters` is of `parameters_type`.

        Raises:
            ParameterError: Parts do not fit together, or the algorithm cannot do without something that is not known.
        """
        self.axes = kinematics.axes
        self.max_consecutive_losses: int = getattr(parameters, "max_consecutive_losses", 0)
        self.energy_allowance: float = getattr(parameters, "energy_allowance", 0.0)
        world = world_of(environment, kinematics, loops)
        settings = self.kernel.settings(world, parameters, loops)
        self._begin: Callable[[], GroupRun] = interpreted_run(self.kernel, world, settings)
        self.reset()

    def reset(self) -> None:
        """Return to the initial state; see `GroupController`."""
        self._step, self._torques, self._interactions, self._withhold = self._begin()
        self._missed = self._newest = 0
        self.energy_resolution = 0.0
        self._last = group_at_rest(self.axes)
        self._started = False

    def lasted(self, periods: float) -> None:
        """Count skipped SYNCs as lost samples: only the total displacement of all holds is known.

        Args:
            periods: Length of the hold that the next `step` ends [sample times].
        """
        self._missed += (round(periods) - 1) * self._started

    def sample_lost(self) -> GroupBalance:
        """Repeat the last commands at a SYNC without a sample; see `GroupController`."""
        self._missed += self._started
        torques, last = self._last.torques, self._last.account
        account = AT_REST._replace(
            torque=norm(torques), h_s=last.h_s, h_dis=last.h_dis, branch=_HELD, state=last.state
        )  # fmt: skip
        return GroupBalance(torques, account, (0.0,) * self.axes)

    def withhold(self) -> None:
        """Record that the torques of the last `step` are not sent: in a dry run the drives hold none."""
        self._withhold(self._newest)

    def step(self, positions: Sequence[float], torques_applied: Sequence[float]) -> GroupBalance:
        """Book the hold that ended; see `GroupController`."""
        total = 0.0
        for value in (*positions, *torques_applied):
            total += value - value  # 0, or NaN where it is not finite
        if total != 0.0 or not len(positions) == len(torques_applied) == self.axes:
            self.reset()
            raise ControlError(
                f"group controller: got positions {tuple(positions)} and applied torques {tuple(torques_applied)}, "
                f"expected {self.axes} finite numbers each; torque is zero and the controller was reset; check "
                "the encoders"
            )
        account, supplied, uncertainty, further, limit, place = self._step(self._missed, positions, torques_applied)
        torques = tuple(self._torques[place])
        if not isfinite(sum(torques)):
            self.reset()
            raise ControlError(
                f"group controller: computed torques {torques}, expected finite numbers; torque is zero and "
                "the controller was reset; check stiffness and damping against the size of the motion"
            )
        self.energy_resolution += further
        self._started, self._missed, self._newest = True, 0, place
        self._last = GroupBalance(torques, account, tuple(self._interactions), supplied, uncertainty, limit)
        return self._last
