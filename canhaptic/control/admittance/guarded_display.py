"""`guarded` of an admittance display: a virtual mass whose every command is certified by the drive's own velocity loop.

The promise: E, the energy that came in through the sensor, never falls below -energy_allowance, for every hand. It
rests on what is declared of the drive (`velocity_loop`) and of the sensor (`port`), and on nothing about the hand.

Each SYNC: the hold that a force belongs to is booked with its doubt; W, what the drive can still give out safely, is
brought up to date by force and encoder, whichever proves more; the virtual mass moves on under the last force; its
speed is cut to the largest one certified, and the mass keeps the speed that is left; the account is then settled down
to what the mass, or the drive with the commands under way, can give back.

A drive with an integral is certified as long as its torque stays below its limit for certain; from the first hold on
in which it may not, nothing is certified any more and the account rests on the force alone.

Where the mass asked for is lighter than the drive carries safely, the hand feels a heavier one; nothing else changes.
"""

from dataclasses import dataclass, field
from typing import Annotated, ClassVar, NamedTuple

from canhaptic.control.admittance.display_controller import DisplayController
from canhaptic.control.admittance.display_mass import DisplayMass
from canhaptic.control.admittance.motion import (
    DisplayMemory,
    DisplayMotion,
    DisplayMotionSettings,
    accelerated,
    display_memory,
    limited,
    motion_settings,
    send,
    sent,
    whole,
)
from canhaptic.control.admittance.port import Port, PortSettings, begin_port, book, port_settings
from canhaptic.control.admittance.properties import DisplayProperties
from canhaptic.control.admittance.velocity_loop import (
    LoopState,
    VelocityLoopSettings,
    fastest,
    gained,
    loss_under_way,
    lost_unseen,
    may_limit,
    reserve,
)
from canhaptic.control.balance import AT_REST, Branch, Certificate, EnergyBalance
from canhaptic.control.passivity.settlement import settle
from canhaptic.errors import ParameterError
from canhaptic.kernels import Buffer, Kernel, MakeBuffer, new
from canhaptic.units import Parameters, quantity

_EXACT, _DEPLETED, _FREE = Branch.EXACT.value, Branch.DEPLETED.value, Branch.FREE.value
_UNBOUNDED, _BY_LOOP, _NONE = Certificate.EXACT.value, Certificate.VELOCITY_LOOP.value, Certificate.NONE.value


class GuardedDisplayParameters(Parameters):
    """Of an admittance display: what the certificate rests on."""

    drive_mass: Annotated[float, quantity("kg", "kg*m^2", gt=0.0, le=1e6)]
    """OVER-estimate of the mass that the drive moves up to the sensor."""
    loop_gain: Annotated[float, quantity("N*s/m", "N*m*s/rad", gt=0.0, le=1e9)]
    """OVER-estimate of the gain of the drive's velocity loop: 2 pi f M for a bandwidth of f."""
    integral_gain: Annotated[float, quantity("N/m", "N*m/rad", ge=0.0, le=1e12)] = 0.0
    """OVER-estimate of the loop's integral gain; of a position loop: its gain times `loop_gain`. 0: no integral."""
    spread: Annotated[float, quantity("1", ge=0.0, lt=1.0)] = 0.2
    """The gains are at least 1 - spread of what is declared."""
    energy_allowance: Annotated[float, quantity("J", ge=0.0)] = 0.0
    """Energy that may be given out before any came in: the promise becomes E >= -energy_allowance."""
    max_consecutive_losses: Annotated[int, quantity("count", ge=0, le=16)] = 0
    """Consecutive cycles without a new command at the drive that the certificate survives; only without an integral."""


@dataclass(frozen=True, slots=True)
class _GuardedSettings:
    """What is fixed for a run."""

    port: PortSettings
    motion: DisplayMotionSettings
    loop: VelocityLoopSettings
    allowance: float  # [J]


@dataclass(slots=True)
class _GuardedDisplayState:
    """What is remembered between two SYNCs."""

    axis: Port = field(default_factory=Port)
    motion: DisplayMotion = field(default_factory=DisplayMotion)
    loop: LoopState = field(default_factory=LoopState)
    h_s: float = 0.0  # [J]
    surplus: float = 0.0  # [J]
    taken: float = 0.0  # dissipated or leaked so far, and not paid [J]
    place: int = 0  # of this SYNC in the rings of the memory
    unsure: bool = False  # the drive may have reached its torque limit, so that its integral is no longer known


