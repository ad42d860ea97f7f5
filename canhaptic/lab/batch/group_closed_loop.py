"""Motors and the controller of a group in one loop, from SYNC to SYNC: a kernel, as `closed_loop` is for one axis.

Plants that move by one flow are in the loop; others replace `move_motors`. The network's request at the true positions,
without sampling errors, is followed along with the controller: the torques held are explained by it, as shares of
spring and damper.
"""

from dataclasses import dataclass, field
from math import isfinite, sqrt
from typing import Any, Final, NamedTuple

from canhaptic.control.balance import RANKS, Branch
from canhaptic.control.multi_axis.group_kernel import GroupHold
from canhaptic.control.multi_axis.group_motion import (
    Ahead,
    GroupMotion,
    MotionMemory,
    MotionSettings,
    RequestedEfforts,
    World,
    begin_motion,
    follow,
    write_efforts,
)
from canhaptic.kernels import Buffer, Indices, Matrix, new
from canhaptic.lab.batch.closed_loop import LoopSettings, acting, commanded, measured, read
from canhaptic.lab.batch.meter import Meter, count_branch, take_energy

_FREE, _EXIT = Branch.FREE.value, Branch.EXIT.value
_SEEN: Final = 1e-9
"""Part of the largest sum below which a damper counts as nothing."""


class GroupRig(NamedTuple):
    """Properties of the loop between motors and controller."""

    delay: int  # whole holds between computing a torque and its hold, 0 or 1
    loops: list[LoopSettings]  # of every motor
    damping_per_time: Buffer  # b / T of every motor for certain [N/m or N*m/rad]
    furthest: float  # distance from the origin that counts as divergence [m or rad]
    explains: bool  # whether the shares of spring and damper are asked for
    true: MotionSettings  # of a group that knows its true positions


class LinearMotors(NamedTuple):
    """Motors that move by one flow."""

    flow: Matrix  # over one hold, shape (states, states + motors + 1)
    state: Buffer  # [states..., torques..., 1]
    moved: Buffer  # buffer for the states
    places: Indices  # of the positions of the motors in the state


class GroupRoom(NamedTuple):
    """Buffers of the loop, of shape (motors,) unless stated."""

    held: Buffer  # since the SYNC before [N or N*m]
    waiting: Buffer  # one sample late
    acting: Buffer  # what of `held` reaches the motors
    temperatures: Buffer  # of their windings [K]
    true: Buffer  # positions [m or rad]
    read: Buffer  # positions that the encoders read
    seen: Buffer  # positions as the controller sees them
    moved: Buffer  # true motion in the hold that ended
    spring: Buffer  # asked for at the last SYNC [N or N*m]
    still: Buffer  # zeros
    asked: MotionMemory  # of the group that is followed with its true positions
    wish: RequestedEfforts  # of its network


@dataclass(slots=True)
class GroupMeter:
    """Running sums of a group."""

    figures: Meter = field(default_factory=Meter)
    supplied: float = 0.0  # by a mover [J]
    work: float = 0.0  # of all motors [J]
    spring_spring: float = 0.0  # sums of products of the requested efforts, over holds that began and ended in contact
    spring_damper: float = 0.0
    damper_damper: float = 0.0
    held_spring: float = 0.0  # of the held with the requested efforts
    held_damper: float = 0.0
    damping_asked: float = 0.0  # along the motion, as `Meter.damping` is what was rendered [N*s/m or N*m*s/rad]


def step(
    world: World, settings: object, state: Any, memory: Any, missed: int, positions: Buffer, torques_applied: Buffer
) -> GroupHold:
    """Kernel of an algorithm; the caller of `run_group` supplies it."""
    raise NotImplementedError


def run_group(
    world: World, settings: object, state: Any, memory: Any, rig: GroupRig, motors: Any, room: GroupRoom,
    followed: GroupMotion, meter: GroupMeter, rows: Matrix, cycles: int,
) -> None:  # fmt: skip
    """Run a loop until its last SYNC or until it diverges; a number that is not finite counts as divergence.

    Args:
        world: Network and kinematics of the group.
        settings: Settings of the algorithm.
        state: State of the algorithm, at rest.
        memory: Memory of the algorithm, zeros.
        rig: Properties of the loop between motors and controller.
        motors: Motors in the form of `move_motors`, at their start.
        room: Buffers of zeros.
        followed: Motion of the group at its true positions, at rest.
        meter: Accumulates the sums.
        rows: Rows for the replacement of `take_group`.
        cycles: SYNCs.
    """
    figures = meter.figures
    for cycle in range(cycles):
        act(rig, room, cycle)
        work = move_motors(motors, room, cycle)
        if not isfinite(work):
            figures.diverged = 1.0
            break
        meter.work += work
        if cycle and rig.explains:
            explain(world, rig, room, followed, meter)
        elif rig.explains:
            begin_motion(world, rig.true, followed, room.asked, room.true)
        see(rig, room, cycle)
        hold = step(world, settings, state, memory, 0, room.seen, room.held)
        torques, total = memory.group.commands.torques[hold.place], 0.0
        for i in range(len(room.held)):
            total += torques[i] + room.seen[i] + room.held[i]
        if not isfinite(total):
            figures.diverged = 1.0
            break
        meter.supplied += hold.supplied
        take_group(rig, room, meter, rows, hold)
        if is_away(rig, room):
            figures.diverged = 1.0
            break
        send(rig, room, torques)


