"""What all algorithms of a group share: its motion, its commands, and the controller that steps a compiled kernel.

The motion of the motors moves the ports of the network through mechanism and geometry, and the efforts of the network
return to the motors the same way. A command is kept, with its components, from its computation to the end of the hold
in which it acted.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from math import inf, isfinite, sqrt
from typing import Any, ClassVar, Final, NamedTuple

from canhaptic.control.balance import AT_REST, Branch, EnergyBalance, GroupBalance, group_at_rest
from canhaptic.control.damping import VelocityWindow, damping_cap, restart, update
from canhaptic.control.mechanisms.kinematics import Kinematics, KinematicsKernel, Limit, mechanism_of
from canhaptic.control.multi_axis.group_controller import NetworkEnvironment
from canhaptic.control.passivity import LoopProperties
from canhaptic.control.port_hamiltonian.network import Functions, NetworkTables, dot
from canhaptic.control.port_hamiltonian.sampled_network import (
    NetworkMemory,
    NetworkState,
    advance_network,
    begin_network,
    dampers,
    internal_motion,
    network_memory,
    share_inside,
    springs,
)
from canhaptic.control.port_hamiltonian.shapes import Geometry, Mover, moved_by
from canhaptic.errors import ControlError, ParameterError
from canhaptic.kernels import Buffer, Kernel, Matrix, Run, list_of_zeros, with_quick_fields, zeros
from canhaptic.units import Parameters

_NONE, _WORKSPACE, _UNSOLVED = Limit.NONE.value, Limit.WORKSPACE.value, Limit.UNSOLVED.value
_LONGEST_WINDOW: Final = 0.02
"""Longest window of the velocity from a coarse encoder [s]."""


class GroupModel(NamedTuple):
    """Network of a group with its geometry, mover and mechanism."""

    mechanism: KinematicsKernel
    geometry: Geometry
    mover: Mover
    tables: NetworkTables
    functions: Functions


class MotionSettings(NamedTuple):
    """Constants of a group's motion in one run."""

    sample_time: float  # [s]
    counts: Buffer  # of the encoders, (axes,); 0: ideal [m or rad]
    smooth: bool  # whether any encoder is coarse
    moves: bool  # whether a mover may give or take energy


@dataclass(slots=True)
class GroupMotion:
    """State of a group's motion and of its network."""

    located: bool = False  # whether the mechanism is inside its limits
    began: bool = True  # whether the last positions were the first inside the limits
    limit: int = _WORKSPACE  # reason why nothing is rendered
    engaged: bool = False  # whether any contact is possible
    energy: float = 0.0  # stored in the network at its state [J]; 0 while a limit holds
    internal: float = 0.0  # dissipated inside it in the last step, beyond the ports' part [J]
    entered: float = 1.0  # share of the last motion that was inside a contact just entered, else 1
    sample: int = 0
    holds: int = 1  # of the last motion
    elapsed: float = 0.0  # its time [s]
    moved: float = 0.0  # by the mover in it, along every port [m or rad]
    network: NetworkState = field(default_factory=NetworkState)


class MotionMemory(NamedTuple):
    """Buffers for the motion of a group."""

    place: Buffer  # in task space [m or rad], (dimensions,)
    jacobian: Matrix  # (dimensions, axes)
    rows: Matrix  # of the ports over task space, (ports, dimensions)
    at_motors: Matrix  # of the ports over the motor axes, (ports, axes)
    coordinates: Buffer  # of the ports [m or rad], (ports,)
    displacement: Buffer  # of the ports in the last motion [m or rad], (ports,)
    port_motion: Buffer  # in one hold, (ports,)
    way: Buffer  # of the ports until the next torques act, (ports,)
    spring_at_ports: Buffer  # (ports,)
    lead_at_ports: Buffer
    damper_at_ports: Buffer
    velocity: Buffer  # of the motor axes, (axes,) [m/s or rad/s]
    windows: list[VelocityWindow]  # of the velocity, (axes,)
    samples: Matrix  # of the windows, (axes, longest + 1) [m or rad]
    network: NetworkMemory


class MotionAhead(NamedTuple):
    """Predicted motor positions in the hold in which the next torques act, shapes (axes,)."""

    lead: float  # holds until then
    way: Buffer  # [rad or m]
    step: Buffer  # motion in a hold there [rad or m]
    is_predicted: bool  # whether the dampers have that motion too; else that of the last hold


