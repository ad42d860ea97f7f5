"""Kernel of the loop without a bus: motors, encoders, controller, delay and torque limits, from SYNC to SYNC.

`run_loop` moves one motor or several, in Python or compiled. It calls small functions that its callers replace. Those
of this file are for an axis with a linear plant, which moves by its exact transition matrix over one hold, each row
summed term by term:

* `move_motors` and `work_of` move the motors and give their work: `plants.EventMotors` replaces them for plants with
  events, `network_loop` has those for a five-bar, `object_loop` those for plants as objects;
* `respond` steps the controller of one motor; `network_loop` and `object_loop` replace it;
* `take_sync`, `miss_sync` and `diverge` fill figures, or record rows;
* `watch` computes something more, such as the continuous environment (`continuous_run`): by default nothing.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from math import inf, isfinite, sqrt
from typing import Annotated, Any, NamedTuple, TypeAlias

from canhaptic.control.balance import EnergyBalance
from canhaptic.kernels import OFTEN_ZERO, Buffer, Indices, Matrix, Run, list_of_zeros, new, with_quick_fields
from canhaptic.kernels.records import bound
from canhaptic.lab.batch.mode_arrays import evaluate
from canhaptic.lab.figures.meter import Meter, MeterSettings, diverge, lose, miss, take_hold
from canhaptic.sim.plant.effects.encoder_noise import noise, uniform
from canhaptic.sim.plant.propagator import TICKS


@dataclass(frozen=True, slots=True)
class Winding:
    """A winding with thermal protection; see `thermal_derating`."""

    torque_limit: float = inf  # of the cold winding [N or N*m]; infinite: none
    heat: float = 0.0  # final temperature above ambient over torque squared
    ambient: float = 0.0  # [K]
    hot: float = 1.0  # [K]
    span: float = 1.0  # temperature from warm to hot [K]
    share: float = 0.0  # part of the remaining temperature rise that one hold covers


@dataclass(frozen=True, slots=True)
class Signals:
    """Effects of a plant on the encoder reading, and on a torque before it reaches the motor."""

    noise: Annotated[float, OFTEN_ZERO] = 0.0  # standard deviation of a reading [m or rad]
    seed: int = 0  # of the noise
    encoder_step: float = 0.0  # of readings; 0: none [m or rad]
    on_torque: Annotated[bool, OFTEN_ZERO] = False  # whether any of the following effects exists
    saturation: float = inf  # largest torque [N or N*m]
    saturates_last: bool = False  # whether the saturation acts after the winding's limit
    torque_step: float = 0.0  # quantisation of the torque; 0: none [N or N*m]
    winding: Winding = field(default_factory=Winding)


@dataclass(frozen=True, slots=True)
class Losses:
    """Frame losses of a bus, single or in bursts: a two-state model (good, lossy) for each direction."""

    exists: Annotated[bool, OFTEN_ZERO] = False
    after_heard: float = 0.0  # probability of a loss after a received frame
    after_lost: float = 0.0  # probability of a loss after a lost frame
    to_drive: bool = False  # whether SYNCs and torques are lost
    to_master: bool = False  # whether positions are lost
    seed: int = 0  # of the random numbers


@dataclass(frozen=True, slots=True)
class LoopSettings:
    """Properties of the loop between one motor and the controller; delay and losses are common to all motors."""

    delay: int = 0  # whole holds between the computation of a torque and its hold, 0 or 1
    counts_per_unit: float = 0.0  # resolution of the encoder; 0: ideal
    torque_quantum: float = 0.0  # step of the command; 0: ideal [N or N*m]
    torque_limit: float = inf  # largest torque of the drive [N or N*m]
    lowest: float = -inf  # positions at or below it count as divergence [m or rad]
    highest: float = inf  # positions at or above it count as divergence
    meter: MeterSettings = field(default_factory=MeterSettings)
    signals: Signals = field(default_factory=Signals)
    losses: Losses = field(default_factory=Losses)


Loops: TypeAlias = Sequence[LoopSettings]
"""Settings of the loop of each motor."""


@dataclass(slots=True)
class CycleState:
    """State of a loop, kept from SYNC to SYNC, without its buffers and the state of its plant."""

    cycle: int = 0  # SYNC to which the motors are moved
    work: float = 0.0  # work of all motors since the start [J]
    supplied: float = 0.0  # energy from a mover since the start [J]
    is_synced: bool = True  # whether the drive received the last SYNC
    is_heard: bool = True  # whether the master received its position
    is_sent: bool = True  # whether the drive received the command that followed
    lost_to_drive: bool = False  # whether the last frame to the drive was lost
    lost_to_master: bool = False  # whether the last frame to the master was lost


class Room(NamedTuple):
    """Buffers of a loop, shapes (motors,)."""

    held: Buffer  # torques held since the previous SYNC [N or N*m]
    waiting: Buffer  # torques that are held from the next SYNC on, where commands are one sample late
    acting: Buffer  # part of `held` that reaches the motors
    temperatures: Buffer  # windings [K]
    true: Buffer  # true positions [m or rad]
    moved: Buffer  # true displacement in the hold that ended
    seen: Buffer  # positions as the encoders report them to the controller
    commands: Buffer  # last commands of the controller [N or N*m]


def room_for(motors: int) -> Room:
    """Return the buffers of a loop of several motors."""
    return Room(*(list_of_zeros(motors) for _ in Room._fields))


AxisRun: TypeAlias = Run[Any, Any, Any]
"""State on which the kernel of any algorithm works."""


class Control(NamedTuple):
    """A controller as a kernel."""

    world: Any  # what is rendered: an environment, or a network with its kinematics
    run: AxisRun  # settings of the algorithm, its state at rest, and memory of zeros


class LinearMotors(NamedTuple):
    """Linear motors, which move by one transition matrix."""

    flow: Matrix  # transition matrix over one hold, shape (states, states + motors + 1)
    state: Buffer  # [states..., torques..., 1]
    moved: Buffer  # buffer for the states
    places: Indices  # index of each motor's position in the state [m or rad]


class LinearPlants(NamedTuple):
    """Linear plants of many loops of one axis; the loops run in turn and share the buffers."""

    flows: Any  # transition matrices, shape (n, states, states + 2), n = 1 where all are equal
    starts: Any  # initial states, shape (n, states + 2)
    state: Buffer  # as in `LinearMotors`
    moved: Buffer
    places: Indices


def motors_at(plants: LinearPlants, row: int) -> LinearMotors:
    """Return the plant of a loop, at its start."""
    start, state = plants.starts[row % len(plants.starts)], plants.state
    for place in range(len(state)):
        state[place] = start[place]
    return LinearMotors(plants.flows[row % len(plants.flows)], state, plants.moved, plants.places)


def measured(loop: LoopSettings, position: float) -> float:
    """Return a position as the encoder reports it [m or rad]."""
    if loop.counts_per_unit == 0.0:
        return position
    return round(position * loop.counts_per_unit) * (1.0 / loop.counts_per_unit)


def commanded(loop: LoopSettings, torque: float) -> float:
    """Return a torque as the drive applies it [N or N*m]."""
    if abs(torque) > loop.torque_limit:
        torque = loop.torque_limit if torque > 0.0 else -loop.torque_limit
    return torque if loop.torque_quantum == 0.0 else round(torque / loop.torque_quantum) * loop.torque_quantum


class ActingTorque(NamedTuple):
    """Torque that reaches a motor during the next hold."""

    torque: float  # [N or N*m]
    temperature: float  # of the winding at its end [K]


def acting(signals: Signals, temperature: float, torque: float) -> ActingTorque:
    """Return the motor's torque for a command [N or N*m] at a winding temperature [K], and the new temperature."""
    winding = signals.winding
    if not signals.saturates_last:
        torque = min(max(torque, -signals.saturation), signals.saturation)
    if winding.torque_limit < inf:
        cool = min(max((winding.hot - temperature) / winding.span, 0.0), 1.0)
        torque = min(max(torque, -winding.torque_limit * cool), winding.torque_limit * cool)
        temperature += (winding.ambient + winding.heat * torque * torque - temperature) * winding.share
    if signals.saturates_last:
        torque = min(max(torque, -signals.saturation), signals.saturation)
    if signals.torque_step != 0.0:
        torque = round(torque / signals.torque_step) * signals.torque_step
    return new(ActingTorque, (torque, temperature))