class GuardedMemory(NamedTuple):
    """Buffers of one axis; the last three are rings of the SYNCs whose forces have not come, shape (latency + 1,)."""

    display: DisplayMemory
    changes: Buffer  # of W in the hold that ended there [J]
    leads: Buffer  # [m or rad]
    margins: Buffer  # W with all that was taken before [J]


def settings_of(
    environment: DisplayMass, parameters: GuardedDisplayParameters, properties: DisplayProperties
) -> _GuardedSettings:
    """Returns what is fixed for a run.

    Raises:
        ParameterError: Losses are declared for a drive with an integral.
    """
    if parameters.integral_gain and parameters.max_consecutive_losses:
        raise ParameterError(
            f"guarded: max_consecutive_losses: got {parameters.max_consecutive_losses}, expected 0 with an "
            "integral_gain: a command that is lost leaves the integral of the drive unknown"
        )
    least = 1.0 - parameters.spread
    loop = VelocityLoopSettings(
        properties.sample_time, properties.delay, parameters.max_consecutive_losses, parameters.drive_mass,
        parameters.loop_gain, parameters.loop_gain * least, parameters.integral_gain, parameters.integral_gain * least,
        properties.encoder_count, properties.torque_limit,
    )  # fmt: skip
    motion = motion_settings(environment, properties, parameters.drive_mass / (parameters.loop_gain * least))
    return _GuardedSettings(port_settings(properties), motion, loop, parameters.energy_allowance)


def memory_of(settings: _GuardedSettings, make_buffer: MakeBuffer) -> GuardedMemory:
    """Returns the buffers of one axis."""
    kept, length = settings.loop.delay + settings.loop.losses + 2, settings.port.latency + 1
    display = display_memory(settings.port, kept, make_buffer)
    return GuardedMemory(display, make_buffer(length), make_buffer(length), make_buffer(length))


def step(
    environment: DisplayMass,
    settings: _GuardedSettings,
    state: _GuardedDisplayState,
    memory: GuardedMemory,
    position: float,
    torque_applied: float,
) -> EnergyBalance:
    """Accounts for the hold that ended; see `Controller.step`. `torque_applied` is minus the force of the sensor."""
    motion, loop, commands, force = state.motion, state.loop, memory.display.commands, -torque_applied
    if not state.axis.started:
        begin_port(state.axis, memory.display.positions, position, force)
        return AT_REST
    h_i, velocity = _take(settings, state, memory, position, force)
    wish = accelerated(environment, settings.motion, motion.speed, force, position)
    wish = limited(settings.motion, motion, commands, wish, position, velocity)
    sign = 1.0 if wish >= 0.0 else -1.0
    most = fastest(settings.loop, loop, commands, motion, loop.margin + settings.allowance, sign)
    certificate = _UNBOUNDED
    if abs(wish) > most:
        wish, certificate = sign * most, _BY_LOOP
    before = motion.speed
    send(motion, commands, whole(settings.motion, wish))
    speed = abs(velocity) + settings.port.acceleration * settings.port.sample_time
    limits = may_limit(settings.loop, loop.lead, velocity, motion.speed, settings.port.acceleration)
    state.unsure = state.unsure or limits
    if state.unsure:
        certificate = _NONE
    h_s, h_r, deficit, leak, paid = _settle(environment, settings, state, memory, h_i, before, speed)
    branch = _DEPLETED if deficit > 0.0 else _FREE if motion.speed == 0.0 and before == 0.0 else _EXACT
    return new(EnergyBalance, (
        motion.speed, h_i, 0.0, h_i, h_r, h_s, state.surplus, 0.0, deficit, leak, paid, branch, environment.damping,
        certificate, environment.stretch(position),
    ))  # fmt: skip


def miss(settings: _GuardedSettings, state: _GuardedDisplayState, memory: GuardedMemory) -> float:
    """Takes a SYNC of which no sample came; returns the command [m/s or rad/s].

    Without an integral the last command goes on as long as it is certified without knowing what it did; with one the
    command is 0 at once, and all that was under way counts as lost.
    """
    port, motion, loop, commands = state.axis, state.motion, state.loop, memory.display.commands
    acted = sent(motion, commands, settings.loop.delay)
    if settings.loop.integral > 0.0:
        change = 0.0 if port.missed else -loss_under_way(settings.loop, loop.lead, commands, motion)
        loop.lead += acted * settings.port.sample_time
    else:
        change = -lost_unseen(settings.loop, commands, motion)
    port.missed += 1
    loop.margin += change
    _keep(state, memory, change)
    speed = 0.0
    if settings.loop.integral == 0.0:
        sign = 1.0 if motion.speed >= 0.0 else -1.0
        most = fastest(settings.loop, loop, commands, motion, loop.margin + settings.allowance, sign)
        speed = sign * min(abs(motion.speed), most)
    send(motion, commands, whole(settings.motion, speed))
    return motion.speed