class RequestedEfforts(NamedTuple):
    """Efforts at the motors, positive against the motion, shapes (axes,) [N*m or N]."""

    spring: Buffer
    lead: Buffer
    damper: Buffer
    velocity: Buffer  # of the motor axes, inside the contact [rad/s or m/s]


def world_of(environment: NetworkEnvironment, kinematics: Kinematics, loops: tuple[LoopProperties, ...]) -> GroupModel:
    """Return the model of a group: network, geometry and mover of its environment, and its mechanism.

    Raises:
        ParameterError: They do not fit together.
    """
    _check_loops(kinematics, loops)
    network, geometry, mover = environment.build(kinematics.dimensions)
    if geometry.ports != network.ports or geometry.dimensions != kinematics.dimensions:
        raise ParameterError(
            f"group: the network has {network.ports} ports and its geometry {geometry.ports}, the geometry has "
            f"{geometry.dimensions} dimensions and the mechanism {kinematics.dimensions}; expected equal numbers"
        )
    tables = network.tables._replace(structure=[list(row) for row in network.tables.structure])
    return GroupModel(mechanism_of(kinematics), geometry, mover, tables, network.functions)


def why_not_world(world: GroupModel) -> str:
    """Return why a group model cannot be compiled; empty if it can."""
    parts = (world.mechanism, world.geometry, world.functions)
    names = [type(part).__name__ for part in parts if not hasattr(part, "_fields") or hasattr(part, "kinematics")]
    return f"got {', '.join(names)}, which is Python code of its own" if names else ""


def motion_settings(world: GroupModel, loops: tuple[LoopProperties, ...]) -> MotionSettings:
    """Return the constants of a group's motion."""
    counts = [loop.encoder_count for loop in loops]
    return MotionSettings(loops[0].sample_time, counts, any(counts), world.mover.half != 0.0)


def motion_memory(world: GroupModel, settings: MotionSettings) -> MotionMemory:
    """Return the buffers for the motion of a group."""
    geometry, axes = world.geometry, len(settings.counts)
    ports, dimensions = geometry.ports, geometry.dimensions
    longest = max(2, round(_LONGEST_WINDOW / settings.sample_time)) if settings.smooth else 0
    one = list_of_zeros
    return MotionMemory(
        one(dimensions), zeros(dimensions, axes), zeros(ports, dimensions), zeros(ports, axes), one(ports), one(ports),
        one(ports), one(ports), one(ports), one(ports), one(ports), one(axes),
        [VelocityWindow() for _ in settings.counts], zeros(axes, longest + 1), network_memory(world.tables),
    )  # fmt: skip


def begin_motion(
    world: GroupModel, settings: MotionSettings, motion: GroupMotion, memory: MotionMemory, positions: Buffer
) -> None:
    """Start the motion of a group at its first positions, at rest."""
    motion.elapsed = settings.sample_time
    for i in range(len(positions)):
        if settings.counts[i] > 0.0:
            restart(memory.windows[i], memory.samples[i], positions[i])
    locate(world, settings, motion, memory, positions)
    if motion.located:
        begin_network(world, motion.network, memory.network, memory.coordinates)
        settle_motion(motion)


def follow(
    world: GroupModel, settings: MotionSettings, motion: GroupMotion, memory: MotionMemory, positions: Buffer,
    displacement: Buffer, holds: int,
) -> None:  # fmt: skip
    """Update the motion of a group with new positions, and advance the network by it."""
    move(world, settings, motion, memory, positions, displacement, holds)
    motion.internal, motion.entered = 0.0, 1.0
    if not motion.located:
        motion.engaged, motion.energy = False, 0.0
        return
    network, followed = motion.network, memory.network
    if motion.began:
        begin_network(world, network, followed, memory.coordinates)
    else:
        was_engaged = network.engaged
        if not advance_network(world, network, followed, memory.coordinates, memory.displacement, motion.elapsed):
            motion.limit = _UNSOLVED
        motion.internal = network.internal
        if not was_engaged:
            motion.entered = share_inside(world.tables, followed.room, followed.state)
    settle_motion(motion)


