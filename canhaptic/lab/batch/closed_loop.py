"""One plant and one controller in one loop, from SYNC to SYNC: a kernel, and its parts shared with other loops.

The order and the rounding are those of `direct_rig.DirectRig` and `canhaptic.lab.loop.axis_loop.render`. A linear
plant moves by the exact flow of one hold, its rows summed term by term; for one with events `event_plant` takes its
place.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import inf, isfinite
from typing import Any, Final, NamedTuple, Protocol, TypeAlias

from canhaptic.control.balance import EnergyBalance
from canhaptic.control.environments.environment import Environment
from canhaptic.control.passivity.hold_account import Axis
from canhaptic.kernels import Buffer, Run, new
from canhaptic.lab.batch.meter import Meter, MeterSettings, compare, diverge, miss, take
from canhaptic.lab.batch.reference_kernel import (
    ReferenceMemory,
    ReferenceSettings,
    ReferenceState,
    follow,
)
from canhaptic.sim.plant.effects.encoder_noise import noise, uniform
from canhaptic.sim.plant.propagator import TICKS

MOVED: Final = 0
"""What `move_plant` returns of a hold that is over; else the run stops there and may go on from its `Interruption`."""


@dataclass(frozen=True, slots=True)
class Winding:
    """A winding with thermal protection; see `thermal_derating`."""

    torque_limit: float = inf  # of the cold winding [N or N*m]; infinite: none
    heat: float = 0.0  # final temperature above ambient over torque squared
    ambient: float = 0.0  # [K]
    hot: float = 1.0  # [K]
    span: float = 1.0  # from warm to hot [K]
    share: float = 0.0  # of the way to the final temperature in one hold


@dataclass(frozen=True, slots=True)
class Signals:
    """Effects of a plant on the encoder reading, and on a torque before it reaches the motor."""

    noise: float = 0.0  # standard deviation of a reading [m or rad]
    seed: int = 0  # of the noise
    encoder_step: float = 0.0  # of readings; 0: none [m or rad]
    on_torque: bool = False  # whether any of what follows is there
    saturation: float = inf  # of the torque [N or N*m]
    saturates_last: bool = False  # behind the winding
    torque_step: float = 0.0  # 0: none [N or N*m]
    winding: Winding = field(default_factory=Winding)


@dataclass(frozen=True, slots=True)
class Losses:
    """Frames that a bus loses, singly or in runs (two states, good and lossy, for each direction)."""

    exists: bool = False
    after_heard: float = 0.0  # share that is lost behind a received frame
    after_lost: float = 0.0  # behind one that was lost
    to_drive: bool = False  # SYNCs and torques
    to_master: bool = False  # positions
    seed: int = 0


@dataclass(frozen=True, slots=True)
class LoopSettings:
    """Properties of the loop between plant and controller."""

    delay: int = 0  # whole holds between computing a torque and its hold, 0 or 1
    counts_per_unit: float = 0.0  # of the encoder; 0: ideal
    torque_quantum: float = 0.0  # step of the command; 0: ideal [N or N*m]
    torque_limit: float = inf  # of the drive [N or N*m]
    furthest: float = inf  # distance from the origin that counts as divergence [m or rad]
    meter: MeterSettings = field(default_factory=MeterSettings)
    signals: Signals = field(default_factory=Signals)
    losses: Losses = field(default_factory=Losses)


@dataclass(slots=True)
class Interruption:
    """State of an interrupted loop, apart from its plant."""

    cycle: int = 0
    held: float = 0.0  # since the SYNC before [N or N*m]
    waiting: float = 0.0  # one sample late
    acting: float = 0.0  # what of `held` reaches the motor
    interaction: float = 0.0  # true energy that came in [J]
    temperature: float = 0.0  # of the winding [K]
    command: float = 0.0  # last of the controller [N or N*m]
    is_synced: bool = True  # whether the drive received the last SYNC,
    is_heard: bool = True  # the master its position,
    is_sent: bool = True  # and the drive the command after it
    lost_to_drive: bool = False  # last frame in that direction
    lost_to_master: bool = False


class AxisState(Protocol):
    """State of the axis in every algorithm."""

    axis: Axis


AxisRun: TypeAlias = Run[Any, AxisState, Any]
"""What the kernel of any algorithm of one axis works on."""


class LinearPlant(NamedTuple):
    """A plant that moves by one flow."""

    flow: Sequence[Sequence[float]]  # over one hold, shape (states, states + 2)
    state: Buffer  # [states..., torque, 1]; the first state is the position [m or rad]
    moved: Buffer  # buffer for the states, shape (states,)


class LinearPlants(NamedTuple):
    """The plants of many loops, each of which moves by its own flow."""

    flows: Any  # shape (n, states, states + 2), n = 1 where all have the same
    starts: Any  # shape (n, states + 2)
    state: Buffer
    moved: Buffer


def begin_plant(plants: LinearPlants, row: int) -> None:
    """Reset the plant of a loop to its start."""
    start = plants.starts[row % len(plants.starts)]
    for place in range(len(plants.state)):
        plants.state[place] = start[place]


def plant_at(plants: LinearPlants, row: int) -> LinearPlant:
    """Return the plant of a loop."""
    return LinearPlant(plants.flows[row % len(plants.flows)], plants.state, plants.moved)


def measured(loop: LoopSettings, position: float) -> float:
    """Return a position as the encoder reports it [m or rad]."""
    if loop.counts_per_unit == 0.0:
        return position
    return round(position * loop.counts_per_unit) * (1.0 / loop.counts_per_unit)


def read(signals: Signals, cycle: int, position: float) -> float:
    """Return a position after the effects of the encoder [m or rad]."""
    if signals.noise > 0.0:
        position += noise(signals.noise, signals.seed, cycle * TICKS)
    if signals.encoder_step > 0.0:
        position = round(position / signals.encoder_step) * signals.encoder_step
    return position


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
    """Torque that the motor gives for a command [N or N*m] at a temperature of its winding [K]."""
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


def pass_frames(losses: Losses, place: Interruption, cycle: int) -> None:
    """Lose or pass the frames of a SYNC."""
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


def step(environment: Environment, run: AxisRun, position: float, torque_applied: float) -> EnergyBalance:
    """Kernel of an algorithm; the caller of `run_loop` supplies it."""
    raise NotImplementedError


def run_loop(
    environment: Environment,
    run: AxisRun,
    loop: LoopSettings,
    meter: Meter,
    plant: LinearPlant,
    place: Interruption,
    continuous: ReferenceSettings,
    reference: ReferenceState,
    reference_memory: ReferenceMemory,
    cycles: int,
) -> int:
    """Run a loop until its last SYNC or until it diverges; a number that is not finite counts as divergence.

    Args:
        environment: The rendered environment.
        run: Settings of the algorithm, its state at rest, and memory of zeros.
        loop: Properties of the loop between plant and controller.
        meter: Accumulates the figures.
        plant: Plant in the form of `move_plant`, at its start.
        place: State of the run: at its beginning, or where it was interrupted.
        continuous: Environment that the loop is compared with, if there is one.
        reference: Continuous run, before it begins.
        reference_memory: Memory of the continuous run, at the start.
        cycles: SYNCs.

    Returns:
        MOVED, or the result of `move_plant` for an incomplete hold.
    """
    for cycle in range(place.cycle, cycles):
        before = plant.state[0]
        if cycle:
            outcome = advance(loop, plant, place, cycle)
            if outcome != MOVED:
                return outcome
        true_position = plant.state[0]
        if continuous.exists:
            mean = follow(continuous, reference, reference_memory, cycle)
            compare(meter, true_position, place.held, reference_memory.state[0], mean)
        place.interaction = work_in(plant, place.interaction, place.acting, true_position - before)
        if loop.losses.exists and cycle:
            pass_frames(loop.losses, place, cycle)
        if not place.is_heard:
            run.state.axis.missed += 1
            miss(environment, loop.meter, meter, cycle, true_position, place.held, place.interaction)
        elif not answer(environment, run, loop, meter, place, true_position, cycle):
            diverge(meter)
            break
        if not -loop.furthest < true_position < loop.furthest:
            diverge(meter)
            break
        hand_over(loop, place)
    return MOVED


def advance(loop: LoopSettings, plant: LinearPlant, place: Interruption, cycle: int) -> int:
    """Move the plant to a SYNC; return the result of `move_plant`."""
    if place.cycle != cycle:
        place.acting = place.held
        if loop.signals.on_torque:
            place.acting, place.temperature = acting(loop.signals, place.temperature, place.held)
    outcome = move_plant(plant, place.acting, cycle)
    if outcome != MOVED:
        place.cycle = cycle
    return outcome


def answer(
    environment: Environment, run: AxisRun, loop: LoopSettings, meter: Meter, place: Interruption, true_position: float,
    cycle: int,
) -> bool:  # fmt: skip
    """Let the controller answer a SYNC; return False if its input or output is not finite."""
    held = place.held
    position = read(loop.signals, cycle, true_position)
    position = measured(loop, position) if isfinite(position) else position
    if not isfinite(position - run.state.axis.position + held):
        return False
    balance = step(environment, run, position, held)
    if not isfinite(balance.torque):
        return False
    take(environment, loop.meter, meter, cycle, position, true_position, held, place.interaction, balance)
    place.command = balance.torque
    return True


def hand_over(loop: LoopSettings, place: Interruption) -> None:
    """Send the command to the drive for the next free hold."""
    if loop.delay and place.is_synced:
        place.held = place.waiting
    if not place.is_sent:
        return
    command = commanded(loop, place.command)
    if loop.delay:
        place.waiting = command
    else:
        place.held = command


def states_in(moved: Buffer) -> int:
    """Return the number of states; compiled it is a constant, so that loops over them are unrolled."""
    return len(moved)


def move_plant(plant: LinearPlant, torque: float, cycle: int) -> int:
    """Move a linear plant to a SYNC under a constant torque [N or N*m]; return MOVED."""
    flow, state, moved = plant.flow, plant.state, plant.moved
    states = states_in(moved)
    state[states] = torque
    for row in range(states):
        factors, total = flow[row], 0.0
        for column in range(states + 2):
            total += factors[column] * state[column]
        moved[row] = total
    for row in range(states):
        state[row] = moved[row]
    return MOVED


def work_in(plant: LinearPlant, interaction: float, torque: float, travel: float) -> float:
    """Energy that has come in [J], after a hold of constant torque [N or N*m] over a displacement [m or rad]."""
    return interaction - torque * travel
