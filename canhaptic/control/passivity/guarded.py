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

For every user without exception, sum(h_i) >= 0 admits no torque at all: a larger promise relies on something known
of the hand or of the device. A hand force of 0 is the usual setting: it covers every hand that does not pull the axis
along the torque, and is not the same as "never active". Where stiffness or damping cannot be rendered the environment
gets softer, and the balance says so: `certificate` is not EXACT, `damping_rendered` is below the one asked.
"""

from dataclasses import dataclass, field
from math import copysign, inf, sqrt
from typing import ClassVar, Final, NamedTuple

from canhaptic.control.balance import AT_REST, Branch, Certificate, EnergyBalance, interaction_energy
from canhaptic.control.certificates.certified_torque import free_energy, largest_torques
from canhaptic.control.certificates.torque_bound import (
    BoundMemory,
    TorqueBound,
    bound_memory,
    end_gap,
    end_hold,
    keep,
    shorten,
    turn,
)
from canhaptic.control.environments.environment import Environment
from canhaptic.control.passivity.controller import LoopProperties
from canhaptic.control.passivity.guarded_settings import GuardedParameters, GuardedSettings, settings_of
from canhaptic.control.passivity.hold_account import Axis, AxisMemory, axis_memory, begin
from canhaptic.control.passivity.in_flight import as_far_as_limit, efforts_inside, repeat, send, towards_zero
from canhaptic.control.passivity.settlement import settle
from canhaptic.control.passivity.stepped import SteppedController
from canhaptic.control.recovery import modulated_damping
from canhaptic.control.velocity import restart, update
from canhaptic.kernels import Kernel, MakeBuffer, new
from canhaptic.units import Parameters

_FREE, _START, _EXACT = Branch.FREE.value, Branch.START.value, Branch.EXACT.value
_STICKY, _DEPLETED = Branch.STICKY.value, Branch.DEPLETED.value
_EXIT = Branch.EXIT.value
_UNBOUNDED, _BY_FORCE = Certificate.EXACT.value, Certificate.HAND_FORCE.value
_BY_DAMPING, _BY_SPEED = Certificate.DEVICE_DAMPING.value, Certificate.HAND_SPEED.value

_FADE: Final = 0.8
"""Share of the device's past dissipation that still counts after another hold out of contact."""


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


def memory_of(settings: GuardedSettings, make_buffer: MakeBuffer) -> Memory:
    """Returns the buffers of one axis."""
    axis = axis_memory(settings.declared.delay, settings.longest_window, make_buffer)
    return Memory(axis, bound_memory(settings.declared, axis.commands.torques, make_buffer))


def step(
    environment: Environment,
    settings: GuardedSettings,
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
        if zone:
            turn(settings.declared, state.bound, way_out(environment, environment.true_state(position, 0.0, 0.0)))
        return AT_REST
    holds = axis.missed + 1
    displacement, damper, modulated, unsure = end(settings, state, memory, position, torque_applied)
    same = zone == zone_before
    last = state.true if same else 0.0
    true = environment.true_state(position, displacement, last) if zone else 0.0
    if not same and zone:
        turn(settings.declared, state.bound, way_out(environment, true))
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
            environment, settings, state, memory, true, travel, inside, spring, ceiling, displacement / holds
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
    settings: GuardedSettings, state: _GuardedState, memory: Memory, position: float, torque_applied: float
) -> tuple[float, float, float, float]:
    """Ends a hold; returns (displacement, damper effort, modulated effort, energy unsure)."""
    declared, bound, axis, commands = settings.declared, state.bound, state.axis, memory.axis.commands
    displacement, count, oldest = position - axis.position, declared.encoder_count, axis.oldest
    axis.position = position
    if axis.missed:
        return displacement, 0.0, 0.0, end_several(settings, state, memory, displacement, torque_applied)
    bound.first = oldest - declared.delay
    unsure = end_hold(declared, bound, memory.bound, displacement, torque_applied)
    if axis.lasted > 1.0:
        shorten(declared, bound, axis.lasted)
        axis.lasted = 1.0
    if count > 0.0:
        update(axis.window, memory.axis.samples, count, settings.sample_time, position)
    if commands.torques[oldest] == torque_applied:
        return displacement, commands.dampers[oldest], commands.modulated[oldest], unsure
    damper, modulated = efforts_inside(commands, oldest, torque_applied)
    return displacement, damper, modulated, unsure


def way_out(environment: Environment, true: float) -> float:
    """Returns the direction out of a contact, 1 or -1; 0 where its storage works both ways and it has none."""
    if environment.admissible(-true, true) == -true:
        return 0.0
    return 1.0 if true < 0.0 else -1.0


def end_several(
    settings: GuardedSettings, state: _GuardedState, memory: Memory, displacement: float, torque_applied: float
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
    settings: GuardedSettings,
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
    environment: Environment, settings: GuardedSettings, state: _GuardedState, true: float, ceiling: float
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
    settings: GuardedSettings,
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
    settings: GuardedSettings,
    state: _GuardedState,
    memory: Memory,
    true: float,
    travel: float,
    inside: float,
    spring: float,
    ceiling: float,
    moved: float,
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
    if size > settings.least_limit:
        most = within_limits(settings, memory.axis.commands.torques[state.axis.oldest - 1], sign, moved)
        if size > most:
            share, torque, size = most / size, sign * most, most
            damper, modulated, rendered = damper * share, modulated * share, rendered * share
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


def within_limits(settings: GuardedSettings, newest: float, sign: float, moved: float) -> float:
    """Returns the largest torque along `sign` that the limiter lets pass [N or N*m]; see `drive.profile.limiter`.

    What it cuts after a torque was certified would take energy in no more on which the next one counts.

    Args:
        settings: Of the run.
        newest: Torque sent last [N or N*m].
        sign: 1 or -1.
        moved: In the last sample time [m or rad].
    """
    most = settings.torque_limit
    if settings.torque_step < inf:
        rise = settings.torque_step + (sign * newest if sign * newest > 0.0 else 0.0)
        if rise < most:
            most = rise
    if settings.power_limit < inf and sign * moved > 0.0:
        power = settings.power_limit / (sign * moved / settings.sample_time)
        if power < most:
            most = power
    return most


def efforts(
    settings: GuardedSettings,
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

    @property
    def energy_resolution(self) -> float:
        """Width of what is known of the sum of h_i because torques come late [J]; what is booked is its lower end."""
        return float(self._state.bound.resolution)

    def hold(self) -> EnergyBalance:
        """Repeats the last command for want of a position; see `Controller.hold`.

        The next `step` books the displacement over all holds with the torque read back, less what that leaves open.
        """
        return super().hold()._replace(damping_rendered=0.0, certificate=_UNBOUNDED)