def move(
    world: GroupModel, settings: MotionSettings, motion: GroupMotion, memory: MotionMemory, positions: Buffer,
    displacement: Buffer, holds: int,
) -> None:  # fmt: skip
    """Update the motion of a group with new positions, after one hold or several; the network is not advanced.

    Args:
        world: Network and kinematics of the group.
        settings: Constants of the run.
        motion: Motion of the group; changed.
        memory: Buffers of the motion; changed.
        positions: Positions of the motor axes [rad or m].
        displacement: Displacement of the motor axes since the last ones [rad or m].
        holds: Sample times since then.
    """
    motion.sample += holds
    motion.holds, motion.elapsed = holds, holds * settings.sample_time
    for i in range(len(positions)):
        velocity, count = displacement[i] / motion.elapsed, settings.counts[i]
        if count > 0.0:
            window = memory.windows[i]
            if holds == 1:
                update(window, memory.samples[i], count, settings.sample_time, positions[i])
                velocity = window.velocity
            else:
                restart(window, memory.samples[i], positions[i])
                window.velocity = velocity
        memory.velocity[i] = velocity
    motion.moved = mover_motion(world, settings, motion.sample - holds, motion.sample)
    was_located = motion.located
    for j in range(len(memory.displacement)):
        memory.displacement[j] = -memory.coordinates[j]
    locate(world, settings, motion, memory, positions)
    motion.began = not was_located
    is_step = was_located and motion.located
    for j in range(len(memory.displacement)):
        memory.displacement[j] = memory.coordinates[j] + memory.displacement[j] if is_step else 0.0


def settle_motion(motion: GroupMotion) -> None:
    """Copy the network's stored energy, and whether it is in contact, to the motion of the group."""
    motion.energy = motion.network.energy
    motion.engaged = motion.network.engaged and motion.limit == _NONE


def locate(
    world: GroupModel, settings: MotionSettings, motion: GroupMotion, memory: MotionMemory, positions: Buffer
) -> None:
    """Compute the pose, the port coordinates less the mover's motion, and the Jacobian of the ports by the motors."""
    motion.limit = world.mechanism.locate(positions, memory.place, memory.jacobian)
    motion.located = motion.limit == _NONE
    if not motion.located:
        return
    values, jacobian = memory.coordinates, memory.jacobian
    world.geometry.measure(memory.place, values, memory.rows)
    if settings.moves:
        offset = moved_by(world.mover, motion.sample * settings.sample_time)
        for j in range(len(values)):
            values[j] -= offset
    for j in range(len(values)):
        row, into = memory.rows[j], memory.at_motors[j]
        for axis in range(len(into)):
            total = 0.0
            for k in range(len(row)):
                total += row[k] * jacobian[k][axis]
            into[axis] = total


def mover_motion(world: GroupModel, settings: MotionSettings, first: int, last: int) -> float:
    """Return the mover's motion from one sample to another [m or rad]."""
    if not settings.moves:
        return 0.0
    before = moved_by(world.mover, first * settings.sample_time)
    return moved_by(world.mover, last * settings.sample_time) - before


def write_carried(
    world: GroupModel, settings: MotionSettings, motion: GroupMotion, memory: MotionMemory, after: int, into: Buffer
) -> None:
    """Compute the smallest motor motion that moves the ports as a wall's mover does in one hold, at this pose.

    Args:
        world: Network and kinematics of the group.
        settings: Constants of the run.
        motion: Motion of the group.
        memory: Buffers of the motion.
        after: Samples from the last one to the start of the hold; negative for holds that ended.
        into: Receives the motion, (axes,) [rad or m].
    """
    first = motion.sample + after
    distance = mover_motion(world, settings, first, first + 1)
    for axis in range(len(into)):
        into[axis] = 0.0
    for j in range(len(memory.at_motors)):
        row, square = memory.at_motors[j], 0.0
        for axis in range(len(row)):
            square += row[axis] * row[axis]
        if square > 0.0:
            for axis in range(len(row)):
                into[axis] += row[axis] * distance / square


def write_efforts(
    world: GroupModel, settings: MotionSettings, motion: GroupMotion, memory: MotionMemory, ahead: MotionAhead,
    request: RequestedEfforts,
) -> float:  # fmt: skip
    """Compute the efforts that the network requests of the motors, with its springs at the predicted positions.

    Returns:
        Speed at which the storages at the ports move relative to the ports [m/s or rad/s].
    """
    tables, network, holds = world.tables, memory.network, motion.holds
    ports, time, carried = memory.port_motion, settings.sample_time, motion.moved / motion.holds
    if ahead.is_predicted:
        to_ports(memory, ahead.step, carried, ports)
    else:  # in one hold, from the smoothed velocity where an encoder is coarse
        for j in range(len(ports)):
            if settings.smooth:
                ports[j] = dot(memory.at_motors[j], memory.velocity) * time - carried
            else:
                ports[j] = memory.displacement[j] / holds
    dampers(tables, network, ports, time, network.state, memory.damper_at_ports)
    write_springs(world, motion, memory, ahead.lead, ahead.way, request)
    to_motors(memory, memory.damper_at_ports, request.damper)
    for i in range(len(request.velocity)):
        request.velocity[i] = ahead.step[i] / time if ahead.is_predicted else motion.entered * memory.velocity[i]
    return internal_motion(tables, network.room) / (holds * time)


