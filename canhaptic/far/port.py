"""The port to a far side: a spring to where the other side is, rendered with the energy of both sides and no more.

Energies since the start of a session [J]: H came in from the motor for certain, S was sent for good, R is the largest S
of the other side that arrived, W was given up. The tank E = H - S + R - W is the account of `guarded`, which grants
each torque. At every SYNC, with Q the most that the queued torques and the new one can take at any later instant,

    Q + (new part of S) <= E                                                                                   (1)

Q is at least 0, also where a hand is certain to bring energy in: S must not be sent before it has come. S only grows,
and nothing arrives before it was sent. So H >= S - R on each side, and H_A + H_B >= 0 for both, with any network
between them. What the device dissipates may pay for torques, as in `guarded`, but is never sent; both then hold for the
handles.

Totals are whole picojoules, which a float holds exactly up to 9 kJ.
"""

from dataclasses import dataclass, field, fields, replace
from math import inf, sqrt
from typing import ClassVar, Final, TypeAlias

from canhaptic.control.balance import Branch, Certificate, EnergyBalance
from canhaptic.control.certificates.certified_torque import Declared, look_for_turn, taken_under_way
from canhaptic.control.certificates.scalar_bounds import NO_RESPONSE, given_out
from canhaptic.control.passivity import LoopProperties, guarded
from canhaptic.control.passivity.asked_torque import AskedEffort, granted, settings_of_program
from canhaptic.control.passivity.guarded import book, certain_energy, end, start
from canhaptic.control.passivity.stepped import send
from canhaptic.far.parameters import FarParameters
from canhaptic.far.world_model import LED, SPRING, WorldState, forget, led_effort
from canhaptic.kernels import Kernel, Run, new
from canhaptic.signals import FarRow

