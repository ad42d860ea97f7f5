"""`guarded`: the paper's energy balance with a certified bound on the torque of every hold. The default for rigs.

The environment is rendered at its true state, predicted to the hold in which the torque acts (`prediction`). A
torque held at the middle value lets a spring absorb, and give back, what a continuous one would; a torque held at the
starting value gives k D^2 / 2 too much in every hold, which is where the energy of a sampled wall comes from. Aimed a
quarter of a hold further ahead, a spring without a damper calms down. The damper uses the predicted velocity too.

The account is (8) with the damper between port and ground: h_r = f_d D with f_d the damper effort inside the torque
was applied, never negative, never more than the queued torques leave. Nothing is created at the start of
contact: the stored energy begins at zero and pushing in fills it. What the account does not cover is not rendered:

* the spring effort stays below that of a spring with the energy in the account, as stiff as the certificate holds;
* beyond it, only while moving inward, a damper brings in the missing energy, all of it stored; and a spring whose
  account is short is predicted as if no torque slowed the axis down;
* and the torque stays below what all declared certificates together permit (`certified_torque`): that is the proof.

Energy beyond what is stored (from a drag in free motion, or a wall left behind), or dissipated by the device, is
kept for later contacts up to `earned_energy`. From zero energy no torque begins below an inward speed of
(1 + delay) F_h T / m: a hand of F_h could turn every slower motion outward before the torque ends, so that energy would
come out first. Only certain dissipation of the device allows a slower start.

For every user without exception, sum(h_i) >= 0 admits no torque at all: a larger promise relies on something known
of the hand or of the device. A hand force of 0 is the usual setting: it covers every hand that does not pull the axis
along the torque, and is not the same as "never active". Where stiffness or damping cannot be rendered the environment
gets softer, and the balance says so: `certificate` is not EXACT, `damping_rendered` is below the requested one.

The account of `guarded`: its state between two SYNCs, and the booking of a hold that ended.

The torque of `guarded` for the next free hold: the requested one, within account and certificates.
"""

from dataclasses import dataclass, field
from math import copysign, inf, sqrt
from typing import Any, ClassVar, Final, NamedTuple

from canhaptic.control.balance import AT_REST, Branch, Certificate, EnergyBalance
from canhaptic.control.certificates.certified_torque import free_energy, largest_torques
from canhaptic.control.certificates.torque_bound import (
    BoundMemory,
    TorqueBound,
    bound_memory,
    end_gap,
    end_hold,
    for_any,
    keep,
    look_for_turn,
    reaches_turn,
    shorten,
)
from canhaptic.control.damping import modulated_damping, restart, update
from canhaptic.control.environments.environment import Environment
from canhaptic.control.passivity.controller import LoopProperties
from canhaptic.control.passivity.guarded_settings import (
    GuardedParameters,
    GuardedSettings,
    PredictedMotion,
    observe,
    observe_mean,
    predicted,
    settings_of,
)
from canhaptic.control.passivity.hold_account import Axis, AxisMemory, axis_memory, begin
from canhaptic.control.passivity.stepped import (
    SteppedController,
    as_far_as_limit,
    efforts_inside,
    repeat,
    send,
    settle,
    towards_zero,
)
from canhaptic.kernels import Kernel, MakeBuffer, Run, new
from canhaptic.units import Parameters

_FADE: Final = 0.8
"""Share of the device's past dissipation that still counts after another hold out of contact."""


@dataclass(slots=True)
class GuardedState:
    """State kept from SYNC to SYNC."""

    zone: int = 0  # of contact
    true: float = 0.0  # displacement of the storage in the continuous environment [m or rad]
    h_s: float = 0.0  # [J]
    unrecovered: float = 0.0  # dissipated or leaked, and not paid [J]
    axis: Axis = field(default_factory=Axis)
    bound: TorqueBound = field(default_factory=TorqueBound)
    motion: PredictedMotion = field(default_factory=PredictedMotion)


class Memory(NamedTuple):
    """Buffers of one axis."""

    axis: AxisMemory
    bound: BoundMemory


def memory_of(settings: GuardedSettings, make_buffer: MakeBuffer) -> Memory:
    """Return the buffers of one axis."""
    axis = axis_memory(settings.declared.delay, settings.longest_window, make_buffer)
    return Memory(axis, bound_memory(settings.declared, axis.commands.torques, make_buffer))


