"""`guarded` of an admittance display: a virtual mass whose every command is certified by the drive's own velocity loop.

The promise: E, the energy that came in through the sensor, never falls below -energy_allowance, for every hand. It
rests on the declarations of the drive (`velocity_loop`) and of the sensor (`port`), and on nothing about the hand.

Each SYNC: the hold of a received force is booked with its uncertainty; W, the energy that the drive can still give
out safely, is updated by force and encoder, whichever proves more; the virtual mass advances under the last force; its
speed is reduced to the largest certified one, and the mass keeps that speed; the account is then reduced to what the
mass, or the drive with the queued commands, can give back.

A drive with an integral is certified as long as its torque is certain to stay below its limit; from the first hold on
in which it may reach the limit, nothing is certified any more and the account rests on the force alone.

Where a largest force of the hand is declared (`largest_hand_force`), or the hand as a spring with damper and mass
(`hand_stiffness`), a command may rest on that instead: see `hand_force` and `declared_hand`.

Where the mass asked for is lighter than the drive carries safely, the hand feels a heavier one; nothing else changes.

Constants and state of `guarded` of an admittance display.
"""

from dataclasses import dataclass, field
from math import inf
from typing import ClassVar, NamedTuple

from canhaptic.control.admittance import declared_hand
from canhaptic.control.admittance.admittance_controller import AdmittanceController
from canhaptic.control.admittance.admittance_environment import (
    AdmittanceEnvironment,
    AdmittanceMemory,
    AdmittanceMotion,
    AdmittanceMotionSettings,
    display_memory,
    limited,
    motion_settings,
    send,
    sent,
    whole,
)
from canhaptic.control.admittance.declared_hand import (
    DeclaredHand,
    DeclaredHandSettings,
    HandForceSettings,
    HeardForce,
    fastest_for_hand,
    held_back,
    lost_to_hand,
    used_by_hand,
)
from canhaptic.control.admittance.force_evidence import (
    ROUNDING,
    LateMargin,
    MarginMemory,
    MomentumCheck,
    contradiction,
    fall,
    known_then,
    margin_memory,
    momentum_check,
    moved_hold,
    oldest,
    rise,
)
from canhaptic.control.admittance.port import (
    AdmittanceProperties,
    Port,
    PortSettings,
    begin_port,
    book,
    port_settings,
    reopen,
)
from canhaptic.control.admittance.velocity_loop import (
    GuardedAdmittanceParameters,
    LoopState,
    VelocityLoopSettings,
    fastest,
    gained,
    loop_settings,
    loss_of_skip,
    loss_under_way,
    lost_unseen,
    may_limit,
    reserve,
)
from canhaptic.control.balance import AT_REST, Branch, Certificate, EnergyBalance
from canhaptic.control.passivity.stepped import settle
from canhaptic.errors import ForceContradictedError
from canhaptic.kernels import Buffer, Kernel, MakeBuffer, Run, new
from canhaptic.units import Parameters


@dataclass(frozen=True, slots=True)
class GuardedAdmittanceSettings:
    """Constants of a run."""

    port: PortSettings
    motion: AdmittanceMotionSettings
    loop: VelocityLoopSettings
    hand: HandForceSettings
    declared: DeclaredHandSettings
    allowance: float  # [J]
    may_be_limited: bool  # a torque at its limit would void the proof


@dataclass(slots=True)
class GuardedAdmittanceState:
    """State kept from SYNC to SYNC."""

    axis: Port = field(default_factory=Port)
    motion: AdmittanceMotion = field(default_factory=AdmittanceMotion)
    loop: LoopState = field(default_factory=LoopState)
    margin: LateMargin = field(default_factory=LateMargin)  # E - V
    hand: LateMargin = field(default_factory=LateMargin)  # E - G
    declared: DeclaredHand = field(default_factory=DeclaredHand)
    h_s: float = 0.0  # [J]
    surplus: float = 0.0  # [J]
    taken: float = 0.0  # dissipated or leaked so far, and not paid [J]
    limited: int = 0  # SYNCs for which a force may belong to a hold in which the drive was at its torque limit
    uncertainty: bool = False  # it may have done so where a certificate rested on that it does not
    by_encoder: float = 0.0  # E - V by encoder and commands alone, at least [J]
    by_force: float = 0.0  # E by the force, at most [J]


