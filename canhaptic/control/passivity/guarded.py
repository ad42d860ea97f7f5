"""`guarded`: the paper's energy balance with a certified bound on the torque of every hold. The default for rigs.

What is rendered is the environment at its true state, predicted to the middle of the hold in which the torque acts. A
torque held at the middle value lets a spring take in, and give back, what a continuous one would; a torque held at the
starting value gives k D^2 / 2 too much in every hold, which is where the energy of a sampled wall comes from. The lead
acts like a damper of k T (1/2 + delay) that dissipates nothing: it only cancels what the hold creates.

The account is (8) with the damper between port and ground: h_r = f_d D with f_d the damper effort inside the torque
that was applied, never negative, never more than what the torques under way leave. Nothing is created at the start of
contact: the store begins empty and pushing on fills it. What the account does not cover is not rendered:

* the spring effort stays below that of a spring with the energy in the account, as stiff as this rate renders calmly;
* beyond it, only while moving inward, a damper brings in what is missing and all of that is stored;
* and the torque stays below the largest of the declared certificates (`certificates`), which is the proof.

For every user without exception, sum(h_i) >= 0 admits no torque at all: whoever promises more relies on something known
of the hand or of the device. A hand force of 0 is the usual setting: it covers every hand that does not pull the axis
along the torque, and is not the same as "never active". Where stiffness or damping cannot be rendered the environment
gets softer, and the balance says so: `certificate` is not EXACT, `damping_rendered` is below the one asked.
"""

from dataclasses import dataclass, field
from math import copysign, inf, sqrt
from typing import Annotated, ClassVar, Final, NamedTuple

from canhaptic.control.balance import AT_REST, Branch, Certificate, EnergyBalance, interaction_energy
from canhaptic.control.certificates.scalar_bounds import NO_RESPONSE, displacement_response
from canhaptic.control.certificates.torque_bound import (
    BoundMemory,
    Declared,
    TorqueBound,
    bound_memory,
    end_gap,
    end_hold,
    free_energy,
    keep,
    largest_torques,
)
from canhaptic.control.environments.environment import Environment
from canhaptic.control.passivity.controller import LoopProperties
from canhaptic.control.passivity.hold_account import Axis, AxisMemory, axis_memory, begin
from canhaptic.control.passivity.in_flight import as_far_as_limit, efforts_inside, repeat, send, towards_zero
from canhaptic.control.passivity.settlement import settle
from canhaptic.control.passivity.stepped import SteppedController
from canhaptic.control.recovery import Alpha, damping_cap, modulated_damping
from canhaptic.control.velocity import restart, update
from canhaptic.errors import ParameterError
from canhaptic.kernels import Kernel, MakeBuffer, new
from canhaptic.units import Parameters, quantity

_FREE, _START, _EXACT = Branch.FREE.value, Branch.START.value, Branch.EXACT.value
_STICKY, _DEPLETED = Branch.STICKY.value, Branch.DEPLETED.value
_EXIT = Branch.EXIT.value
_UNBOUNDED, _BY_FORCE = Certificate.EXACT.value, Certificate.HAND_FORCE.value
_BY_DAMPING, _BY_SPEED = Certificate.DEVICE_DAMPING.value, Certificate.HAND_SPEED.value

_CALM: Final = 0.7
"""Stiffness of the energy-permitted spring over the one whose lead alone uses up the damping cap.

k T^2 / m is then 0.48 at delay 0 and 0.084 at delay 1; the sampled spring with its lead turns unstable slightly above.
"""
_LEAD_ROOM: Final = 1.75
"""Lead and damping together over the damping cap: in contact the hold's own negative damping takes the excess."""
_LONGEST_WINDOW: Final = 0.02
"""Of the velocity from a coarse encoder [s]."""
_NO_CAP: Final = 1e12
"""Of the damping when the moving mass is not known [N*s/m or N*m*s/rad]: finite, so that at rest it gives no force."""
_FADE: Final = 0.8
"""Share of the device's past dissipation that still counts after another hold out of contact."""