def end(
    settings: GuardedSettings, state: GuardedState, memory: Memory, position: float, torque_applied: float
) -> tuple[float, float, float, float]:
    """End a hold; return (displacement, damper effort, modulated effort, uncertain energy)."""
    declared, bound, axis, commands = settings.declared, state.bound, state.axis, memory.axis.commands
    displacement, count, oldest = position - axis.position, declared.encoder_count, axis.oldest
    axis.position = position
    if axis.missed:
        axis.missed += int(axis.lasted - 1.0)  # of SYNCs that were skipped in the gap no sample came either
        axis.lasted = 1.0
        return displacement, 0.0, 0.0, end_several(settings, state, memory, displacement, torque_applied)
    bound.first = oldest - declared.delay
    uncertainty = end_hold(declared, bound, memory.bound, displacement, torque_applied, axis.lasted)
    if axis.lasted > 1.0:
        shorten(declared, bound, axis.lasted)
        observe_mean(state.motion, displacement / axis.lasted)
        restart_at_mean(settings, axis, memory.axis, displacement / axis.lasted)
        axis.lasted = 1.0
    else:
        observe(settings.prediction, state.motion, displacement, torque_applied)
        if count:
            update(axis.window, memory.axis.samples, count, settings.sample_time, position)
    if commands.torques[oldest] == torque_applied:
        return displacement, commands.dampers[oldest], commands.modulated[oldest], uncertainty
    damper, modulated = efforts_inside(commands, oldest, torque_applied)
    return displacement, damper, modulated, uncertainty


def end_several(
    settings: GuardedSettings, state: GuardedState, memory: Memory, displacement: float, torque_applied: float
) -> float:
    """End several holds of which only the last has a sample; return the uncertain energy [J]."""
    axis, commands, holds = state.axis, memory.axis.commands, state.axis.missed + 1
    largest, apart = abs(torque_applied), 0.0
    for _ in range(axis.missed):
        sent = as_far_as_limit(commands.torques[axis.oldest], settings.torque_limit)
        largest, apart = max(largest, abs(sent)), max(apart, abs(sent - torque_applied))
        axis.oldest = repeat(commands, axis.oldest)
    axis.missed = 0
    observe_mean(state.motion, displacement / holds)
    state.bound.first = axis.oldest - settings.declared.delay
    restart_at_mean(settings, axis, memory.axis, displacement / holds)
    return end_gap(settings.declared, state.bound, displacement, torque_applied, holds, largest, apart)


def restart_at_mean(settings: GuardedSettings, axis: Axis, memory: AxisMemory, moved: float) -> None:
    """Restart the velocity's window after holds with this mean displacement [m or rad]."""
    if settings.longest_window:
        restart(axis.window, memory.samples, axis.position)
        axis.window.velocity = moved / settings.sample_time


def book(
    settings: GuardedSettings,
    state: GuardedState,
    memory: Memory,
    h_i: float,
    h_pas: float,
    damped: float,
    ceiling: float,
) -> tuple[float, float, float, float]:
    """Book one hold into stored energy and surplus; return (h_r, deficit, leak, paid) [J].

    Args:
        settings: Constants of the run.
        state: State of the axis; changed.
        memory: Buffers of the axis.
        h_i: Interaction energy of the hold [J].
        h_pas: Energy taken by the modulated damper [J].
        damped: Damper effort inside the applied torque times the displacement [J].
        ceiling: Energy that the environment stores at its true state [J]; at most `earned_energy` is kept
            beyond it.
    """
    axis = state.axis
    h_s, surplus = state.h_s + h_i - h_pas, axis.h_dis - h_pas
    slack = 0.0
    ceiling += settings.earned
    if damped > 0.0 or h_s > ceiling:
        slack = free_energy(settings.declared, state.bound, memory.bound, h_s - surplus + settings.credit)
        if slack > h_s:
            slack = h_s
    elif h_s >= 0.0:  # nothing is dissipated, leaked or lacking: nothing is to be settled
        state.h_s, axis.h_dis = h_s, surplus
        return 0.0, 0.0, 0.0, 0.0
    state.h_s, axis.h_dis, h_r, deficit, leak, paid = settle(h_s, surplus, damped, ceiling, slack)
    state.unrecovered += h_r + leak - paid
    return h_r, deficit, leak, paid