def write_springs(
    world: GroupModel, motion: GroupMotion, memory: MotionMemory, lead: float, way: Buffer, request: RequestedEfforts
) -> None:
    """Compute the springs' present efforts at the motors, and their change up to the predicted motor positions.

    Args:
        world: Network and kinematics of the group.
        motion: Motion of the group.
        memory: Buffers of the motion.
        lead: Time of the prediction [holds].
        way: Motion of the motors in that time, (axes,) [rad or m].
        request: Receives the efforts.
    """
    to_ports(memory, way, lead * motion.moved / motion.holds, memory.way)
    springs(world, memory.network, lead, motion.holds, memory.way, memory.spring_at_ports, memory.lead_at_ports)
    to_motors(memory, memory.spring_at_ports, request.spring)
    to_motors(memory, memory.lead_at_ports, request.lead)


def to_ports(memory: MotionMemory, moved: Buffer, carried: float, into: Buffer) -> None:
    """Convert a motor motion to motion of the ports, less the mover's motion `carried` [m or rad]."""
    for j in range(len(into)):
        into[j] = dot(memory.at_motors[j], moved) - carried


def to_motors(memory: MotionMemory, efforts: Buffer, into: Buffer) -> None:
    """Convert efforts at the ports to the equivalent efforts at the motors [N*m or N]."""
    for axis in range(len(into)):
        into[axis] = 0.0
    for j in range(len(efforts)):
        effort = efforts[j]
        if effort != 0.0:
            row = memory.at_motors[j]
            for axis in range(len(into)):
                into[axis] += row[axis] * effort


def _check_loops(kinematics: Kinematics, loops: tuple[LoopProperties, ...]) -> None:
    """Require one loop for each motor axis, all with one sample time and delay.

    Raises:
        ParameterError: A loop is missing or in excess, or the loops differ in sample time or delay.
    """
    if len(loops) != kinematics.axes:
        raise ParameterError(
            f"group: got the loops of {len(loops)} axes, expected {kinematics.axes}, one for each motor"
        )
    for name in ("sample_time", "delay"):
        values = sorted({getattr(loop, name) for loop in loops})
        if len(values) > 1:
            raise ParameterError(f"group: got {name} {values} on its axes, expected one value: they share one SYNC")


class GroupCommands(NamedTuple):
    """Commands of the holds that have not ended, in ring buffers of delay + 1 rows; see `stepped.Commands`.

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
    """Record the holds that ended; return the index of the command that acted in the last of them.

    If the drives applied other torques than that command, its spring and damper efforts are scaled accordingly.

    Args:
        commands: Commands of the group.
        ended: Receives displacement, torques and energy of each axis.
        largest: Largest torque of each axis that limiter and drive let through [N*m or N].
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
    """Return the next index in the ring buffers of the commands."""
    return place + 1 if place + 1 < len(commands.power) else 0


def take_applied(commands: GroupCommands, place: int, applied: Buffer) -> None:
    """Replace a command's torques by the applied ones, and scale its efforts by the ratio of applied to sent torque."""
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
    """Return the torque of one of the holds that ended, counted from 0: as sent, in the last as applied [N*m or N]."""
    if hold >= missed:
        return ended.applied[axis]
    return ended.lost[min(hold, len(ended.lost) - 1)][axis]


def uncertainty_of_gap(ended: GroupHolds, previous: Buffer, missed: int) -> float:
    """Return the largest error of the energy over lost holds, of which only the total displacement is known [J].

    Args:
        ended: The holds that ended.
        previous: Displacement of the hold before, (axes,) [rad or m]; changed to that of these.
        missed: Number of lost samples.
    """
    total = 0.0
    for i in range(len(ended.displacement)):
        moved, torque, apart = ended.displacement[i], ended.applied[i], 0.0
        if missed:
            excursion = abs(moved) + missed * abs(previous[i])
            for hold in range(missed):
                apart += abs(torque_held(ended, hold, missed, i) - torque)
            total += apart * excursion
        previous[i] = moved
    return total


def send_nothing(commands: GroupCommands, place: int) -> int:
    """Store a command of zero torque at an index of the ring buffers; return the next index."""
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
    """Constants of a run that every algorithm has."""

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
    """Buffers that every algorithm has."""

    commands: GroupCommands
    ended: GroupHolds
    motion: MotionMemory