class GuardedParameters(Parameters):
    """What the certificates rest on. Mass and damping of the device are properties of the loop."""

    hand_force: Annotated[float, quantity("N", "N*m", ge=0.0)] | None = 0.0
    """Largest force with which the hand pulls along the torque: out of a wall, into it only where a damper makes it
    stick. None: the certificate is not used."""
    hand_speed: Annotated[float, quantity("m/s", "rad/s", gt=0.0)] | None = None
    """Largest speed of the hand. None: the certificate is not used. Alone it begins only with an energy allowance."""
    energy_allowance: Annotated[float, quantity("J", ge=0.0)] = 0.0
    """Energy that may be given out before any came in: the promise becomes sum(h_i) >= -energy_allowance."""
    alpha: Alpha = 0.0
    """Modulated damping per joule of surplus (eq. 19), always with its unit; 0 leaves the surplus standing."""
    prediction_holds: Annotated[float, quantity("count", ge=0.0, le=1.0)] = 0.5
    """Prediction beyond the delay, in holds: 0.5 aims at the middle of the hold."""
    max_consecutive_losses: Annotated[int, quantity("count", ge=0, le=16)] = 0
    """Consecutive cycles without a new torque at the drive that the certificates survive; each costs stiffness."""


@dataclass(frozen=True, slots=True)
class _GuardedSettings:
    """What is fixed for a run."""

    sample_time: float  # [s]
    credit: float  # [J]
    alpha: float  # [s/m^2 or s/rad^2]
    torque_limit: float  # largest torque that limiter and drive let act [N or N*m]
    quantum: float  # of the torque command; 0: ideal [N or N*m]
    lead: float  # prediction [holds]
    cap: float  # of the damping [N*s/m or N*m*s/rad]
    damping: float  # rendered where nothing is short [N*s/m or N*m*s/rad]
    lead_room: float  # damping that the lead may take beyond the cap [N*s/m or N*m*s/rad]
    calm_stiffness: float  # of the energy-permitted spring, by the rate; 0 without a hand force [N/m or N*m/rad]
    damped_stiffness: float  # of the same, by the damping of the device; 0 where it is not declared
    path: float  # of the hand in the holds that a torque takes; 0 without a hand speed [m or rad]
    longest_window: int  # of the velocity, in samples; 0 with an ideal encoder
    declared: Declared


@dataclass(slots=True)
class _GuardedState:
    """What is remembered between two SYNCs."""

    zone: int = 0  # of contact
    true: float = 0.0  # displacement of the storage in the continuous environment [m or rad]
    h_s: float = 0.0  # [J]
    kept_back: float = 0.0  # dissipated or leaked, and not paid [J]
    axis: Axis = field(default_factory=Axis)
    bound: TorqueBound = field(default_factory=TorqueBound)


class Memory(NamedTuple):
    """Buffers of one axis."""

    axis: AxisMemory
    bound: BoundMemory


def settings_of(environment: Environment, parameters: GuardedParameters, loop: LoopProperties) -> _GuardedSettings:
    """Returns what is fixed for a run.

    Raises:
        ParameterError: Nothing is known that a torque could be certified by.
    """
    sample_time, mass, damping = loop.sample_time, loop.moving_mass, loop.device_damping or 0.0
    response, speed = NO_RESPONSE, parameters.hand_speed or 0.0
    by_hand_force = parameters.hand_force is not None and mass is not None
    if parameters.hand_force is not None and mass is not None:
        response = displacement_response(
            sample_time, mass, parameters.hand_force, damping, loop.device_damping_bound or 0.0
        )
    elif not damping and not speed:
        raise ParameterError(
            "guarded: got neither moving_mass with hand_force, nor device_damping, nor hand_speed, expected one of "
            "them; without any no torque can be certified: declare what is known or choose another algorithm"
        )
    cap = min(_NO_CAP, damping_cap(loop.delay, mass, sample_time))
    return _GuardedSettings(
        sample_time=sample_time,
        credit=parameters.energy_allowance,
        alpha=parameters.alpha,
        torque_limit=inf if loop.torque_limit is None else loop.torque_limit,
        quantum=loop.torque_quantum,
        lead=parameters.prediction_holds + loop.delay,
        cap=cap,
        damping=min(environment.damping, cap),
        lead_room=(_LEAD_ROOM - 1.0) * cap,
        calm_stiffness=_CALM * cap / (sample_time * (0.5 + loop.delay)) if by_hand_force else 0.0,
        damped_stiffness=2.0 * damping / (sample_time * (1 + loop.delay)),
        path=speed * sample_time * (1 + loop.delay),
        longest_window=max(2, round(_LONGEST_WINDOW / sample_time)) if loop.encoder_count else 0,
        declared=Declared(
            sample_time,
            loop.delay,
            parameters.max_consecutive_losses,
            by_hand_force,
            response,
            damping,
            speed,
            loop.encoder_count,
        ),
    )