def relax(
    environment: Environment, settings: GuardedSettings, state: GuardedState, true: float, ceiling: float, holds: float
) -> tuple[float, float, float]:
    """Return (state, energy there, energy dissipated) after internal relaxation for some holds [m or rad, J, J]."""
    relaxed = environment.relaxed(true, holds * settings.sample_time)
    left = environment.stored_energy(relaxed)
    lost = min(state.h_s, max(0.0, ceiling - left))
    state.h_s -= lost
    state.unrecovered += lost
    return relaxed, left, lost


def fade(settings: GuardedSettings, state: GuardedState) -> None:
    """Reduce the device's past dissipation, out of contact, to the energy kept for later contacts."""
    bound, energy = state.bound, state.h_s - state.axis.h_dis
    have = max(0.0, energy + bound.dissipated)
    keep(bound, energy, max(_FADE * have, settings.earned))


_NOT_BOUND, _BY_FORCE = Certificate.EXACT.value, Certificate.HAND_FORCE.value
_BY_DAMPING, _BY_FRICTION = Certificate.DEVICE_DAMPING.value, Certificate.DEVICE_FRICTION.value
_BY_SPEED = Certificate.HAND_SPEED.value
_DRAG_SHARE: Final = 0.5
"""Damping of the drag near rest, over the largest one that does not ripple."""


def render(
    environment: Environment, settings: GuardedSettings, state: GuardedState, memory: Memory, true: float,
    spring: float, ceiling: float, travel: float, inside: float, moved: float, same: bool,
) -> tuple[float, float, float, float, int]:  # fmt: skip
    """Return (torque for the next free hold, damper and modulated effort in it, damping rendered, certificate).

    Args:
        environment: Environment rendered.
        settings: Constants of the run.
        state: State of the axis.
        memory: Buffers of the axis.
        true: State of the storage [m or rad].
        spring: Spring effort at that state [N or N*m].
        ceiling: Energy stored at that state [J].
        travel: Motion of the storage in a hold [m or rad].
        inside: Motion of the axis in contact, in a hold [m or rad].
        moved: Motion of the axis in a hold [m or rad].
        same: Whether the contact existed before.
    """
    bound, energy = state.bound, state.h_s - state.axis.h_dis + settings.credit
    if settings.longest_window:
        energy = certain_energy(state, energy)
    ahead = steady = settings.lead * travel
    if not environment.relaxes:
        ahead, mover_motion = predicted(settings.prediction, state.motion, memory.bound.under_way, bound.first, travel)
        if state.h_s < ceiling and steady * true > 0.0 and steady * true > ahead * true:
            ahead = steady  # going in, more may be taken in where the account is short
        if same:
            inside = mover_motion
    lead = environment.effort(environment.admissible(true + ahead, true)) - spring
    velocity = inside / settings.sample_time
    spring, lead, damper, covered = efforts(settings, bound, true, spring, lead, ahead, velocity, energy, ceiling)
    rendered = damper / velocity if velocity != 0.0 else settings.damping
    modulated = 0.0
    if settings.alpha > 0.0 and state.axis.h_dis > 0.0 and velocity != 0.0:
        extra = modulated_damping(
            settings.alpha, state.axis.h_dis, rendered, settings.cap, inside, settings.sample_time
        )
        modulated = extra * velocity
        rendered += extra
    torque = -(spring + lead + damper + modulated)
    if torque == 0.0:
        return torque, damper, modulated, rendered, _NOT_BOUND
    size, certificate = permitted_size(settings, state, memory, torque, energy, moved)
    asked = abs(torque)
    if size < asked:
        share = size / asked
        torque, damper, modulated, rendered = torque * share, damper * share, modulated * share, rendered * share
    elif covered:
        certificate = _NOT_BOUND
    if settings.quantum > 0.0:
        torque = towards_zero(torque, settings.quantum)
    return torque, damper, modulated, rendered, certificate