class GuardedMemory(NamedTuple):
    """Buffers of one axis."""

    display: AdmittanceMemory
    margin: MarginMemory
    hand: MarginMemory
    leads: Buffer  # a ring like those of the margins [m or rad]
    speeds: Buffer  # another, of the motion that the commands make [m/s or rad/s]


def settings_of(
    environment: AdmittanceEnvironment, parameters: GuardedAdmittanceParameters, properties: AdmittanceProperties
) -> GuardedAdmittanceSettings:
    """Constants of a run.

    Raises:
        ParameterError: A hand or losses are declared where their proof does not hold.
    """
    loop = loop_settings(parameters, properties)
    motion = motion_settings(environment, properties, loop.mass / loop.gain_least)
    hand = HandForceSettings(parameters.largest_hand_force)
    declared = declared_hand.declared_hand_settings(parameters, loop, properties.latency)
    ends = loop.integral > 0.0 or hand.force > 0.0 or declared.stiffness > 0.0
    return GuardedAdmittanceSettings(
        port_settings(properties), motion, loop, hand, declared, parameters.energy_allowance, ends
    )


def memory_of(settings: GuardedAdmittanceSettings, make_buffer: MakeBuffer) -> GuardedMemory:
    """Return the buffers of one axis."""
    kept, late = settings.loop.delay + settings.loop.losses + 2, settings.port.latency
    kept += late if settings.declared.stiffness > 0.0 else 0
    display = display_memory(settings.port, settings.motion, kept, make_buffer)
    return GuardedMemory(
        display, margin_memory(late, make_buffer), margin_memory(late, make_buffer), make_buffer(late + 1),
        declared_hand.speeds_of(late, make_buffer),
    )  # fmt: skip


_EXACT, _DEPLETED, _FREE = Branch.EXACT.value, Branch.DEPLETED.value, Branch.FREE.value
_UNBOUNDED, _NONE = Certificate.EXACT.value, Certificate.NONE.value
_BY_LOOP, _BY_HAND = Certificate.VELOCITY_LOOP.value, Certificate.LARGEST_HAND_FORCE.value
_BY_DECLARED = Certificate.DECLARED_HAND.value


def step(
    environment: AdmittanceEnvironment,
    run: Run[GuardedAdmittanceSettings, GuardedAdmittanceState, GuardedMemory],
    position: float,
    torque_applied: float,
) -> EnergyBalance:
    """Account for the hold that ended; see `Controller.step`. `torque_applied` is minus the force of the sensor."""
    settings, state, memory = run.settings, run.state, run.memory
    motion, commands, force = state.motion, memory.display.commands, -torque_applied
    inner, time = memory.display.inner, settings.motion.sample_time
    if not state.axis.started:
        begin_port(state.axis, memory.display.positions, position, force)
        state.uncertainty = settings.loop.integral > 0.0 and settings.port.jitter > 0.0  # its integral is then unknown
        return AT_REST
    h_i, velocity = _take(settings, state, memory, position, force)
    before = motion.speed
    request = environment.speed_after(inner, before, force, position, time)
    request = limited(settings.motion, motion, commands, request, position, velocity)
    request, certificate = _certified(settings, state, commands, request)
    send(motion, commands, whole(settings.motion, request))
    environment.go_along(inner, before, motion.speed, time)
    speed = abs(velocity) + settings.port.acceleration * time
    _watch_limit(settings, state, commands)
    if state.uncertainty:
        certificate = _NONE
    h_s, h_r, deficit, leak, paid = _settle(environment, settings, state, memory, h_i, before, speed)
    branch = _DEPLETED if deficit > 0.0 else _FREE if motion.speed == 0.0 and before == 0.0 else _EXACT
    return new(EnergyBalance, (
        motion.speed, h_i, 0.0, h_i, h_r, h_s, state.surplus, 0.0, deficit, leak, paid, branch, environment.damping,
        certificate, environment.stretch(position),
    ))  # fmt: skip