def act(rig: GroupRig, room: GroupRoom, cycle: int) -> None:
    """Record the part of the held torques that reaches the motors until a SYNC."""
    for i in range(len(room.held)):
        signals = rig.loops[i].signals
        if not cycle:
            room.temperatures[i] = signals.winding.ambient
        elif signals.on_torque:
            room.acting[i], room.temperatures[i] = acting(signals, room.temperatures[i], room.held[i])
        else:
            room.acting[i] = room.held[i]


def see(rig: GroupRig, room: GroupRoom, cycle: int) -> None:
    """Write the encoder readings of the positions."""
    for i in range(len(room.seen)):
        at, loop = room.read[i], rig.loops[i]
        room.seen[i] = measured(loop, read(loop.signals, cycle, at)) if isfinite(at) else at


def send(rig: GroupRig, room: GroupRoom, torques: Buffer) -> None:
    """Take the torques that the drives apply for a command in the next free hold."""
    for i in range(len(room.held)):
        command = commanded(rig.loops[i], torques[i])
        if rig.delay:
            room.held[i], room.waiting[i] = room.waiting[i], command
        else:
            room.held[i] = command


def is_away(rig: GroupRig, room: GroupRoom) -> bool:
    """Whether a motor is farther than any user moved it."""
    for i in range(len(room.true)):
        if not -rig.furthest < room.true[i] < rig.furthest:
            return True
    return False


def take_group(rig: GroupRig, room: GroupRoom, meter: GroupMeter, rows: Matrix, hold: GroupHold) -> None:
    """Take one SYNC; see `meter.take`."""
    figures, account, square, largest = meter.figures, hold.account, 0.0, 0.0
    figures.cycles += 1.0
    for i in range(len(room.held)):
        figures.lost += rig.damping_per_time[i] * (room.moved[i] * room.moved[i])
        square += room.held[i] * room.held[i]
        largest = max(largest, abs(room.held[i]))
    norm = sqrt(square)
    take_energy(rig.loops[0].meter, figures, 0.0, meter.supplied - meter.work, account)
    figures.torque_peak = max(figures.torque_peak, largest)
    figures.variation += abs(norm - figures.torque)
    figures.torque = norm
    figures.certificate = max(figures.certificate, float(RANKS[account.certificate]))
    count_branch(figures, account.branch)
    if account.branch != _FREE and account.branch != _EXIT:  # noqa: PLR1714 - `in` would search
        rendered = account.damping_rendered
        figures.contacts += 1.0
        figures.damping += rendered
        figures.damping_least = min(figures.damping_least, rendered)
        figures.damping_most = max(figures.damping_most, rendered)


def explain(world: World, rig: GroupRig, room: GroupRoom, followed: GroupMotion, meter: GroupMeter) -> None:
    """Follow the network with the true motion, and add a hold that began and ended in contact to the sums."""
    was_engaged, wish = followed.engaged, room.wish
    follow(world, rig.true, followed, room.asked, room.true, room.moved, 1)
    if followed.engaged:
        write_efforts(world, rig.true, followed, room.asked, new(Ahead, (0.0, room.still, room.still, False)), wish)
    along = square = 0.0
    for i in range(len(room.held)):
        along += wish.damper[i] * wish.velocity[i]
        square += wish.velocity[i] * wish.velocity[i]
        now = wish.spring[i] if followed.engaged else 0.0
        spring, damper = 0.5 * (room.spring[i] + now), wish.damper[i]
        room.spring[i] = now
        if was_engaged and followed.engaged:
            meter.spring_spring += spring * spring
            meter.spring_damper += spring * damper
            meter.damper_damper += damper * damper
            meter.held_spring -= room.held[i] * spring
            meter.held_damper -= room.held[i] * damper
    if followed.engaged and square > 0.0:
        meter.damping_asked += along / square


def shares(meter: GroupMeter) -> tuple[float, float]:
    """Return the shares of spring and damper that were rendered; NaN without any.

    The spring's share is that in the torques held, by least squares with the damper; the damper's is the damping that
    the controller booked over the requested one.
    """
    both, nothing = meter.spring_spring * meter.damper_damper, float("nan")
    apart = both - meter.spring_damper * meter.spring_damper
    damper = meter.figures.damping / meter.damping_asked if meter.damping_asked > 0.0 else nothing
    if meter.spring_spring == 0.0:
        return nothing, damper
    if meter.damper_damper <= _SEEN * meter.spring_spring or apart <= _SEEN * both:
        return meter.held_spring / meter.spring_spring, damper
    return (meter.held_spring * meter.damper_damper - meter.held_damper * meter.spring_damper) / apart, damper


def states_of(moved: Buffer) -> int:
    """Return the number of states; compiled it is a constant, so that loops over them are unrolled."""
    return len(moved)


def move_motors(motors: Any, room: GroupRoom, cycle: int) -> float:
    """Move the motors to a SYNC; return the work that they did in that hold [J], NaN where they cannot move."""
    flow, state, moved = motors.flow, motors.state, motors.moved
    states, work, count = states_of(moved), 0.0, len(room.held)
    if cycle:
        for i in range(count):
            state[states + i] = room.acting[i]
        for row in range(states):
            factors, total = flow[row], 0.0
            for column in range(states + count + 1):
                total += factors[column] * state[column]
            moved[row] = total
        for row in range(states):
            state[row] = moved[row]
    for i in range(count):
        work += arrive(room, i, state[motors.places[i]], cycle)
    return work


def arrive(room: GroupRoom, i: int, at: float, cycle: int) -> float:
    """Record the position of a motor at a SYNC [m or rad]; return the work that it did in that hold [J]."""
    room.moved[i] = at - room.true[i] if cycle else 0.0
    room.true[i] = room.read[i] = at
    return room.acting[i] * room.moved[i]