def permitted_size(
    settings: GuardedSettings, state: GuardedState, memory: Memory, torque: float, energy: float, moved: float
) -> tuple[float, int]:
    """Permitted part of a torque's magnitude [N or N*m], and its certificate.

    Limits and certificates bound it.

    Args:
        settings: Constants of the run.
        state: State of the axis.
        memory: Buffers of the axis.
        torque: Requested torque, not 0 [N or N*m].
        energy: Energy budget [J].
        moved: Displacement in a hold [m or rad].
    """
    sign, size = (1.0, torque) if torque > 0.0 else (-1.0, -torque)
    if size > settings.least_limit:
        most = within_limits(settings, memory.axis.commands.torques[state.axis.oldest - 1], sign, moved)
        if size > most:
            size = most
    declared, bound = settings.declared, state.bound
    largest, for_all, by_force = largest_torques(declared, bound, memory.bound, sign, energy)
    if size > largest:
        size = largest
    if settings.turns and not bound.turns and reaches_turn(declared, bound, memory.bound, sign * size):
        bound.turns, bound.is_near, bound.kept = True, True, 0
        largest, for_all, by_force = largest_torques(declared, bound, memory.bound, sign, energy)
        size = min(size, largest)
    if size <= declared.friction:
        return size, _BY_FRICTION
    return size, _BY_DAMPING if for_all >= size else _BY_FORCE if by_force >= size else _BY_SPEED


def certain_energy(state: GuardedState, energy: float) -> float:
    """Part of an energy that the next torques may give out with an encoder of finite resolution [J].

    Energy that was dissipated or leaked cannot be given out again, but it covers the uncertainty of the encoder: (4)
    holds for the energy of the account, (3) for the true one.
    """
    lacking = state.bound.uncertainty - state.unrecovered
    return energy - lacking if lacking > 0.0 else energy