def _certified(
    settings: GuardedAdmittanceSettings, state: GuardedAdmittanceState, commands: Buffer, request: float
) -> tuple[float, int]:
    """Nearest certified speed [m/s or rad/s], and the certificate that reduced it."""
    sign = 1.0 if request >= 0.0 else -1.0
    motion, budget = state.motion, state.margin.known + settings.allowance
    most = fastest(settings.loop, state.loop.lead, commands, motion, budget, sign)
    if abs(request) <= most:
        return request, _UNBOUNDED
    certificate = _BY_LOOP
    if settings.hand.force > 0.0:
        budget = state.hand.known + settings.allowance
        by_hand = fastest_for_hand(settings.hand, settings.loop, commands, motion, budget)
        if abs(request) <= by_hand:
            return request, _BY_HAND
        if by_hand > most:
            most, certificate = by_hand, _BY_HAND
    if settings.declared.stiffness > 0.0:
        by_declared = declared_hand.fastest_for_declared(
            settings.declared, settings.loop, state.declared, commands, motion, request, settings.allowance
        )
        if by_declared > most:
            most, certificate = by_declared, _BY_DECLARED
    return sign * most, certificate


def _watch_limit(settings: GuardedAdmittanceSettings, state: GuardedAdmittanceState, commands: Buffer) -> None:
    """Determine whether the torque may reach its limit under the newest command; end the certificates that this voids.

    The loop without an integral may certify all that is under way: a torque at its limit then ends nothing.
    """
    loop, port = settings.loop, state.axis
    if not settings.may_be_limited or not may_limit(loop, state.loop, state.motion.speed, port.missed):
        return
    state.limited = loop.delay + 1 + loop.losses + settings.port.latency
    if loop.integral > 0.0:
        state.uncertainty = True
    elif not state.uncertainty:
        under_way = loss_under_way(loop, 0.0, commands, state.motion)
        state.uncertainty = under_way > state.margin.known + settings.allowance


def miss(
    environment: AdmittanceEnvironment,
    settings: GuardedAdmittanceSettings,
    state: GuardedAdmittanceState,
    memory: GuardedMemory,
) -> float:
    """Handle a SYNC without a sample; return the command [m/s or rad/s].

    Without an integral the last command continues as long as it is certified for any motion in the hold; with one the
    command is 0 at once, and all queued commands count as lost.
    """
    motion, loop, commands = state.motion, state.loop, memory.display.commands
    if settings.loop.integral == 0.0:
        change = -lost_unseen(settings.loop, commands, motion)
    else:
        change = 0.0 if state.axis.missed else -loss_under_way(settings.loop, loop.lead, commands, motion)
    _let_pass(settings, state, memory, change)
    before, speed = motion.speed, 0.0
    if settings.loop.integral == 0.0:
        speed, _ = _certified(settings, state, commands, before)
    send(motion, commands, whole(settings.motion, speed))
    environment.go_along(memory.display.inner, before, motion.speed, settings.motion.sample_time)
    _watch_limit(settings, state, commands)
    return motion.speed


def skip(
    environment: AdmittanceEnvironment,
    settings: GuardedAdmittanceSettings,
    state: GuardedAdmittanceState,
    memory: GuardedMemory,
    skipped: int,
) -> None:
    """Account for skipped SYNCs: no command was sent, and the queued one acted longer."""
    loop, motion, commands = settings.loop, state.motion, memory.display.commands
    if loop.integral > 0.0:
        state.uncertainty = state.uncertainty or state.axis.missed > 0
        first, further = -loss_of_skip(loop, state.loop.lead, commands, motion, skipped), 0.0
    else:
        first = further = -lost_unseen(loop, commands, motion)
    for number in range(skipped):
        _let_pass(settings, state, memory, further if number else first)
        environment.go_along(memory.display.inner, motion.speed, motion.speed, settings.motion.sample_time)
    _watch_limit(settings, state, commands)