class GroupHold(NamedTuple):
    """Account of the hold that ended, for a group; see `GroupBalance`."""

    account: EnergyBalance
    uncertainty: float
    further: float  # largest excess of the energy beyond the subtracted uncertainty [J]
    limit: int
    place: int  # of the torques that it sent, in the rings of the commands


def group_loop(world: GroupModel, loops: tuple[LoopProperties, ...]) -> GroupLoop:
    """Return the constants of a run that every algorithm has."""
    sample_time, delay = loops[0].sample_time, loops[0].delay
    caps = [min(_NO_CAP, damping_cap(delay, loop.moving_mass, sample_time)) for loop in loops]
    largest = [loop.torque_limit or inf for loop in loops]
    rises = [(loop.torque_rate_limit or inf) * sample_time for loop in loops]
    powers = [loop.power_limit or inf for loop in loops]
    return GroupLoop(delay, caps, min(caps), max(caps), largest, rises, powers, motion_settings(world, loops))


def group_memory(world: GroupModel, loop: GroupLoop, ports: int) -> GroupMemory:
    """Return the buffers of a group at rest; `ports` is the number of ports whose efforts are kept."""
    axes = len(loop.caps)
    return GroupMemory(
        no_group_commands(axes, ports, loop.delay), no_group_holds(axes, loop.delay), motion_memory(world, loop.motion)
    )


def begin_group(
    world: GroupModel, settings: MotionSettings, group: Group, memory: GroupMemory, positions: Buffer
) -> None:
    """Start a run of a group at its first positions, at rest."""
    group.started = True
    for i in range(len(positions)):
        memory.ended.position[i] = positions[i]
    begin_motion(world, settings, group.motion, memory.motion, positions)


_HELD = Branch.HELD.value


class SteppedGroup:
    """The controller of one group: a kernel with its state; see `GroupController`.

    Attributes:
        energy_resolution: Most by which the energy that came in may exceed the booked energy, because torques came late
            or samples were lost [J].
    """

    parameters_type: ClassVar[type[Parameters]]
    kernel: ClassVar[Kernel]

    def __init__(
        self,
        environment: NetworkEnvironment,
        kinematics: Kinematics,
        parameters: Any,
        loops: tuple[LoopProperties, ...],
    ) -> None:
        """Prepare a run; `parameters` is of `parameters_type`.

        Raises:
            ParameterError: Parts do not fit together, or a property that the algorithm needs is not declared.
        """
        self.axes = kinematics.axes
        self.max_consecutive_losses: int = getattr(parameters, "max_consecutive_losses", 0)
        self.energy_allowance: float = getattr(parameters, "energy_allowance", 0.0)
        self.hand_force: float | None = getattr(parameters, "hand_force", None)
        world = world_of(environment, kinematics, loops)
        self._fixed = world, self.kernel.settings(world, parameters, loops)
        self.reset()

    def _begin(self) -> tuple[Callable[..., GroupHold], Matrix, Buffer, Callable[[int], object]]:
        """Begin a run; return step function, commanded torques, h_i of each axis, and a function to zero a command."""
        memory = with_quick_fields(self.kernel.memory(*self._fixed))
        world, settings = map(with_quick_fields, self._fixed)
        step = partial(self.kernel.step, world, Run(settings, self.kernel.state(), memory))
        commands = memory.group.commands
        return step, commands.torques, memory.group.ended.interactions, partial(send_nothing, commands)

    def reset(self) -> None:
        """Return to the initial state; see `GroupController`."""
        self._step, self._torques, self._interactions, self._withhold = self._begin()
        self._missed = self._newest = 0
        self.energy_resolution = 0.0
        self._last = group_at_rest(self.axes)
        self._started = False

    def note_skipped_syncs(self, periods: float) -> None:
        """Treat skipped SYNCs as lost samples: only the total displacement of all holds is known.

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
        account, uncertainty, further, limit, place = self._step(self._missed, positions, torques_applied)
        torques = tuple(self._torques[place])
        if not isfinite(sum(torques)):
            self.reset()
            raise ControlError(
                f"group controller: computed torques {torques}, expected finite numbers; torque is zero and "
                "the controller was reset; check stiffness and damping against the size of the motion"
            )
        self.energy_resolution += further
        self._started, self._missed, self._newest = True, 0, place
        self._last = GroupBalance(torques, account, tuple(self._interactions), uncertainty, limit)
        return self._last
