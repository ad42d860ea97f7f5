"""Parameters of `guarded`, and the constants derived from them and from the loop.

Prediction of the axis to the hold in which the next torque acts: a model of the moving mass, corrected every hold.

With v the velocity at the last SYNC, f_1 ... f_n the queued torques and w the rest of the force on the mass,

    x_i = x_(i-1) + v_(i-1) T + (f_i + w) T^2 / 2m,   v_i = v_(i-1) + (f_i + w) T / m.

The displacement of the hold that ended corrects v at once: v = D/T + (f_0 + w) T / 2m. It corrects w by a small share,
so that at rest w is what the hand holds against the torque, and nothing is predicted. A prediction from the last
displacement alone has no f: one sample late it turns unstable at k T^2 / m = 0.01, and this one for no k that is
certified. The share is small because a mass that is declared too small makes w follow the torque. With the share of
1/16 that is taken here, no motion of a free mass at a spring that is certified grows for true masses up to 3 times the
declared one at a delay of one sample (2 times at two), and by no more than 0.51 % a hold for any. w has a rise that is
learnt in the same way, so that a hand that presses ever harder is followed.
"""

from dataclasses import dataclass, replace
from functools import lru_cache
from math import expm1, inf
from typing import Annotated, Final

from canhaptic.control.certificates.scalar_bounds import (
    NO_RESPONSE,
    DisplacementResponse,
    displacement_response,
    renderable_by_device_damping,
    renderable_by_hand_force,
    start_energy,
    sustained_by_friction,
)
from canhaptic.control.certificates.torque_bound import Declared
from canhaptic.control.damping import Alpha, damping_cap
from canhaptic.control.environments.environment import Environment, knows_turns, outside_of
from canhaptic.control.passivity.controller import LoopProperties
from canhaptic.errors import ParameterError
from canhaptic.kernels import Buffer
from canhaptic.units import Parameters, quantity

PREDICTION_HOLDS: Final = 0.75
"""Prediction beyond the delay [holds]: 0.5 aims at the middle of the hold, and a larger value calms a spring."""
_LEARNT: Final = 0.0625
"""Share of a prediction error that corrects the force of the hand in a hold."""
_RISE_LEARNT: Final = _LEARNT * _LEARNT / 4.0
"""The same for its rate of change."""
_QUIET: Final = 0.25
"""Share of an error that corrects the velocity where counts of the encoder can explain it."""
_COUNTS: Final = 4.0
"""Error that counts of the encoder can explain [counts]."""


@dataclass(frozen=True, slots=True)
class PredictionSettings:
    """Constants of a run."""

    gain: float  # T^2 / m: displacement per hold that a torque adds in one [m/N or rad/(N*m)]; 0: mass not known
    lost: float  # 1 - e^(-b T / m): share of a motion that certain damping of the device takes in a hold
    delay: int  # whole holds between computation and action
    beyond: float  # holds aimed at beyond those under way
    noise: float  # error that the encoder can explain [m or rad]


@dataclass(slots=True)
class PredictedMotion:
    """Motion at the last SYNC."""

    step: float = 0.0  # velocity [m or rad per hold]
    push: float = 0.0  # increase of it in a hold by forces other than the motor's
    rise: float = 0.0  # increase of that in a hold


def prediction_settings(
    mass: float | None, damping: float, sample_time: float, delay: int, beyond: float, count: float
) -> PredictionSettings:
    """Constants of a run.

    Args:
        mass: Moving mass [kg or kg*m^2]; None: unknown.
        damping: Certain damping of the device [N*s/m or N*m*s/rad].
        sample_time: Sample time [s].
        delay: Whole holds between computation and action.
        beyond: Additional holds of prediction after the queued ones.
        count: Encoder count [m or rad]; 0: ideal.
    """
    if mass is None:
        return PredictionSettings(0.0, 0.0, delay, beyond, _COUNTS * count)
    lost = -expm1(-damping * sample_time / mass)
    return PredictionSettings(sample_time * sample_time / mass, lost, delay, beyond, _COUNTS * count)


def observe(settings: PredictionSettings, motion: PredictedMotion, displacement: float, torque: float) -> None:
    """Take the hold that ended: displacement [m or rad] and the torque held in it [N or N*m]."""
    gain, step, noise = settings.gain, motion.step, settings.noise
    push = gain * torque + motion.push - settings.lost * step
    error = displacement - step - 0.5 * push
    if gain > 0.0:
        rise = motion.rise + _RISE_LEARNT * error
        motion.rise = rise
        motion.push += rise + _LEARNT * error
    motion.step = step + (push + (_QUIET * error if -noise < error < noise else error))