def within_limits(settings: GuardedSettings, newest: float, sign: float, moved: float) -> float:
    """Return the largest torque along `sign` that the limiter permits [N or N*m]; see `drive.profile.limiter`.

    If the limiter reduced a certified torque, it would absorb less energy than the next torque counts on.

    Args:
        settings: Constants of the run.
        newest: Torque sent last [N or N*m].
        sign: 1 or -1.
        moved: Displacement in the last sample time [m or rad].
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
    true: float,
    spring: float,
    lead: float,
    ahead: float,
    velocity: float,
    energy: float,
    ceiling: float,
) -> tuple[float, float, float, bool]:
    """Return efforts of spring, lead and damper [N or N*m], and whether the account covers all of them."""
    damper, size, speed = settings.damping * velocity, abs(spring), abs(velocity)
    room, led = settings.cap * speed, settings.calm * abs(ahead)
    if abs(damper) > room:
        damper = copysign(room, damper)
    permitted = 2.0 * settings.calm_stiffness * energy
    if not settings.declared.by_hand_force_alone:
        permitted = energy_permitted(settings, bound, spring + lead + damper, energy, ceiling)
        if settings.sustained > 0.0:
            soft, further = soft_and_further(settings, bound, size, abs(true), energy)
            if soft + further < size:  # all of it would use up what the soft spring lives on
                permitted = min(permitted, (soft + further) * (soft + further))
                room, led = min(room, further), min(led, further)
    covered = permitted >= size * size
    if not covered:
        held = sqrt(permitted) if permitted > 0.0 else 0.0
        if velocity * spring > 0.0:
            catch_up = min(size - held, room)
            held += catch_up
            room -= catch_up
        if lead * spring < 0.0 and abs(lead) > held:  # a spring does not stick
            lead = -copysign(held, spring)
        spring = copysign(held, spring)
    if abs(damper) > room:
        damper, covered = copysign(room, damper), False
    if abs(lead) > led:
        lead = copysign(led, lead)
    return spring, lead, damper, covered


def soft_and_further(
    settings: GuardedSettings, bound: TorqueBound, size: float, depth: float, energy: float
) -> tuple[float, float]:
    """Effort of the spring that dry friction sustains, and the largest effort beyond it [N or N*m].

    That spring's stored energy is reserved for it, so that the wall gets softer and never vanishes; the rest covers
    further efforts, and the count that raising and lowering them leaves uncertain. With less than half of it left,
    after a motion too fast for friction to cover, the spring is softer still.

    Args:
        settings: Constants of the run.
        bound: State of the torque bound.
        size: Requested effort [N or N*m].
        depth: Size of the true state [m or rad].
        energy: Energy budget [J].
    """
    count, calm = settings.declared.encoder_count, settings.calm_stiffness or settings.damped_stiffness
    soft = min(size, settings.sustained * depth)
    reserve = 0.5 * soft * (depth - count) if depth > count else 0.0
    spare = energy + bound.dissipated - reserve
    if spare < 0.0:
        left = 2.0 * (spare + reserve)
        return (soft if left >= reserve else soft * left / reserve if left > 0.0 else 0.0), 0.0
    blur = calm * count
    return soft, sqrt(blur * blur + 2.0 * calm * spare) - blur


def energy_permitted(
    settings: GuardedSettings, bound: TorqueBound, whole: float, energy: float, ceiling: float
) -> float:
    """Return the square of the largest effort of a spring that the account covers [N^2 or N^2*m^2].

    Args:
        settings: Constants of the run.
        bound: State of the torque bound; device dissipation beyond the need of the efforts is forgotten.
        whole: All efforts together [N or N*m].
        energy: Energy budget [J].
        ceiling: Energy stored at the true state [J].
    """
    enough = settings.earned
    if settings.damped_stiffness > 0.0:
        enough = max(enough, 0.5 * (whole * whole) / settings.damped_stiffness)
    keep(bound, energy, ceiling + enough)
    covered = settings.calm_stiffness * (energy + bound.dissipated)
    covered = 2.0 * max(covered, settings.damped_stiffness * (energy + for_any(bound)))
    held = settings.declared.friction + (sqrt(covered) if covered > 0.0 else 0.0)
    energy += max(0.0, bound.dissipated)
    if settings.path > 0.0 and energy > 0.0:
        held = max(held, settings.declared.friction + energy / settings.path)
    return held * held


def drag(settings: GuardedSettings, state: GuardedState, memory: Memory, moved: float) -> tuple[float, int]:
    """Return the torque out of contact and its certificate: a drag, until enough energy is earned [N or N*m].

    Args:
        settings: Constants of the run.
        state: State of the axis; earns while its energy is below `earned_energy`.
        memory: Buffers of the axis.
        moved: Displacement in a hold [m or rad].
    """
    bound, energy = state.bound, state.h_s - state.axis.h_dis + settings.credit
    if bound.dissipated > 0.0:
        fade(settings, state)
    if settings.drag == 0.0:
        return 0.0, _NOT_BOUND
    if settings.longest_window:
        energy = certain_energy(state, energy)
    if energy + bound.dissipated >= settings.earned:
        return 0.0, _NOT_BOUND
    step = state.axis.window.velocity * settings.sample_time if settings.longest_window else state.motion.step
    torque = -_DRAG_SHARE * settings.cap * step / settings.sample_time
    if torque == 0.0:
        return 0.0, _NOT_BOUND
    torque = min(max(torque, -settings.drag), settings.drag)
    size, certificate = permitted_size(settings, state, memory, torque, energy, moved)
    return towards_zero(copysign(size, torque), settings.quantum), certificate


_FREE, _START, _EXACT = Branch.FREE.value, Branch.START.value, Branch.EXACT.value
_STICKY, _DEPLETED = Branch.STICKY.value, Branch.DEPLETED.value
_EXIT, _UNBOUNDED = Branch.EXIT.value, Certificate.EXACT.value


def step(
    environment: Environment, run: Run[GuardedSettings, GuardedState, Memory], position: float, torque_applied: float
) -> EnergyBalance:
    """Account for the hold that ended; see `Controller.step`."""
    settings, state, memory = run.settings, run.state, run.memory
    zone_before, axis = state.zone, state.axis
    state.zone = zone = environment.contact(position)
    if not axis.started:
        return start(environment, settings, state, memory, position)
    holds, same = axis.missed + axis.lasted, zone == zone_before
    displacement, damper, modulated, uncertainty = end(settings, state, memory, position, torque_applied)
    true = environment.true_state(position, displacement, state.true if same else 0.0) if zone else 0.0
    if settings.turns:
        take_stretch(environment, settings, state.bound, position, true)
        look_for_turn(settings.declared, state.bound, memory.bound, displacement, holds)
    ceiling = environment.stored_energy(true) if zone else 0.0
    h_i, h_pas = -torque_applied * displacement - uncertainty, modulated * displacement  # `interaction_energy`
    h_r, deficit, leak, paid = book(settings, state, memory, h_i, h_pas, damper * displacement, ceiling)
    if zone:
        if environment.relaxes:
            true, ceiling, lost = relax(environment, settings, state, true, ceiling, holds)
            h_r += lost
        spring, moved = environment.effort(true), displacement / holds
        travel, inside = (true - state.true) / holds, moved
        if settings.longest_window or not same:
            travel, inside = motion_inside(environment, settings, axis, travel, displacement, holds, true, same)
        torque, damper, modulated, rendered, certificate = render(
            environment, settings, state, memory, true, spring, ceiling, travel, inside, moved, same)  # fmt: skip
        branch = _START if not same else _STICKY if h_i > 0.0 and displacement * spring < 0.0 else _EXACT
    else:
        torque, damper, modulated, rendered, certificate = 0.0, 0.0, 0.0, 0.0, _UNBOUNDED
        branch = _EXIT if zone_before or ((h_i != 0.0 or leak != 0.0) and settings.drag == 0.0) else _FREE
        if settings.drag or state.bound.dissipated > 0.0:
            torque, certificate = drag(settings, state, memory, displacement / holds)
    axis.oldest = send(memory.axis.commands, axis.oldest, torque, damper, modulated)
    state.true, h_s = true, state.h_s
    stored = true if h_s >= ceiling else environment.state_of_energy(h_s, true)
    return new(EnergyBalance, (
        torque, h_i, h_pas, h_i - h_pas, h_r, h_s, axis.h_dis, 0.0, deficit, leak, paid,
        _DEPLETED if deficit > 0.0 else branch, rendered, certificate, stored,
    ))  # fmt: skip


def start(
    environment: Environment, settings: GuardedSettings, state: GuardedState, memory: Memory, position: float
) -> EnergyBalance:
    """Take the first position [m or rad]; return the balance of a step that books nothing."""
    begin(state.axis, memory.axis, position)
    state.bound.out, state.bound.turns, state.bound.is_near = settings.outside, settings.turns, settings.turns
    return AT_REST


def take_stretch(environment: Any, settings: GuardedSettings, bound: TorqueBound, position: float, true: float) -> None:
    """Store the stretch around a position [m or rad] in which the effort points one way, and its torque's direction.

    The environment has `one_way` where `knows_turns` is true.
    """
    bound.out = bound.above = bound.below = 0.0
    effort = environment.effort(true) if settings.knows_turns and environment.contact(position) else 0.0
    if effort != 0.0:
        low, high = environment.one_way(position)
        bound.out, bound.above, bound.below = -copysign(1.0, effort), high - position, position - low


def motion_inside(
    environment: Environment, settings: GuardedSettings, axis: Axis, travel: float, displacement: float, holds: float,
    true: float, same: bool,
) -> tuple[float, float]:  # fmt: skip
    """Return the motion of storage and damper in a hold [m or rad], smoothed where an encoder is coarse.

    Args:
        environment: Environment rendered.
        settings: Constants of the run.
        axis: The axis, after its motion.
        travel: Motion of the storage in a hold, if the contact existed before [m or rad].
        displacement: Displacement since the last position [m or rad].
        holds: Number of holds since then.
        true: State of the storage [m or rad].
        same: Whether the contact existed before.
    """
    inside = displacement / holds
    if not same:
        travel = inside
    if settings.longest_window and not environment.relaxes:
        travel = inside = axis.window.velocity * settings.sample_time
    if not same:
        inside = (true - environment.admissible(true - displacement, true)) / holds
    return travel, inside


class Guarded(SteppedController):
    """An environment rendered as far as the certificates allow."""

    parameters_type: ClassVar[type[Parameters]] = GuardedParameters
    kernel: ClassVar[Kernel] = Kernel(settings_of, GuardedState, memory_of, step)

    def __init__(self, environment: Environment, parameters: GuardedParameters, loop: LoopProperties) -> None:
        super().__init__(environment, parameters, loop)
        self.max_consecutive_losses = parameters.max_consecutive_losses
        self.energy_allowance = parameters.energy_allowance

    @property
    def lacks_push(self) -> bool:
        """Whether the direction out of the environment changes while the hand's push is undeclared."""
        settings: GuardedSettings = self._settings
        return settings.turns and settings.declared.response.push == inf

    @property
    def energy_resolution(self) -> float:
        """Uncertainty of the sum of h_i where torques came late or samples were lost [J].

        Its lower end is booked.
        """
        resolution: float = self._state.bound.resolution
        return resolution

    def sample_lost(self) -> EnergyBalance:
        """Repeat the last command at a SYNC without a position; see `Controller.sample_lost`.

        The next `step` books the displacement over all holds with the torque read back, less the uncertainty.
        """
        return super().sample_lost()._replace(damping_rendered=0.0, certificate=_UNBOUNDED)