def memory_of(settings: _GuardedSettings, make_buffer: MakeBuffer) -> Memory:
    """Returns the buffers of one axis."""
    axis = axis_memory(settings.declared.delay, settings.longest_window, make_buffer)
    return Memory(axis, bound_memory(settings.declared, axis.commands.torques, make_buffer))


def step(
    environment: Environment,
    settings: _GuardedSettings,
    state: _GuardedState,
    memory: Memory,
    position: float,
    torque_applied: float,
) -> EnergyBalance:
    """Accounts for the hold that ended; see `Controller.step`."""
    zone, zone_before, axis = environment.contact(position), state.zone, state.axis
    state.zone = zone
    if not axis.started:
        begin(axis, memory.axis, position)
        return AT_REST
    holds = axis.missed + 1
    displacement, damper, modulated, unsure = end(settings, state, memory, position, torque_applied)
    same = zone == zone_before
    last = state.true if same else 0.0
    true = environment.true_state(position, displacement, last) if zone else 0.0
    ceiling = environment.stored_energy(true) if zone else 0.0
    h_i = interaction_energy(torque_applied, displacement) - unsure
    h_pas = modulated * displacement
    h_r, deficit, leak, paid = book(settings, state, memory, h_i, h_pas, damper * displacement, ceiling)
    torque = damper = modulated = rendered = 0.0
    certificate = _UNBOUNDED
    if zone:
        if environment.relaxes:
            true, ceiling, lost = relax(environment, settings, state, true, ceiling)
            h_r += lost
        spring = environment.effort(true)
        travel, inside = true - last, displacement
        if holds > 1 or settings.longest_window or not same:
            travel, inside = motion_of(environment, settings, axis, displacement, holds, true, last, same)
        torque, damper, modulated, rendered, certificate = render(
            environment, settings, state, memory, true, travel, inside, spring, ceiling
        )
        branch = _START if not same else _STICKY if h_i > 0.0 and displacement * spring < 0.0 else _EXACT
    else:
        if state.bound.dissipated > 0.0:
            fade(state)
        branch = _EXIT if zone_before or h_i != 0.0 or leak != 0.0 else _FREE
    axis.oldest = send(memory.axis.commands, axis.oldest, torque, damper, modulated)
    state.true, h_s = true, state.h_s
    stored = true if h_s == ceiling else environment.state_of_energy(h_s, true)
    return new(EnergyBalance, (
        torque, h_i, h_pas, h_i - h_pas, h_r, h_s, axis.h_dis, 0.0, deficit, leak, paid,
        _DEPLETED if deficit > 0.0 else branch, rendered, certificate, stored,
    ))  # fmt: skip


def end(
    settings: _GuardedSettings, state: _GuardedState, memory: Memory, position: float, torque_applied: float
) -> tuple[float, float, float, float]:
    """Ends a hold; returns (displacement, damper effort, modulated effort, energy unsure)."""
    declared, bound, axis, commands = settings.declared, state.bound, state.axis, memory.axis.commands
    displacement, count, oldest = position - axis.position, declared.encoder_count, axis.oldest
    axis.position = position
    if axis.missed:
        return displacement, 0.0, 0.0, end_several(settings, state, memory, displacement, torque_applied)
    bound.first = oldest - declared.delay
    end_hold(declared, bound, memory.bound, displacement, torque_applied)
    if count > 0.0:
        update(axis.window, memory.axis.samples, count, settings.sample_time, position)
    if commands.torques[oldest] == torque_applied:
        return displacement, commands.dampers[oldest], commands.modulated[oldest], 0.0
    damper, modulated = efforts_inside(commands, oldest, torque_applied)
    return displacement, damper, modulated, 0.0