def pass_frames(losses: Losses, place: CycleState, cycle: int) -> None:
    """Draw at random which frames of a SYNC are lost, and record the result in `place`."""
    if losses.to_drive:
        place.lost_to_drive = is_lost(losses, place.lost_to_drive, cycle * TICKS + 1)
        place.is_synced = not place.lost_to_drive
    place.is_heard = place.is_synced
    if losses.to_master and place.is_synced:
        place.lost_to_master = is_lost(losses, place.lost_to_master, cycle * TICKS + 2)
        place.is_heard = not place.lost_to_master
    if losses.to_drive:
        place.lost_to_drive = is_lost(losses, place.lost_to_drive, cycle * TICKS + 3)
        place.is_sent = not place.lost_to_drive


def is_lost(losses: Losses, was_lost: bool, tick: int) -> bool:
    """Return whether a frame is lost."""
    return uniform(losses.seed, tick) < (losses.after_lost if was_lost else losses.after_heard)


def step(*_kernel: Any) -> Any:
    """Placeholder of an algorithm's step (`Kernel.step`); the caller of `run_loop` binds one."""
    raise NotImplementedError


def run_loop(
    control: Control, loops: Loops, motors: LinearMotors, room: Room, place: CycleState, watched: object,
    meter: Meter, cycles: int,
) -> bool:  # fmt: skip
    """Run a loop until its last SYNC or until it diverges; a number that is not finite counts as divergence.

    Args:
        control: Controller in the form of `respond`, at rest.
        loops: Properties of the loop between each motor and the controller.
        motors: Motors in the form of `move_motors`, at their start.
        room: Buffers of zeros.
        place: State of the loop, at its beginning.
        watched: What a replacement of `watch` takes.
        meter: What `take_sync` fills.
        cycles: Number of SYNCs.

    Returns:
        False where `move_motors` cannot move the motors any further.
    """
    each, losses = range(len(room.held)), loops[0].losses
    begin(loops, motors, room, each)
    for cycle in range(cycles):
        place.cycle = cycle
        if cycle and not move_motors(motors, room, each, cycle):
            return False
        total = see(loops, motors, room, place, each)
        watch(watched, room, meter, cycle)
        if cycle and losses.exists:
            pass_frames(losses, place, cycle)
        if not place.is_heard:
            miss_sync(control, loops, room, place, meter)
        elif isfinite(total):
            balance = respond(control, room, place)
            for i in each:
                total += room.commands[i]
            if isfinite(total):
                take_sync(control, loops, room, place, meter, balance)
        if not (isfinite(total) and hand_over(loops, room, place, each)):
            diverge(meter)
            break
    return True