PICO: Final = 1e-12
"""One picojoule, the unit of every total [J]."""
_FREE, _EXACT, _DEPLETED = Branch.FREE.value, Branch.EXACT.value, Branch.DEPLETED.value
_NOT_BOUND = Certificate.EXACT.value
IDLE, LINKED, LOST = 0, 1, 2
"""Phases of a port: no session; a session; a session that ended and whose torque has not come down yet."""
HOLD, DAMP, RELEASE = 0, 1, 2
"""What the port renders after its session ended."""
THEN: Final = {"hold": HOLD, "damp": DAMP, "release": RELEASE}
STARTS: Final = 0.4
"""Share of the level that a side must have earned before the model is rendered."""
_FADE: Final = 0.3
"""Time in which the model fades in [s]."""
_RELEASE: Final = 0.2
"""Time in which it fades out [s]."""
_NEARER: Final = 0.01
"""Share of the torque limit by which, in a hold, a wall comes nearer or the word of a program changes the torque."""
_ROUNDING: Final = 1e-9  # [N or N*m]
_ANY: Final = 0
_IS_READY, _IS_LINKED, _IS_STOPPING, _IS_BELOW, _IS_ABOVE, _IS_TO_POINT = (1 << bit for bit in range(6))
"""Flags of a `FarRow`."""
_UNDECLARED: Final = Declared(0.0, 0, 0, False, NO_RESPONSE, 0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class FarSettings(guarded.GuardedSettings):
    """Constants of a port to a far side during a run."""

    ahead: Declared = _UNDECLARED  # with the new torque queued too
    stiffness: float = 0.0  # of the spring to the far position [N/m or N*m/rad]
    model_damping: float = 0.0  # of it [N*s/m or N*m*s/rad]
    level: float = 0.0  # that a side earns before the link closes [J]
    earning_drag: float = 0.0  # by which it earns it [N*s/m or N*m*s/rad]
    most_owed: float = 0.0  # of R - S [pJ]
    most_gained: float = 0.0  # of R in a sample time [pJ]
    fade: float = 0.0  # of the model in a hold
    release: float = 0.0  # the same, out
    by_model: bool = False  # whether the wall that the other side has found is rendered, and not a spring
    by_world: bool = False  # whether what a program asks for is rendered
    slew: float = 0.0  # by which its word changes the effort in a hold [N or N*m]
    then: int = RELEASE
    to_rest: int = 2  # holds of zero torque after which none acts


@dataclass(slots=True)
class FarState(guarded.GuardedState):
    """State of a port to a far side; what arrived is set before each step."""

    received: float = 0.0  # largest total of the other side [pJ]
    wanted: float = 0.0  # largest total that it asked for [pJ]
    far_position: float = 0.0  # [m or rad]
    far_velocity: float = 0.0  # [m/s or rad/s]
    far_wall: float = 0.0  # wall that the other side has found [m or rad]
    far_side: float = 0.0  # on which it is of the wall: 1 below, -1 above; 0: it knows none; 2: a spring of a program
    far_ready: bool = False  # whether the other side has earned its start
    linked: bool = False  # whether a session is alive
    stopping: bool = False  # of this side or the other
    booked: float = 0.0  # part of `received` that is in the account: R [pJ]
    sent: float = 0.0  # S [pJ]
    request: float = 0.0  # total that this side wants to have received [pJ]
    given_up: float = 0.0  # W [J]
    asked: float = 0.0  # torque of the model before the guard [N or N*m]
    blend: float = 0.0  # share of the model that is rendered
    phase: int = IDLE
    plane: float = 0.0  # where the wall is rendered [m or rad]
    is_led: bool = False  # whether it is rendered
    damped: float = 0.0  # share of its damping that is rendered
    at_rest: int = 0  # holds of zero torque since the session ended
    cut: float = 0.0  # energy that arrived and the declared limits do not let in [J]
    world: WorldState = field(default_factory=WorldState)


FarRun: TypeAlias = Run[FarSettings, FarState, guarded.Memory]
"""Settings, state and memory of a port."""


def step(_environment: object, run: FarRun, position: float, torque_applied: float) -> EnergyBalance:
    """Book the hold that ended, and compute the next torque and what is sent; see `Controller.step`."""
    settings, state, memory = run.settings, run.state, run.memory
    axis = state.axis
    if not axis.started:
        return start(run, position)
    holds, open_before = axis.missed + axis.hold_length, state.bound.resolution
    unlike = memory.axis.commands.torques[axis.oldest] - torque_applied
    is_whole = holds == 1.0 and abs(unlike) <= 0.5 * settings.quantum + 1e-9
    displacement, _, _, uncertainty = end(run, position, torque_applied)
    reserved = 0.5 * (state.bound.resolution - open_before)
    if settings.turns:
        look_for_turn(settings.declared, state.bound, memory.bound, displacement, holds)
    supplied = gained(settings, state, holds)
    h_i = supplied - torque_applied * displacement - uncertainty  # eq. 2
    h_r, deficit, leak, paid = book(run, h_i, 0.0, 0.0, inf)
    moved, certificate = displacement / holds, _NOT_BOUND
    move_on(settings, state, position)
    torque = state.asked = asked_by_model(run, position, moved)
    if torque != 0.0:
        torque, certificate = granted(run, torque, moved)
    axis.oldest = send(memory.axis.commands, axis.oldest, torque, 0.0, 0.0)
    given, lost, settled = share(run, position, torque, is_whole)
    supplied, h_i, leak, paid = supplied - given, h_i - given, leak + lost, paid + settled
    if reserved:
        h_i, h_r = h_i + reserved, h_r + reserved
    branch = _DEPLETED if deficit > 0.0 else _EXACT if state.blend > 0.0 or torque != 0.0 else _FREE
    return new(EnergyBalance, (
        torque, h_i, 0.0, h_i, h_r, state.h_s, axis.h_dis, 0.0, deficit, leak, paid, branch, 0.0, certificate, 0.0,
        supplied,
    ))  # fmt: skip


def gained(settings: FarSettings, state: FarState, holds: float) -> float:
    """Return the energy that a hold brings from the far side [J]: R grows within the declared limits."""
    most = min(state.received, state.sent + settings.most_owed, state.booked + settings.most_gained * holds)
    state.cut = (state.received - most) * PICO
    if most <= state.booked:
        return 0.0
    energy = (most - state.booked) * PICO
    state.booked = most
    return energy


def move_on(settings: FarSettings, state: FarState, position: float) -> None:
    """Enter the phase of this SYNC, and fade the model in or out."""
    if state.phase == IDLE:
        if state.linked:
            state.phase = LINKED
        return
    if state.phase == LINKED and not state.linked:
        state.phase, state.at_rest = LOST, 0
        state.far_position, state.far_velocity = position, 0.0
        if settings.by_world:
            state.far_side = 0.0 if settings.then == RELEASE else SPRING
            state.world.stiffness = 0.0 if settings.then == DAMP else settings.stiffness
            state.world.damping = settings.model_damping
    if state.phase == LOST:
        if state.linked or state.stopping or settings.then == RELEASE:
            state.blend = max(0.0, state.blend - settings.release)
    elif state.blend > 0.0 or (state.far_ready and certain(state) >= STARTS * settings.level):
        state.blend = min(1.0, state.blend + settings.fade)


def certain(state: FarState) -> float:
    """Return the energy in the tank that the measurements prove [J], none of it dissipated by the device."""
    return certain_energy(state, state.h_s - state.axis.h_dis)


def stored_by_model(settings: FarSettings, state: FarState, position: float) -> float:
    """Return the energy of the model's spring [J]."""
    if settings.by_world:
        return state.blend * state.world.stored
    stretch = position - state.far_position
    if settings.by_model and state.phase == LINKED:
        stretch = max(0.0, state.far_side * (position - state.plane))
    return state.blend * 0.5 * settings.stiffness * stretch * stretch


def lead(settings: FarSettings, state: FarState, position: float) -> None:
    """Move the rendered wall to where the other side has found it, as the tank pays or as the hand leaves.

    One that appears or jumps over the hand starts at the hand, and its torque rises in small steps.
    """
    side, stiffness = state.far_side, settings.stiffness
    state.damped = min(1.0, state.damped + settings.fade) if state.is_led else 0.0
    if side != 0.0:
        plane = state.plane if state.is_led else position
        deep, wanted = max(0.0, side * (position - plane)), side * (position - state.far_wall)
        if wanted > deep:
            spare = max(0.0, certain(state) - 0.5 * stiffness * deep * deep) * LED
            most = sqrt(deep * deep + 2.0 * spare / stiffness)
            wanted = min(wanted, most, deep + _NEARER * settings.torque_limit / stiffness)
        state.plane = position - side * wanted
    state.is_led = side != 0.0


def effort_of_model(settings: FarSettings, state: FarState, position: float, velocity: float) -> float:
    """Return the effort of the spring to the other side, or of the wall that it has found [N or N*m]."""
    if settings.by_world:
        return led_effort(
            state.world, state.far_side, state.far_position, state.far_velocity, position, velocity,
            settings.sample_time, settings.torque_limit, settings.slew, certain(state),
        )  # fmt: skip
    if settings.by_model and state.phase == LINKED:
        lead(settings, state, position)
        deep = state.far_side * (position - state.plane)
        if deep <= 0.0:
            return 0.0
        size = settings.stiffness * deep + state.damped * settings.model_damping * state.far_side * velocity
        return state.far_side * size if size > 0.0 else 0.0
    stiffness = 0.0 if state.phase == LOST and settings.then == DAMP else settings.stiffness
    return stiffness * (position - state.far_position) + settings.model_damping * (velocity - state.far_velocity)


def asked_by_model(run: FarRun, position: float, moved: float) -> float:
    """Return the torque of the model [N or N*m], and of the drag by which a side earns what is lacking."""
    settings, state = run.settings, run.state
    if state.phase == IDLE:
        return 0.0
    velocity = moved / settings.sample_time
    if settings.longest_window:
        velocity = state.axis.window.velocity
    effort = state.blend * effort_of_model(settings, state, position, velocity)
    if state.phase == LINKED and not state.stopping:
        lacking = (state.wanted - state.sent) * PICO
        if state.blend == 0.0:
            lacking = max(lacking, settings.level - certain(state))
        if lacking > 0.0:
            effort += settings.earning_drag * velocity * min(1.0, 2.0 * lacking / settings.level)
    return -effort


def needed(run: FarRun) -> float:
    """Return Q: the most that the queued torques, the newest included, take at any later instant [J], >= 0."""
    ahead, bound, memory = run.settings.ahead, run.state.bound, run.memory.bound
    holds = ahead.delay + ahead.losses
    up = taken_under_way(ahead, bound, memory, 1.0, ahead.hand_speed, holds, _ANY)
    down = taken_under_way(ahead, bound, memory, -1.0, ahead.hand_speed, holds, _ANY)
    return up[1] + down[1]


def share(run: FarRun, position: float, torque: float, is_whole: bool) -> tuple[float, float, float]:
    """Send what the other side wants and this one does not need; give up what is beyond; ask for what is lacking.

    Returns:
        (Sent now, given up now, part of it that pays surplus) [J].
    """
    settings, state = run.settings, run.state
    if state.phase == LOST:
        lost, paid = come_to_rest(settings, state, torque)
        return 0.0, lost, paid
    if state.phase == IDLE:
        return 0.0, 0.0, 0.0
    energy, stored, level, given = certain(state), stored_by_model(settings, state, position), settings.level, 0.0
    may_give, left = is_whole and not state.stopping and state.wanted > state.sent, -inf
    if energy - stored > (0.5 if may_give else 2.0) * level:  # else there is nothing to give, and nothing to give up
        left = energy - needed(run) - stored
    if may_give:
        most = min(left - 0.5 * level, (state.wanted - state.sent) * PICO)
        if most > 0.0:
            whole = float(int(most / PICO))
            given = whole * PICO
            state.sent += whole
            deduct(run, given)
            energy, left = energy - given, left - given
    state.request = state.booked + float(int(max(0.0, level + stored - energy) / PICO))
    over = left - 2.0 * level
    if over <= 0.0 or state.axis.h_dis > 0.0:
        return given, 0.0, 0.0
    state.h_s -= over
    state.unrecovered += over
    state.given_up += over
    return given, over, 0.0


def deduct(run: FarRun, given: float) -> None:
    """Take energy that is sent off the tank [J]. It is no loss: it covers no uncertainty of the encoder."""
    run.state.h_s -= given


def come_to_rest(settings: FarSettings, state: FarState, torque: float) -> tuple[float, float]:
    """Forget a session that ended once no torque of it acts; return what is given up, and what of it pays [J].

    The next session begins with an empty tank and an empty queue.
    """
    state.at_rest = state.at_rest + 1 if torque == 0.0 and state.blend == 0.0 else 0
    if state.at_rest < settings.to_rest:
        return 0.0, 0.0
    left, surplus = state.h_s, state.axis.h_dis
    paid = min(left, surplus) if surplus > 0.0 else 0.0
    state.h_s, state.axis.h_dis = 0.0, surplus - paid
    state.unrecovered += left - paid
    state.given_up += left - paid
    state.received = state.wanted = state.booked = state.sent = state.request = state.cut = 0.0
    state.far_ready, state.phase, state.is_led, state.far_side = False, IDLE, False, 0.0
    forget(state.world)
    return left, paid


def settings_of(far: FarParameters, parameters: guarded.GuardedParameters, loop: LoopProperties) -> FarSettings:
    """Return the constants of a port to a far side.

    Args:
        far: Keys of the section `far`.
        parameters: Declared properties of hand and device.
        loop: Constants of the loop.
    """
    known = settings_of_program(AskedEffort(), parameters, loop)
    given = {field.name: getattr(known, field.name) for field in fields(known)}
    time = loop.sample_time
    return FarSettings(
        **given,
        ahead=replace(known.declared, delay=loop.delay + 1),
        stiffness=far.coupling.stiffness,
        model_damping=far.coupling.damping,
        level=far.level,
        earning_drag=far.drag,
        most_owed=far.from_far.energy / PICO,
        most_gained=far.from_far.power * time / PICO,
        fade=time / _FADE,
        release=time / _RELEASE,
        by_model=far.coupling.type == "model" and far.world is None,
        by_world=far.world is not None,
        slew=_NEARER * known.torque_limit,
        then=THEN[far.then],
        to_rest=loop.delay + 2 + parameters.max_consecutive_losses,
    )


class FarPort(guarded.Guarded):
    """Controller of an axis that is coupled to a far side."""

    parameters_type: ClassVar[type[guarded.GuardedParameters]] = guarded.GuardedParameters
    kernel: ClassVar[Kernel] = Kernel(settings_of, FarState, guarded.memory_of, step)

    def __init__(self, far: FarParameters, parameters: guarded.GuardedParameters, loop: LoopProperties) -> None:
        super().__init__(far, parameters, loop)  # type: ignore[arg-type] # no environment is rendered

    @property
    def state(self) -> FarState:
        """State of the port, to which a side writes what arrived and from which it reads what is to be sent."""
        state: FarState = self._state
        return state

    def given(self) -> tuple[float, float, float, float, float, float, float, int]:
        """Return what a log holds of the next step, as the first columns of `FarRow`; `take_far` is the inverse."""
        state = self.state
        flags = _IS_READY * state.far_ready | _IS_LINKED * state.linked | _IS_STOPPING * state.stopping
        flags |= _IS_BELOW * (state.far_side == 1.0) | _IS_ABOVE * (state.far_side < 0.0)
        flags |= _IS_TO_POINT * (state.far_side == SPRING)
        known = state.received, state.wanted, state.far_position, state.far_velocity, state.far_wall
        return *known, state.world.stiffness, state.world.damping, flags

    def take_far(self, row: FarRow) -> None:
        """Set what a log holds of a step before it is computed once more."""
        state = self.state
        state.received, state.wanted, state.far_position, state.far_velocity, state.far_wall = row[:5]
        state.world.stiffness, state.world.damping = row.stiffness, row.damping
        state.far_side = 1.0 * bool(row.flags & _IS_BELOW) - 1.0 * bool(row.flags & _IS_ABOVE)
        state.far_side += SPRING * bool(row.flags & _IS_TO_POINT)
        known = (bool(row.flags & bit) for bit in (_IS_READY, _IS_LINKED, _IS_STOPPING))
        state.far_ready, state.linked, state.stopping = known

    @property
    def asked(self) -> float:
        """Torque of the model before the guard [N or N*m]."""
        asked: float = self._state.asked
        return asked

    @property
    def settings(self) -> FarSettings:
        """Constants of the port."""
        settings: FarSettings = self._settings
        return settings

    @property
    def is_limited(self) -> bool:
        """Whether the last torque of the model was cut while energy that was asked of the other side was lacking."""
        state, settings = self.state, self.settings
        if state.phase != LINKED or state.blend == 0.0 or state.request <= state.booked:
            return False
        newest: float = self._memory.axis.commands.torques[state.axis.oldest - 1]
        return min(abs(state.asked), settings.torque_limit) - abs(newest) > settings.quantum + _ROUNDING

    @property
    def is_ready(self) -> bool:
        """Whether this side has earned its start."""
        state, settings = self.state, self.settings
        return state.phase == LINKED and (state.blend > 0.0 or certain(state) >= STARTS * settings.level)

    @property
    def held(self) -> float:
        """Largest torque at rest [N or N*m]: that of the hand, within the limit of the loop; `reserve` is for it."""
        return min(self.settings.torque_limit, self.hand_force or 0.0)

    def reserve(self, torque: float) -> float:
        """Return what the tank must hold for a torque at rest [J]: the most that it gives out while it cannot change.

        Args:
            torque: Torque [N or N*m].
        """
        declared = self.settings.declared
        return given_out(declared.response, declared.delay + declared.losses, torque) if declared.by_hand_force else 0.0