def end_several(
    settings: _GuardedSettings, state: _GuardedState, memory: Memory, displacement: float, torque_applied: float
) -> float:
    """Ends several holds whose samples were lost but for the last; returns the energy unsure [J]."""
    axis, commands, holds = state.axis, memory.axis.commands, state.axis.missed + 1
    largest, apart = abs(torque_applied), 0.0
    for _ in range(axis.missed):
        sent = as_far_as_limit(commands.torques[axis.oldest], settings.torque_limit)
        largest, apart = max(largest, abs(sent)), max(apart, abs(sent - torque_applied))
        axis.oldest = repeat(commands, axis.oldest)
    axis.missed = 0
    state.bound.first = axis.oldest - settings.declared.delay
    if settings.longest_window:
        restart(axis.window, memory.axis.samples, axis.position)
        axis.window.velocity = displacement / (holds * settings.sample_time)
    return end_gap(settings.declared, state.bound, displacement, torque_applied, holds, largest, apart)


def book(
    settings: _GuardedSettings,
    state: _GuardedState,
    memory: Memory,
    h_i: float,
    h_pas: float,
    damped: float,
    ceiling: float,
) -> tuple[float, float, float, float]:
    """Books one hold into store and surplus; returns (h_r, deficit, leak, paid) [J].

    Args:
        settings: Of the run.
        state: Changed.
        memory: Of the axis.
        h_i: Interaction energy of the hold [J].
        h_pas: Part of it taken by the modulated damper [J].
        damped: Damper effort inside the applied torque times the displacement [J].
        ceiling: What the environment stores at its true state [J]; more is not kept.
    """
    axis = state.axis
    h_s, surplus = state.h_s + h_i - h_pas, axis.h_dis - h_pas
    slack = 0.0
    if damped > 0.0 or h_s > ceiling:
        slack = free_energy(settings.declared, state.bound, memory.bound, h_s - surplus + settings.credit)
        if slack > h_s:
            slack = h_s
    elif h_s >= 0.0:  # nothing is dissipated, leaked or lacking: nothing is to be settled
        state.h_s, axis.h_dis = h_s, surplus
        return 0.0, 0.0, 0.0, 0.0
    state.h_s, axis.h_dis, h_r, deficit, leak, paid = settle(h_s, surplus, damped, ceiling, slack)
    state.kept_back += h_r + leak - paid
    return h_r, deficit, leak, paid


def relax(
    environment: Environment, settings: _GuardedSettings, state: _GuardedState, true: float, ceiling: float
) -> tuple[float, float, float]:
    """Returns (state, energy there, energy dissipated) after one hold of internal relaxation [m or rad, J, J]."""
    relaxed = environment.relaxed(true, settings.sample_time)
    left = environment.stored_energy(relaxed)
    lost = min(state.h_s, max(0.0, ceiling - left))
    state.h_s -= lost
    state.kept_back += lost
    return relaxed, left, lost


def motion_of(
    environment: Environment,
    settings: _GuardedSettings,
    axis: Axis,
    displacement: float,
    holds: int,
    true: float,
    last: float,
    same: bool,
) -> tuple[float, float]:
    """Returns the motion per hold of the state and of the damper inside the contact [m or rad]."""
    smooth = settings.longest_window > 0 and not environment.relaxes
    if same:
        if not smooth:
            return (true - last) / holds, displacement / holds
        motion = axis.window.velocity * settings.sample_time
        return motion, motion
    inside = (true - environment.admissible(true - displacement, true)) / holds
    return axis.window.velocity * settings.sample_time if smooth else displacement / holds, inside


def fade(state: _GuardedState) -> None:
    """Lets past dissipation of the device fade, out of contact."""
    bound, energy = state.bound, state.h_s - state.axis.h_dis
    keep(bound, energy, _FADE * max(0.0, energy + bound.dissipated))


def certain_energy(state: _GuardedState, energy: float) -> float:
    """Returns what of an energy the next torques may take out with an encoder of finite counts [J].

    What was dissipated or leaked is not available again, but it covers what the encoder leaves unsure: (4) holds
    for the energy as booked, (3) for the true one.
    """
    lacking = state.bound.unsure - state.kept_back
    return energy - lacking if lacking > 0.0 else energy