def observe_mean(motion: PredictedMotion, displacement: float) -> None:
    """Take the mean displacement per hold [m or rad] of several holds with unknown separate displacements."""
    motion.step = displacement


def predicted(
    settings: PredictionSettings, motion: PredictedMotion, torques: Buffer, first: int, travel: float
) -> tuple[float, float]:
    """Predicted displacement of the axis where the next torque acts, and its motion in a hold there [m or rad].

    Args:
        settings: Constants of the run.
        motion: Motion at the last SYNC.
        torques: Ring of torques, queued ones included [N or N*m].
        first: Index of the torque that acts first; negative indices wrap.
        travel: Present motion per hold [m or rad], used where a coarse encoder resolves nothing finer.
    """
    way, step, gain, lost, rest = 0.0, motion.step, settings.gain, settings.lost, motion.push
    for place in range(first, first + settings.delay):
        push = gain * torques[place] + rest - lost * step
        way += step + 0.5 * push
        step += push
    way += settings.beyond * step
    if -settings.noise < travel < settings.noise:
        share, steady = abs(travel) / settings.noise, (settings.delay + settings.beyond) * travel
        way, step = steady + (way - steady) * share, travel + (step - travel) * share
    return way, step


_LONGEST_WINDOW: Final = 0.02
"""Longest window of the velocity from a coarse encoder [s]."""
_NO_CAP: Final = 1e12
"""Cap of the damping when the moving mass is unknown [N*s/m, N*m*s/rad]: finite, so that at rest it gives no force."""

_LARGEST: Final = 1e9  # [N or N*m]


class GuardedParameters(Parameters):
    """Assumptions behind the certificates of an axis or a group. Mass and damping of the device belong to the loop.

    A group refuses keys that only one axis can honour: `drag`, `earned_energy`, and a `hand_push` above `hand_force`.
    """

    hand_force: Annotated[float, quantity("N", "N*m", ge=0.0)] | None = 0.0
    """Largest force with which the hand pulls out of the contact: along the torque of its effort, where the handle is.
    In a group, on each motor axis along any torque, Coriolis forces included. None: the certificate is not used."""
    hand_push: Annotated[float, quantity("N", "N*m", ge=0.0)] | None = None
    """Largest force with which the hand pushes into the contact, against that torque. It certifies torques that pull
    the handle back while it leaves the contact (of a damper). None: not known, and the hand force certifies no such
    torque. Where an environment has more than one way out, or none (detents, a slot, a medium), it is needed: near each
    place where the way turns, or without an effort, the hand may do either way the larger of both. In a group
    `hand_force` counts for it."""
    hand_speed: Annotated[float, quantity("m/s", "rad/s", gt=0.0)] | None = None
    """Largest speed of the hand, in a group of every motor axis. None: the certificate is not used. Alone it begins
    only with an energy allowance."""
    energy_allowance: Annotated[float, quantity("J", ge=0.0)] = 0.0
    """Energy that may be given out before any came in: the promise becomes sum(h_i) >= -energy_allowance."""
    earned_energy: Annotated[float, quantity("J", ge=0.0)] | None = None
    """Energy that came in beyond what is stored, or that the device dissipated, kept for later contacts, so that a
    contact under a hand force starts at any speed. sum(h_i) stays >= 0. None: as much as the environment needs for
    that, by the hand's force or speed, and none in a group; 0: none."""
    drag: Annotated[float, quantity("N", "N*m", ge=0.0)] = 0.0
    """Largest drag felt in free motion, while less than `earned_energy` is stored; 0: none. There too the hand pulls
    away from the environment with no more than `hand_force`."""
    alpha: Alpha = 0.0
    """Modulated damping per joule of surplus (eq. 19), always with its unit; 0: the surplus is not removed."""
    max_consecutive_losses: Annotated[int, quantity("count", ge=0, le=16)] = 0
    """Consecutive cycles without a new torque at the drive, of any axis of a group, that the certificates survive; each
    costs stiffness. 0 in a group: all axes always apply together what was sent."""


