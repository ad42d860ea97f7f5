"""The torque of `guarded` for the next free hold: the requested one, within account and certificates."""

from math import copysign, inf, sqrt
from typing import Final

from canhaptic.control.balance import Certificate
from canhaptic.control.certificates.certified_torque import largest_torques
from canhaptic.control.certificates.torque_bound import TorqueBound, for_any, keep, open_both_ways
from canhaptic.control.environments.environment import Environment
from canhaptic.control.passivity.guarded_account import GuardedState, Memory, fade
from canhaptic.control.passivity.guarded_settings import GuardedSettings
from canhaptic.control.passivity.in_flight import towards_zero
from canhaptic.control.passivity.prediction import predicted
from canhaptic.control.recovery import modulated_damping

_UNBOUNDED, _BY_FORCE = Certificate.EXACT.value, Certificate.HAND_FORCE.value
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
        spring: Effort there [N or N*m].
        ceiling: Energy stored there [J].
        travel: Motion of the storage in a hold [m or rad].
        inside: Motion of the axis in contact, in a hold [m or rad].
        moved: Motion of the axis in a hold [m or rad].
        same: Whether the contact was there before.
    """
    bound, energy = state.bound, state.h_s - state.axis.h_dis + settings.credit
    if settings.longest_window:
        energy = certain_energy(state, energy)
    ahead = steady = settings.lead * travel
    if not environment.relaxes:
        ahead, coming = predicted(settings.prediction, state.motion, memory.bound.under_way, bound.first, travel)
        if state.h_s < ceiling and steady * true > 0.0 and steady * true > ahead * true:
            ahead = steady  # going in, more may be taken in where the account is short
        if same:
            inside = coming
    lead = environment.effort(environment.admissible(true + ahead, true)) - spring
    velocity = inside / settings.sample_time
    spring, lead, damper, covered = efforts(settings, bound, spring, lead, ahead, velocity, energy, ceiling)
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
        return torque, damper, modulated, rendered, _UNBOUNDED
    size, certificate = permitted_size(settings, state, memory, torque, energy, moved)
    asked = abs(torque)
    if size < asked:
        share = size / asked
        torque, damper, modulated, rendered = torque * share, damper * share, modulated * share, rendered * share
    elif covered:
        certificate = _UNBOUNDED
    if settings.quantum > 0.0:
        torque = towards_zero(torque, settings.quantum)
    return torque, damper, modulated, rendered, certificate


def permitted_size(
    settings: GuardedSettings, state: GuardedState, memory: Memory, torque: float, energy: float, moved: float
) -> tuple[float, int]:
    """Largest permitted size of a torque, up to its own [N or N*m], and its certificate.

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
    largest, for_all, by_force = largest_torques(settings.declared, state.bound, memory.bound, sign, energy)
    if size > largest:
        size = largest
    if size <= settings.declared.friction:
        return size, _BY_FRICTION
    return size, _BY_DAMPING if for_all >= size else _BY_FORCE if by_force >= size else _BY_SPEED


def certain_energy(state: GuardedState, energy: float) -> float:
    """Part of an energy that the next torques may give out with an encoder of finite resolution [J].

    Energy that was dissipated or leaked cannot be given out again, but it covers the uncertainty of the encoder: (4)
    holds for the energy of the account, (3) for the true one.
    """
    lacking = state.bound.unsure - state.kept_back
    return energy - lacking if lacking > 0.0 else energy


def within_limits(settings: GuardedSettings, newest: float, sign: float, moved: float) -> float:
    """Return the largest torque along `sign` that the limiter lets pass [N or N*m]; see `drive.profile.limiter`.

    What it cuts after a torque was certified would take energy in no more on which the next one counts.

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


def energy_permitted(
    settings: GuardedSettings, bound: TorqueBound, whole: float, energy: float, ceiling: float
) -> float:
    """Return the square of the largest effort of a spring that the account covers [N^2 or N^2*m^2].

    Args:
        settings: Constants of the run.
        bound: State of the torque bound; device dissipation beyond what the efforts need is forgotten.
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
    """Return the torque out of contact and its certificate: a drag, until enough is earned [N or N*m].

    Args:
        settings: Constants of the run.
        state: State of the axis; it goes on earning while its energy is below `earned_energy`.
        memory: Buffers of the axis.
        moved: Displacement in a hold [m or rad].
    """
    bound, energy = state.bound, state.h_s - state.axis.h_dis + settings.credit
    if bound.dissipated > 0.0:
        fade(settings, state)
    if settings.drag == 0.0:
        return 0.0, _UNBOUNDED
    if settings.longest_window:
        energy = certain_energy(state, energy)
    if energy + bound.dissipated >= settings.earned:
        return 0.0, _UNBOUNDED
    step = state.axis.window.velocity * settings.sample_time if settings.longest_window else state.motion.step
    torque = -_DRAG_SHARE * settings.cap * step / settings.sample_time
    if torque == 0.0:
        return 0.0, _UNBOUNDED
    if settings.outside == 0.0:  # which way is out is not known here
        open_both_ways(settings.declared, bound)
    torque = min(max(torque, -settings.drag), settings.drag)
    size, certificate = permitted_size(settings, state, memory, torque, energy, moved)
    return towards_zero(copysign(size, torque), settings.quantum), certificate