def run_in_python(
    replaced: Mapping[object, object], control: object, loops: Loops, motors: object, watched: object, meter: object,
    cycles: int,
) -> int:  # fmt: skip
    """Run a loop in Python, with some functions replaced; return 0, or the SYNC to which its motors cannot be moved."""
    run, room, place = _bound_loop(tuple(replaced.items())), with_quick_fields(room_for(len(loops))), CycleState()
    return 0 if run(control, loops, motors, room, place, watched, meter, cycles) else place.cycle


@lru_cache(maxsize=64)
def _bound_loop(replaced: tuple[tuple[object, object], ...]) -> Callable[..., bool]:
    return bound(run_loop, dict(replaced))


def begin(loops: Loops, motors: LinearMotors, room: Room, each: range) -> None:
    """Set positions and temperatures at the first SYNC."""
    for i in each:
        room.temperatures[i] = loops[i].signals.winding.ambient
        room.true[i] = position_of(motors, i)


def see(loops: Loops, motors: LinearMotors, room: Room, place: CycleState, each: range) -> float:
    """Take the true positions, the work in the hold that ended, and what the encoders report of the positions.

    Returns:
        A number that is not finite if a reported position or a held torque is not.
    """
    total = work = 0.0
    for i in each:
        at, loop = position_of(motors, i), loops[i]
        moved = at - room.true[i]
        room.true[i], room.moved[i] = at, moved
        work += room.acting[i] * moved
        if isfinite(at):
            at = measured(loop, encoder(motors, i, loop.signals, place.cycle, at))
        room.seen[i] = at
        total += at + room.held[i]
    place.work = work_of(motors, place.work + work)
    return total