def _take(
    settings: _GuardedSettings, state: _GuardedDisplayState, memory: GuardedMemory, position: float, force: float
) -> tuple[float, float]:
    """Books the hold that ended and brings W up to date; returns (h_i [J], mean velocity [m/s or rad/s])."""
    port, loop, motion, commands = state.axis, state.loop, state.motion, memory.display.commands
    missed = port.missed
    hold = book(settings.port, port, memory.display.positions, position, force)
    if not missed:
        change = gained(settings.loop, loop.lead, commands, motion, hold.moved)
    else:  # with an integral all is deducted by now
        change = 0.0 if settings.loop.integral > 0.0 else -lost_unseen(settings.loop, commands, motion)
    loop.lead += sent(motion, commands, settings.loop.delay) * settings.port.sample_time - hold.moved
    loop.margin += change
    _keep(state, memory, change)
    if not hold.is_booked:
        return 0.0, hold.moved / hold.elapsed
    length, then = len(memory.changes), state.place + 1
    then = then if then < length else 0  # the oldest: the SYNC that the force belongs to
    since = 0.0
    for place in range(length):
        if place != then:
            since += memory.changes[place]
    free = state.h_s - state.surplus
    late = free + hold.energy
    if state.unsure:
        return hold.energy, hold.moved / hold.elapsed
    loop.margin = max(loop.margin, late - reserve(settings.loop, memory.leads[then], hold.speed) + since)
    if then == state.place:
        memory.margins[then] = loop.margin + state.taken
    return max(late, memory.margins[then] - state.taken) - free, hold.moved / hold.elapsed


def _keep(state: _GuardedDisplayState, memory: GuardedMemory, change: float) -> None:
    """Keeps what is known at this SYNC until its force comes."""
    state.place = state.place + 1 if state.place + 1 < len(memory.changes) else 0
    memory.changes[state.place] = change
    memory.leads[state.place] = state.loop.lead
    memory.margins[state.place] = state.loop.margin + state.taken


def _settle(
    environment: DisplayMass,
    settings: _GuardedSettings,
    state: _GuardedDisplayState,
    memory: GuardedMemory,
    h_i: float,
    before: float,
    speed: float,
) -> tuple[float, float, float, float, float]:
    """Dissipates and leaks what neither the mass nor the drive can give back; returns (h_s, h_r, deficit, leak, paid).

    Args:
        environment: What is rendered.
        settings: Of the run.
        state: Its store, surplus and W change.
        memory: Of the axis.
        h_i: That came in [J].
        before: Command before the newest [m/s or rad/s].
        speed: Largest of the handle now [m/s or rad/s].
    """
    loop, motion, commands = state.loop, state.motion, memory.display.commands
    under_way = loss_under_way(settings.loop, loop.lead, commands, motion)
    squares = 0.0
    for command in commands:
        square = command * command
        squares = square if square > squares else squares
    kept = 0.5 * environment.mass * squares + environment.potential(state.axis.position)
    ceiling = max(kept, reserve(settings.loop, loop.lead, speed) + under_way)
    lost = environment.damping * before * before * settings.port.sample_time
    slack = loop.margin + settings.allowance - under_way
    h_s, surplus, h_r, deficit, leak, paid = settle(state.h_s + h_i, state.surplus, lost, ceiling, slack)
    taken = h_r + leak - paid
    loop.margin -= taken
    state.taken += taken
    state.h_s, state.surplus = h_s, surplus
    return h_s, h_r, deficit, leak, paid


class GuardedDisplay(DisplayController):
    """A virtual mass with the certificate of the drive's velocity loop."""

    parameters_type: ClassVar[type[Parameters]] = GuardedDisplayParameters
    kernel: ClassVar[Kernel] = Kernel(settings_of, _GuardedDisplayState, memory_of, step)

    def __init__(self, environment: DisplayMass, parameters: GuardedDisplayParameters, loop: DisplayProperties) -> None:
        super().__init__(environment, parameters, loop)
        self.max_consecutive_losses = parameters.max_consecutive_losses

    def _command_unseen(self) -> float:
        return miss(self._settings, self._state, self._memory)