@dataclass(frozen=True, slots=True)
class GuardedSettings:
    """Constants of a run."""

    sample_time: float  # [s]
    credit: float  # [J]
    earned: float  # energy kept for later contacts [J]
    drag: float  # in free motion [N or N*m]
    outside: float  # direction away from the environment, 1 or -1; 0 where it has not one
    turns: bool  # whether it has not, and the force of the hand counts
    knows_turns: bool  # whether the environment tells where
    alpha: float  # [s/m^2 or s/rad^2]
    torque_limit: float  # largest torque that limiter and drive let act [N or N*m]
    least_limit: float  # torque up to which no limit cuts [N or N*m]
    torque_step: float  # largest rise from SYNC to SYNC [N or N*m]
    power_limit: float  # that the torque may put into the user's side [W]
    quantum: float  # of the torque command; 0: ideal [N or N*m]
    lead: float  # prediction [holds]
    cap: float  # of the damping [N*s/m or N*m*s/rad]
    damping: float  # rendered where no energy is short [N*s/m or N*m*s/rad]
    calm: float  # stiffness of the largest spring that the rate renders; a prediction counts for no more
    calm_stiffness: float  # of the energy-permitted spring; 0 without a hand force [N/m or N*m/rad]
    damped_stiffness: float  # of the same, by the damping of the device; 0 where it is not declared
    sustained: (
        float  # stiffness that certain dry friction holds for ever with this encoder; 0: not used [N/m or N*m/rad]
    )
    path: float  # of the hand in the holds that a torque takes; 0 without a hand speed [m or rad]
    prediction: PredictionSettings
    longest_window: int  # of the velocity, in samples; 0 with an ideal encoder
    declared: Declared


def settings_of(environment: Environment, parameters: GuardedParameters, loop: LoopProperties) -> GuardedSettings:
    """Constants of a run.

    Raises:
        ParameterError: No declared property certifies any torque, or too few do; a drag that earns nothing.
    """
    of_loop, outside = _settings_of_loop(parameters, loop), outside_of(environment)
    response, turns = of_loop.declared.response, of_loop.declared.by_hand_force and not outside
    if turns and response.push < inf:
        response = replace(response, hand=response.push)
    response = replace(response, brake=0.0)  # a contact begins with a motion inward, in which friction pulls
    return replace(
        of_loop,
        earned=kept_for_contacts(environment, parameters, loop, response),
        outside=outside,
        turns=turns,
        knows_turns=turns and knows_turns(environment),
        damping=min(environment.damping, of_loop.cap),
    )


@lru_cache(maxsize=4)
def _settings_of_loop(parameters: GuardedParameters, loop: LoopProperties) -> GuardedSettings:
    """Settings that do not depend on the environment; cached, for a sweep needs them for every scene.

    Raises:
        ParameterError: No declared property certifies any torque, or too few do.
    """
    sample_time, mass, damping = loop.sample_time, loop.moving_mass, loop.device_damping or 0.0
    timing, response, speed = loop.timing, hand_response(parameters, loop), parameters.hand_speed or 0.0
    by_hand_force = response is not NO_RESPONSE
    _require_certifiable(parameters, loop, by_hand_force=by_hand_force)
    cap, late = min(_NO_CAP, damping_cap(loop.delay, mass, sample_time)), timing.late / sample_time
    damped, calm = renderable_by_device_damping(damping, sample_time, loop.delay), calm_stiffness_of(loop)
    return GuardedSettings(
        sample_time=sample_time,
        credit=parameters.energy_allowance,
        earned=0.0,
        drag=parameters.drag,
        outside=0.0,
        turns=False,
        knows_turns=False,
        alpha=parameters.alpha,
        torque_limit=loop.torque_limit or inf,
        least_limit=0.0 if loop.torque_rate_limit or loop.power_limit else loop.torque_limit or inf,
        torque_step=(loop.torque_rate_limit or inf) * sample_time,
        power_limit=loop.power_limit or inf,
        quantum=loop.torque_quantum,
        lead=PREDICTION_HOLDS + loop.delay + late,
        cap=cap,
        damping=cap,
        calm=calm,
        calm_stiffness=calm if by_hand_force else 0.0,
        damped_stiffness=damped,
        sustained=sustained_by_friction(loop.device_friction or 0.0, loop.encoder_count),
        path=speed * sample_time * (1 + loop.delay),
        prediction=prediction_settings(
            mass, damping, sample_time, loop.delay, PREDICTION_HOLDS + late, loop.encoder_count
        ),
        longest_window=max(2, round(_LONGEST_WINDOW / sample_time)) if loop.encoder_count else 0,
        declared=declared_of(parameters, loop, response),
    )


