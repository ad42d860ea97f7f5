"""Maps between motor axes and network ports: the group's motion, and the efforts that its network requests."""

from dataclasses import dataclass, field
from typing import Final, NamedTuple

from canhaptic.control.damping import VelocityWindow, restart, update
from canhaptic.control.mechanisms.kinematics import Kinematics, KinematicsKernel, Limit, mechanism_of
from canhaptic.control.multi_axis.group_controller import NetworkEnvironment
from canhaptic.control.passivity.controller import LoopProperties
from canhaptic.control.port_hamiltonian.gauss import dot
from canhaptic.control.port_hamiltonian.network import NetworkTables
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
from canhaptic.control.port_hamiltonian.shapes.geometry import Geometry, Mover, moved_by
from canhaptic.control.port_hamiltonian.storages import Functions
from canhaptic.errors import ParameterError
from canhaptic.kernels import Buffer, Matrix, list_of_zeros, zeros

_NONE, _WORKSPACE, _UNSOLVED = Limit.NONE.value, Limit.WORKSPACE.value, Limit.UNSOLVED.value
_LONGEST_WINDOW: Final = 0.02
"""Longest window of the velocity from a coarse encoder [s]."""


class GroupModel(NamedTuple):
    """Network of a group, and its kinematics."""

    mechanism: KinematicsKernel
    geometry: Geometry
    mover: Mover
    tables: NetworkTables
    functions: Functions


class MotionSettings(NamedTuple):
    """Constants of a run."""

    sample_time: float  # [s]
    counts: Buffer  # of the encoders, (axes,); 0: ideal [m or rad]
    smooth: bool  # whether any encoder is coarse
    moves: bool  # whether a mover may give or take energy


@dataclass(slots=True)
class GroupMotion:
    """Motion of a group."""

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
    """Efforts that oppose the motion, at the motors, shapes (axes,) [N*m or N]."""

    spring: Buffer
    lead: Buffer
    damper: Buffer
    velocity: Buffer  # of the motor axes, inside the contact [rad/s or m/s]


def world_of(environment: NetworkEnvironment, kinematics: Kinematics, loops: tuple[LoopProperties, ...]) -> GroupModel:
    """Return a model from environment, mechanism and loops.

    Raises:
        ParameterError: They do not fit.
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
    """Reason why a part of a group model cannot be compiled, or ""."""
    parts = (world.mechanism, world.geometry, world.functions)
    names = [type(part).__name__ for part in parts if not hasattr(part, "_fields") or hasattr(part, "kinematics")]
    return f"got {', '.join(names)}, which is Python code of its own" if names else ""


def motion_settings(world: GroupModel, loops: tuple[LoopProperties, ...]) -> MotionSettings:
    """Constants of a run."""
    counts = [loop.encoder_count for loop in loops]
    return MotionSettings(loops[0].sample_time, counts, any(counts), world.mover.half != 0.0)


def motion_memory(world: GroupModel, settings: MotionSettings) -> MotionMemory:
    """Buffers for the motion of a group."""
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
    """Take the first positions, at rest."""
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
    """Take positions and the displacement since the last ones, and advance the network by it."""
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
    """Take positions and the displacement since the last ones, over one hold or several; the network is not advanced.

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
    measure_velocity(settings, memory, positions, displacement, holds)
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
    """Update energy and engagement of the network."""
    motion.energy = motion.network.energy
    motion.engaged = motion.network.engaged and motion.limit == _NONE


def locate(
    world: GroupModel, settings: MotionSettings, motion: GroupMotion, memory: MotionMemory, positions: Buffer
) -> None:
    """Compute pose and coordinates, minus the mover's motion."""
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


def measure_velocity(
    settings: MotionSettings, memory: MotionMemory, positions: Buffer, displacement: Buffer, holds: int
) -> None:
    """Update the velocity of the motor axes."""
    elapsed = holds * settings.sample_time
    for i in range(len(positions)):
        velocity, count = displacement[i] / elapsed, settings.counts[i]
        if count > 0.0:
            window = memory.windows[i]
            if holds == 1:
                update(window, memory.samples[i], count, settings.sample_time, positions[i])
                velocity = window.velocity
            else:
                restart(window, memory.samples[i], positions[i])
                window.velocity = velocity
        memory.velocity[i] = velocity


def mover_motion(world: GroupModel, settings: MotionSettings, first: int, last: int) -> float:
    """Return the mover's motion from one sample to another [m or rad]."""
    if not settings.moves:
        return 0.0
    before = moved_by(world.mover, first * settings.sample_time)
    return moved_by(world.mover, last * settings.sample_time) - before


def write_carried(
    world: GroupModel, settings: MotionSettings, motion: GroupMotion, memory: MotionMemory, after: int, into: Buffer
) -> None:
    """Write the smallest motor motion that moves the ports as the mover does in one hold, at this pose.

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
    """Write the efforts that the network requests of the motors, its springs at the predicted positions.

    Returns:
        Speed at which the storages at the ports move by themselves [m/s or rad/s].
    """
    tables, network, holds = world.tables, memory.network, motion.holds
    ports, time, carried = memory.port_motion, settings.sample_time, motion.moved / motion.holds
    if ahead.is_predicted:
        to_ports(memory, ahead.step, carried, ports)
    else:
        write_port_motion(settings, motion, memory, ports)
    dampers(tables, network, ports, time, network.state, memory.damper_at_ports)
    write_springs(world, motion, memory, ahead.lead, ahead.way, request)
    to_motors(memory, memory.damper_at_ports, request.damper)
    for i in range(len(request.velocity)):
        request.velocity[i] = ahead.step[i] / time if ahead.is_predicted else motion.entered * memory.velocity[i]
    return internal_motion(tables, network.room) / (holds * time)


def write_springs(
    world: GroupModel, motion: GroupMotion, memory: MotionMemory, lead: float, way: Buffer, request: RequestedEfforts
) -> None:
    """Write the present efforts of the springs, and their change until the motors reach the predicted positions.

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
    """Write the port motion [m or rad] due to a motor motion, minus the mover's."""
    for j in range(len(into)):
        into[j] = dot(memory.at_motors[j], moved) - carried


def write_port_motion(settings: MotionSettings, motion: GroupMotion, memory: MotionMemory, into: Buffer) -> None:
    """Write the port motion in one hold, from the smoothed velocity where an encoder is coarse."""
    holds = motion.holds
    for j in range(len(into)):
        if settings.smooth:
            into[j] = dot(memory.at_motors[j], memory.velocity) * settings.sample_time - motion.moved / holds
        else:
            into[j] = memory.displacement[j] / holds


def to_motors(memory: MotionMemory, efforts: Buffer, into: Buffer) -> None:
    """Write the efforts at the motors [N*m or N] of efforts at the ports."""
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
        ParameterError: Otherwise.
    """
    if len(loops) != kinematics.axes:
        raise ParameterError(
            f"group: got the loops of {len(loops)} axes, expected {kinematics.axes}, one for each motor"
        )
    for name in ("sample_time", "delay"):
        values = sorted({getattr(loop, name) for loop in loops})
        if len(values) > 1:
            raise ParameterError(f"group: got {name} {values} on its axes, expected one value: they share one SYNC")