def _let_pass(
    settings: GuardedAdmittanceSettings, state: GuardedAdmittanceState, memory: GuardedMemory, change: float
) -> None:
    """Account for a hold without a sample, in which the margin changed by at least this amount [J]."""
    acted = sent(state.motion, memory.display.commands, settings.loop.delay)
    state.loop.lead += acted * settings.port.sample_time
    state.axis.missed += 1
    state.by_encoder += change
    _fall(settings, state, memory, change)


def _take(
    settings: GuardedAdmittanceSettings, state: GuardedAdmittanceState, memory: GuardedMemory,
    position: float, force: float,
) -> tuple[float, float]:  # fmt: skip
    """Book the hold that ended and update W; return (h_i [J], mean velocity [m/s or rad/s])."""
    port, loop, motion, commands = state.axis, state.loop, state.motion, memory.display.commands
    missed, origin, heard = port.missed, port.origin, port.force
    at_limit = state.limited > 0
    hold = book(settings.port, port, memory.display.positions, position, force)
    if not missed:
        change = gained(settings.loop, loop.lead, commands, motion, hold.moved)
    else:  # with an integral all is deducted by now
        change = 0.0 if settings.loop.integral > 0.0 else -lost_unseen(settings.loop, commands, motion)
    loop.lead += sent(motion, commands, settings.loop.delay) * settings.port.sample_time - hold.moved
    _fall(settings, state, memory, change)
    state.by_encoder += change
    loop.velocity = velocity = hold.moved / hold.elapsed
    loop.holds = missed + 1
    if not hold.is_booked:
        return 0.0, velocity
    if state.by_force == 0.0:  # the handle may have moved already
        state.by_encoder -= reserve(settings.loop, 0.0, hold.speed + settings.port.acceleration * hold.elapsed)
    state.by_force += hold.most
    free = state.h_s - state.surplus
    late = free + hold.energy
    if state.uncertainty:
        return hold.energy, velocity
    if settings.declared.stiffness > 0.0:
        acted = sent(motion, commands, settings.declared.holds)
        said = new(HeardForce, (late, port.origin - origin, acted, port.force, port.force - heard, at_limit))
        declared_hand.hear(settings.declared, settings.loop, settings.port, state.declared, memory.speeds, said)
    then = oldest(state.margin, memory.margin)
    rise(state.margin, memory.margin, then, late - reserve(settings.loop, memory.leads[then], hold.speed), state.taken)
    if settings.hand.force > 0.0:
        kept = held_back(settings.hand, settings.loop, hold.speed)
        rise(state.hand, memory.hand, oldest(state.hand, memory.hand), late - kept, state.taken)
    proved = memory.margin.before[then] - state.taken
    if proved <= late:
        return late - free, velocity
    reopen(port)
    return proved - free, velocity


def _fall(
    settings: GuardedAdmittanceSettings, state: GuardedAdmittanceState, memory: GuardedMemory, change: float
) -> None:
    """Update the margins for the hold that ended, and record the state of this SYNC for its force."""
    fall(state.margin, memory.margin, change, state.taken)
    memory.leads[state.margin.place] = state.loop.lead
    if settings.hand.force > 0.0:
        lost = lost_to_hand(settings.hand, settings.loop, memory.display.commands, state.motion)
        fall(state.hand, memory.hand, -inf if state.limited > settings.port.latency else -lost, state.taken)
    state.limited = max(0, state.limited - 1)
    if settings.declared.stiffness > 0.0:
        acted = sent(state.motion, memory.display.commands, settings.loop.delay)
        declared_hand.go_on(settings.declared, state.declared, memory.speeds, acted)