def render(
    environment: Environment,
    settings: _GuardedSettings,
    state: _GuardedState,
    memory: Memory,
    true: float,
    travel: float,
    inside: float,
    spring: float,
    ceiling: float,
) -> tuple[float, float, float, float, int]:
    """Returns (torque for the next free hold, damper and modulated effort in it, damping rendered, certificate)."""
    velocity, bound = inside / settings.sample_time, state.bound
    energy = state.h_s - state.axis.h_dis + settings.credit
    if settings.longest_window:
        energy = certain_energy(state, energy)
    lead = environment.effort(environment.admissible(true + settings.lead * travel, true)) - spring
    spring, lead, damper, covered = efforts(settings, bound, spring, lead, velocity, energy, ceiling)
    rendered = damper / velocity if velocity != 0.0 else settings.damping
    modulated = 0.0
    if settings.alpha > 0.0 and state.axis.h_dis > 0.0 and velocity != 0.0:
        extra = modulated_damping(
            settings.alpha, state.axis.h_dis, rendered, settings.cap, inside, settings.sample_time
        )
        modulated = extra * velocity
        rendered += extra
    torque = -(spring + lead + damper + modulated)
    size = abs(torque)
    if size == 0.0:
        return torque, damper, modulated, rendered, _UNBOUNDED
    sign = 1.0 if torque > 0.0 else -1.0
    force, damping, speed = largest_torques(settings.declared, bound, memory.bound, sign, energy)
    largest = force if force > damping else damping
    if speed > largest:
        largest = speed
    if size > largest:
        share = largest / size
        torque, damper, modulated, rendered = torque * share, damper * share, modulated * share, rendered * share
        size, covered = largest, False
    certificate = (
        _UNBOUNDED if covered else _BY_DAMPING if damping >= size else _BY_FORCE if force >= size else _BY_SPEED
    )
    return towards_zero(torque, settings.quantum), damper, modulated, rendered, certificate


def efforts(
    settings: _GuardedSettings,
    bound: TorqueBound,
    spring: float,
    lead: float,
    velocity: float,
    energy: float,
    ceiling: float,
) -> tuple[float, float, float, bool]:
    """Returns efforts of spring, lead and damper [N or N*m], and whether the account covers all of them."""
    damper, size, speed = settings.damping * velocity, abs(spring), abs(velocity)
    room = settings.cap * speed
    permitted = 2.0 * settings.calm_stiffness * energy
    if settings.damped_stiffness > 0.0:
        whole = spring + lead + damper
        keep(bound, energy, ceiling + 0.5 * (whole * whole) / settings.damped_stiffness)
        with_device = 2.0 * settings.damped_stiffness * (energy + bound.dissipated)
        if with_device > permitted:
            permitted = with_device
    if settings.path > 0.0 and energy > 0.0:
        permitted = max(permitted, (energy / settings.path) * (energy / settings.path))
    covered = permitted >= size * size
    if not covered:
        held = sqrt(permitted) if permitted > 0.0 else 0.0
        if velocity * spring > 0.0:
            catch_up = min(size - held, room)
            held += catch_up
            room -= catch_up
        held = copysign(held, spring)
        # moving out, the lead may stick as much as the damper does, and a pure spring never
        if lead * spring < 0.0 and abs(lead) > abs(held) + abs(damper):
            lead = copysign(abs(held) + abs(damper), lead)
        spring = held
    if abs(damper) > room:
        damper, covered = copysign(room, damper), False
    room += settings.lead_room * speed - abs(damper)
    if abs(lead) > room:
        lead = copysign(room, lead)
    return spring, lead, damper, covered


class Guarded(SteppedController):
    """An environment rendered as far as the certificates allow."""

    parameters_type: ClassVar[type[Parameters]] = GuardedParameters
    kernel: ClassVar[Kernel] = Kernel(settings_of, _GuardedState, memory_of, step)

    def __init__(self, environment: Environment, parameters: GuardedParameters, loop: LoopProperties) -> None:
        super().__init__(environment, parameters, loop)
        self.max_consecutive_losses = parameters.max_consecutive_losses
        self.energy_allowance = parameters.energy_allowance

    def hold(self) -> EnergyBalance:
        """Repeats the last command for want of a position; see `Controller.hold`.

        The next `step` books the displacement over all holds with the torque read back, less what that leaves open.
        """
        return super().hold()._replace(damping_rendered=0.0, certificate=_UNBOUNDED)