def kept_for_contacts(
    environment: Environment, parameters: GuardedParameters, loop: LoopProperties, response: DisplacementResponse
) -> float:
    """Energy that is kept for later contacts [J]; see `start_energy`.

    If the environment is not a spring, or is stiffer than half what the certificate permits at the largest force, it is
    the energy for that half, which allows any contact up to a push of half the hand's pull.

    Raises:
        ParameterError: A drag that earns nothing.
    """
    kept, stiffness = parameters.earned_energy, environment.linear_stiffness
    if kept is None and response is not NO_RESPONSE and response.hand > 0.0 and stiffness != 0.0:
        holds = loop.delay + parameters.max_consecutive_losses
        half = 0.5 * renderable_by_hand_force(response, holds, _LARGEST)
        kept = start_energy(response, holds, half if stiffness is None else min(stiffness, half))
    if parameters.drag > 0.0 and not kept:
        raise ParameterError(
            f"guarded: got drag {parameters.drag:g} with earned_energy 0, expected the energy it is to earn; "
            "the drag acts until that is stored: declare earned_energy, for example 5 mJ, or leave out drag"
        )
    return kept or 0.0


def _require_certifiable(parameters: GuardedParameters, loop: LoopProperties, *, by_hand_force: bool) -> None:
    if not (by_hand_force or loop.device_damping or loop.device_friction or parameters.hand_speed):
        raise ParameterError(
            "guarded: got neither moving_mass with hand_force, nor device_damping, nor device_friction, nor "
            "hand_speed, expected one of them; without one of them no torque can be certified: declare what is known "
            "(--set passivity.moving_mass=0.2 --set passivity.hand_force=0) or choose another algorithm"
        )


def declared_of(parameters: GuardedParameters, loop: LoopProperties, response: DisplacementResponse) -> Declared:
    """Declared properties behind the certificates."""
    timing, by_hand_force = loop.timing, response is not NO_RESPONSE
    damping, friction, speed = loop.device_damping or 0.0, loop.device_friction or 0.0, parameters.hand_speed or 0.0
    return Declared(
        timing.longest,
        loop.delay,
        parameters.max_consecutive_losses,
        by_hand_force,
        response,
        damping,
        speed,
        loop.encoder_count,
        timing.late,
        timing.late / timing.shortest,
        timing.left,
        friction,
        by_hand_force and not (damping or friction or speed),
    )


def calm_stiffness_of(loop: LoopProperties) -> float:
    """Largest stiffness rendered without oscillation at this rate [N/m or N*m/rad]."""
    if loop.moving_mass is None:
        return _NO_CAP
    ideal = displacement_response(loop.sample_time, loop.moving_mass, 0.0, 0.0, 0.0, 0.0, loop.timing)
    damped = renderable_by_device_damping(loop.device_damping or 0.0, loop.sample_time, loop.delay)
    return max(damped, renderable_by_hand_force(ideal, loop.delay, 1.0))


def hand_response(parameters: GuardedParameters, loop: LoopProperties) -> DisplacementResponse:
    """Return the response of the hand-force certificate; `NO_RESPONSE` where that is not declared.

    Raises:
        ParameterError: The damping of the device has no upper bound.
    """
    if parameters.hand_force is None or loop.moving_mass is None:
        return NO_RESPONSE
    if loop.device_damping_bound is None:
        raise ParameterError(
            "guarded: got hand_force without device_damping_bound, expected the largest damping that the device can "
            "have: more damping would stop an inward motion earlier; measure it (canhaptic commission), or declare "
            "hand_force: null and another certificate"
        )
    friction, push = loop.device_friction_bound or 0.0, parameters.hand_push
    stiffness, braking = loop.presliding_stiffness or inf, 0.0
    if loop.presliding_stiffness is not None and loop.device_cogging_bound is not None:
        braking = max(0.0, friction - loop.device_cogging_bound)
    return displacement_response(
        loop.sample_time,
        loop.moving_mass,
        parameters.hand_force + friction,
        loop.device_damping or 0.0,
        loop.device_damping_bound,
        inf if push is None else push + friction,
        loop.timing,
        (braking, stiffness),
    )