def hand_over(loops: Loops, room: Room, place: CycleState, each: range) -> bool:
    """Pass the commands to the drives, for this hold or, one sample late, for the next; return False out of range."""
    for i in each:
        loop = loops[i]
        if not loop.lowest < room.true[i] < loop.highest:
            return False
        torque = room.waiting[i] if loop.delay and place.is_synced else room.held[i]
        if place.is_sent:
            command = commanded(loop, room.commands[i])
            if loop.delay:
                room.waiting[i] = command
            else:
                torque = command
        room.held[i] = torque
        if loop.signals.on_torque:
            torque, room.temperatures[i] = acting(loop.signals, room.temperatures[i], torque)
        room.acting[i] = torque
    return True


def move_motors(motors: LinearMotors, room: Room, each: range, cycle: int) -> bool:
    """Move linear motors to a SYNC under `room.acting`; return True, since it cannot fail."""
    state, moved = motors.state, motors.moved
    for i in each:
        state[len(moved) + i] = room.acting[i]
    evaluate(motors.flow, state, moved)
    for row in range(len(moved)):
        state[row] = moved[row]
    return True


def position_of(motors: LinearMotors, i: int) -> float:
    """Return the true position of a motor [m or rad]."""
    return motors.state[motors.places[i]]


def encoder(motors: object, i: int, signals: Signals, cycle: int, position: float) -> float:
    """Return the position of a motor after the effects of its encoder [m or rad]."""
    if signals.noise > 0.0:
        position += noise(signals.noise, signals.seed, cycle * TICKS)
    if signals.encoder_step > 0.0:
        position = round(position / signals.encoder_step) * signals.encoder_step
    return position


def work_of(motors: object, work: float) -> float:
    """Return the work of the motors since the start [J]: the sum `work` of torque times displacement."""
    return work


def nothing(*_unused: object) -> None:
    """Replace a function of the loop by nothing."""


def watch(watched: object, room: Room, meter: object, cycle: int) -> None:
    """Do nothing; a replacement such as `watch_continuous` computes something more at a SYNC."""


def respond(control: Control, room: Room, place: CycleState) -> EnergyBalance:
    """Step the controller of an axis, and write its command; return the balance of the hold that ended."""
    balance: EnergyBalance = step(control.world, control.run, room.seen[0], room.held[0])
    room.commands[0] = balance.torque
    return balance


def take_sync(
    control: Control, loops: Loops, room: Room, place: CycleState, meter: Meter, balance: EnergyBalance
) -> None:
    """Add a SYNC to the figures."""
    held, of = room.held, loops[0].meter
    torque = held[0]
    square, largest = torque * torque, abs(torque)
    lose(of, meter, room.moved[0])
    for i in range(1, len(held)):
        lose(loops[i].meter, meter, room.moved[i])
        square += held[i] * held[i]
        largest, torque = max(largest, abs(held[i])), sqrt(square)
    received = place.supplied - place.work
    take_hold(control.world, of, meter, place.cycle, room.seen[0], room.true[0], torque, largest, received, balance)


def miss_sync(control: Control, loops: Loops, room: Room, place: CycleState, meter: Meter) -> None:
    """Add a SYNC whose position did not reach the controller of an axis."""
    control.run.state.axis.missed += 1
    received = place.supplied - place.work
    miss(control.world, loops[0].meter, meter, place.cycle, room.true[0], room.held[0], received)