def _settle(
    environment: AdmittanceEnvironment,
    settings: GuardedAdmittanceSettings,
    state: GuardedAdmittanceState,
    memory: GuardedMemory,
    h_i: float,
    before: float,
    speed: float,
) -> tuple[float, float, float, float, float]:
    """Dissipate and leak what neither the mass nor the drive can give back; return (h_s, h_r, deficit, leak, paid).

    Where h_i [J] came in, `before` was the command before the newest and `speed` is the handle's largest now.
    """
    loop, motion, commands = state.loop, state.motion, memory.display.commands
    under_way = loss_under_way(settings.loop, loop.lead, commands, motion)
    ceiling, largest = reserve(settings.loop, loop.lead, speed) + under_way, 0.0
    if state.h_s + h_i > ceiling:
        for command in commands:
            if command * command > largest * largest:
                largest = command
        kept = environment.stored(memory.display.inner, largest, state.axis.position)
        ceiling = kept if kept > ceiling else ceiling
    lost = environment.damping * before * before * settings.port.sample_time
    slack = state.margin.known + settings.allowance - under_way
    if settings.hand.force > 0.0:
        by_hand = used_by_hand(settings.hand, settings.loop, commands, motion)
        slack = max(slack, state.hand.known + settings.allowance - by_hand)
    if settings.declared.stiffness > 0.0:
        used = declared_hand.used_by_declared(settings.declared, settings.loop, state.declared, commands, motion)
        slack = max(slack, state.declared.known + settings.allowance - used)
    h_s, surplus, h_r, deficit, leak, paid = settle(state.h_s + h_i, state.surplus, lost, ceiling, slack)
    taken = h_r + leak - paid
    state.margin.known -= taken
    state.hand.known -= taken
    state.declared.known -= taken
    state.taken += taken
    state.h_s, state.surplus = h_s, surplus
    return h_s, h_r, deficit, leak, paid


class GuardedAdmittance(AdmittanceController):
    """A virtual mass with the certificate of the drive's velocity loop."""

    parameters_type: ClassVar[type[Parameters]] = GuardedAdmittanceParameters
    kernel: ClassVar[Kernel] = Kernel(settings_of, GuardedAdmittanceState, memory_of, step)

    def __init__(
        self, environment: AdmittanceEnvironment, parameters: GuardedAdmittanceParameters, loop: AdmittanceProperties
    ) -> None:
        super().__init__(environment, parameters, loop)
        self.max_consecutive_losses = parameters.max_consecutive_losses
        self.energy_allowance = parameters.energy_allowance
        self._check = momentum_check(parameters, self._settings.port, self._settings.loop)

    def step(self, position: float, torque_applied: float) -> EnergyBalance:
        """Account for the hold that ended; see `Controller.step`.

        Raises:
            ControlError: A force, position or velocity is not finite.
            ForceContradictedError: The force sensor contradicts the encoder.
        """
        before, state = self._axis.missed or not self._axis.started, self._state
        balance = super().step(position, torque_applied)
        if self._check is not None:
            self._compare(self._check, -torque_applied, is_first=bool(before))
        at_force = known_then(state.by_encoder, state.margin, self._memory.margin)  # more may have come in since
        if at_force > state.by_force + ROUNDING and not state.uncertainty:
            error = ForceContradictedError(contradiction("force sensor", state.by_force, state.by_encoder))
            self.reset()
            raise error
        return balance

    def _compare(self, check: MomentumCheck, force: float, *, is_first: bool) -> None:
        """Compare force and motion; raise ForceContradictedError."""
        state, loop = self._state, self._settings.loop
        if is_first or state.uncertainty:
            check.begin(state.axis.position, force, state.loop.lead)
            return
        hold = moved_hold(loop, state.motion, self._memory.display.commands, state.axis.moved, state.loop.lead)
        found = check.take(hold, force)
        if found is not None:
            self.reset()
            raise ForceContradictedError(found.text())

    def lasted(self, periods: float) -> None:
        """Count skipped SYNCs; a run with one is not certified."""
        if self._axis.started:
            skip(self._environment, self._settings, self._state, self._memory, round(periods) - 1)

    def sample_lost(self) -> EnergyBalance:
        """Answer a SYNC without a sample; see `Controller.sample_lost`."""
        balance = super().sample_lost()
        return balance._replace(certificate=_NONE) if self._state.uncertainty else balance

    def _command_unseen(self) -> float:
        return miss(self._environment, self._settings, self._state, self._memory)
