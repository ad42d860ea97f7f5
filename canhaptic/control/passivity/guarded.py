"""`guarded`: the paper's energy balance with a certified bound on the torque of every hold. The default for rigs.

**Rendering.** The environment is rendered at its true state, predicted to the hold in which the torque acts. If the
torque has the value of the middle of its hold, a spring absorbs and gives back as much energy as a continuous one. If
it has the value of the start, the spring returns k D^2 / 2 too much in every hold: this is the energy that a sampled
wall creates. Predicting a quarter of a hold further damps the oscillation of a spring without a damper. The damper uses
the predicted velocity too.

**Account.** It is eq. 8 with the damper between port and ground: it dissipates h_r = f_d D in a hold of displacement D,
with f_d the damper's part of the applied torque. h_r is never negative, and never uses energy that the queued torques
need. No energy is created at the start of contact: the stored energy begins at zero, and pushing in fills it. What the
account does not cover is not rendered:

* the spring effort is limited to that of a spring with the energy in the account and the largest certified stiffness;
* beyond it, only while moving inward, a damper brings in the missing energy, all of it stored; and a spring whose
  account is short is predicted as if no torque slowed the axis down;
* the torque stays below what all certificates together permit (`certified_torque`). A certificate is a proof, from
  declared properties of hand or device, that the torques sent keep the promise below.

Energy received beyond what is stored (from a drag in free motion, or a wall left behind), or dissipated by the device,
is kept for later contacts up to `earned_energy`. From zero energy no torque begins below an inward speed of
(1 + delay) F_h T / m: a hand of F_h could turn every slower motion outward before the torque ends, so that energy would
come out first. Only certain dissipation of the device allows a slower start.

**Promise.** sum(h_i) >= 0 for every user without exception admits no torque at all: any torque relies on a known
property of the hand or of the device. A hand force of 0 is the usual setting. It covers every hand that does not pull
the axis along the torque, and promises nothing for another hand. If stiffness or damping cannot be rendered, the
environment gets softer and the balance shows it: `certificate` is not EXACT, or `damping_rendered` is below the
requested damping.

**Prediction.** A model of the moving mass predicts the axis to the hold in which the next torque acts. With v the
velocity at the last SYNC, f_1 ... f_n the queued torques and w the rest of the force on the mass,

    x_i = x_(i-1) + v_(i-1) T + (f_i + w) T^2 / 2m,   v_i = v_(i-1) + (f_i + w) T / m.

The displacement of the hold that ended corrects v at once: v = D/T + (f_0 + w) T / 2m. It corrects w by a small share,
so that at rest w balances the torque and no motion is predicted. A prediction from the last displacement alone omits f:
with a delay of one sample it becomes unstable at k T^2 / m = 0.01, and this one at no certified k. The share is small
because w follows the torque if the mass is declared too small. With the share of 1/16 used here, no motion of a free
mass at a certified spring grows for true masses up to 3 times the declared one at a delay of one sample (2 times at
two), and by at most 0.51 % a hold for any mass. The rate of change of w is learnt in the same way, so that the
prediction follows a hand that presses harder and harder.
"""

from dataclasses import dataclass, field, replace
from functools import lru_cache
from math import copysign, expm1, inf, sqrt
from typing import Annotated, Any, ClassVar, Final, NamedTuple, TypeAlias

from canhaptic.control.balance import AT_REST, Branch, Certificate, EnergyBalance
from canhaptic.control.certificates import scalar_bounds
from canhaptic.control.certificates.certified_torque import (
    BoundMemory,
    Declared,
    TorqueBound,
    bound_memory,
    certain_dissipation,
    end_gap,
    end_hold,
    free_energy,
    keep,
    largest_torques,
    look_for_turn,
    reaches_turn,
    shorten,
)
from canhaptic.control.certificates.scalar_bounds import DisplacementResponse
from canhaptic.control.damping import Alpha, damping_cap, modulated_damping, restart, update
from canhaptic.control.environments import Environment, outside_of
from canhaptic.control.environments import knows_turns as tells_turns
from canhaptic.control.passivity import LoopProperties, stepped
from canhaptic.control.passivity.stepped import begin, clipped, efforts_inside, repeat, send, settle, towards_zero
from canhaptic.errors import ParameterError
from canhaptic.kernels import OFTEN_ZERO, Buffer, Kernel, MakeBuffer, Run, new
from canhaptic.units import Parameters, quantity

PREDICTION_HOLDS: Final = 0.75
"""Time of prediction beyond the delay [holds]: 0.5 is the middle of the hold; more damps a spring's oscillation."""
_LEARNT: Final = 0.0625
"""Share of the error of a predicted displacement that corrects the estimated force on the axis, once per hold."""
_RISE_LEARNT: Final = _LEARNT * _LEARNT / 4.0
"""Share of that error that corrects the rate of change of the estimated force, once per hold."""
_QUIET: Final = 0.25
"""Share of that error that corrects the estimated velocity, if the encoder's resolution can explain the error."""
_COUNTS: Final = 4.0
"""Largest prediction error that the encoder's resolution can explain [counts]."""


@dataclass(frozen=True, slots=True)
class PredictionSettings:
    """Constants of the motion prediction, fixed for a run."""

    gain: float  # T^2 / m: displacement per hold that a torque adds in one [m/N or rad/(N*m)]; 0: mass not known
    lost: float  # 1 - e^(-b T / m): share of a motion that certain damping of the device takes in a hold
    delay: int  # whole holds between computation and action
    beyond: float  # holds aimed at beyond those under way
    noise: float  # error that the encoder can explain [m or rad]


@dataclass(slots=True)
class PredictedMotion:
    """Estimated motion of the axis at the last SYNC, from which it is predicted."""

    step: float = 0.0  # velocity [m or rad per hold]
    push: float = 0.0  # increase of it in a hold by forces other than the motor's
    rise: float = 0.0  # increase of that in a hold


def prediction_settings(loop: LoopProperties, beyond: float) -> PredictionSettings:
    """Return the constants of the motion prediction.

    Args:
        loop: Properties of the loop; if its moving mass is not declared, the prediction ignores the torques.
        beyond: Time to predict after the holds of the queued torques [holds].
    """
    mass, noise = loop.moving_mass, _COUNTS * loop.encoder_count
    if mass is None:
        return PredictionSettings(0.0, 0.0, loop.delay, beyond, noise)
    lost = -expm1(-(loop.device_damping or 0.0) * loop.sample_time / mass)
    return PredictionSettings(loop.sample_time * loop.sample_time / mass, lost, loop.delay, beyond, noise)


def observe(settings: PredictionSettings, motion: PredictedMotion, displacement: float, torque: float) -> None:
    """Correct the estimated motion, given displacement [m or rad] and torque [N or N*m] of the hold that ended."""
    gain, step, noise = settings.gain, motion.step, settings.noise
    push = gain * torque + motion.push - settings.lost * step
    error = displacement - step - 0.5 * push
    if gain > 0.0:
        rise = motion.rise + _RISE_LEARNT * error
        motion.rise = rise
        motion.push += rise + _LEARNT * error
    motion.step = step + (push + (_QUIET * error if -noise < error < noise else error))


def observe_mean(motion: PredictedMotion, displacement: float) -> None:
    """Set the estimated velocity to the mean displacement per hold [m or rad], after lost samples or skipped SYNCs."""
    motion.step = displacement


def predicted(
    settings: PredictionSettings, motion: PredictedMotion, torques: Buffer, first: int, travel: float
) -> tuple[float, float]:
    """Predict the displacement until the next torque acts, and the displacement per hold at that time [m or rad].

    Args:
        settings: Constants of the prediction.
        motion: Motion at the last SYNC.
        torques: Ring buffer of the sent torques, the queued ones included [N or N*m].
        first: Index of the torque that acts first; negative indices wrap.
        travel: Measured displacement per hold [m or rad], used for motions too slow for the encoder's resolution.
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
"""Longest window of the velocity estimate from an encoder with counts [s]."""
_NO_CAP: Final = 1e12
"""Limit of the damping if the moving mass is unknown [N*s/m, N*m*s/rad]: finite, so that it gives no force at rest."""

_LARGEST: Final = 1e9  # [N or N*m]


class GuardedParameters(Parameters):
    """Declared properties of the hand, and other choices, for `guarded` on an axis or a group.

    A group refuses what only a single axis supports: `drag`, `earned_energy`, and a `hand_push` above `hand_force`.
    """

    hand_force: Annotated[float, quantity("N", "N*m", ge=0.0)] | None = 0.0
    """Largest force with which the hand pulls out of the contact, along the torque of the environment at the handle.
    In a group, on each motor axis along any torque, Coriolis forces included. None: no torque relies on it."""
    hand_push: Annotated[float, quantity("N", "N*m", ge=0.0)] | None = None
    """Largest force with which the hand pushes into the contact, against the torque of the environment. It certifies a
    damper's torque that pulls the handle back while it leaves the contact. None: not known, and the hand force
    certifies no such torque. Environments with several ways out or none (detents, a slot, a medium) need it: where the
    effort is 0 or about to reverse, the hand may apply the larger of `hand_force` and `hand_push` in both directions.
    In a group `hand_force` takes its place."""
    hand_speed: Annotated[float, quantity("m/s", "rad/s", gt=0.0)] | None = None
    """Largest speed of the hand; in a group, of every motor axis. None: the certificate is not used. As the only
    certificate it permits torque only with an energy allowance."""
    energy_allowance: Annotated[float, quantity("J", ge=0.0)] = 0.0
    """Energy that may be returned to the user beyond what was received: the promise becomes
    sum(h_i) >= -energy_allowance."""
    earned_energy: Annotated[float, quantity("J", ge=0.0)] | None = None
    """Largest energy kept for later contacts, so that a contact under a hand force starts at any speed: energy received
    beyond what is stored, or dissipated by the device. sum(h_i) stays >= 0. None: as much as the environment needs for
    that under the declared `hand_force`, and 2000 f_c count, which a hand's tremor may use up; in a group, none. 0: no
    energy is kept."""
    drag: Annotated[float, quantity("N", "N*m", ge=0.0)] = 0.0
    """Largest braking force in free motion, until `earned_energy` is stored; 0: none. In free motion too, the hand has
    to pull away from the environment with no more than `hand_force`, and where torques come late to push towards it
    with no more than `hand_push`."""
    alpha: Alpha = 0.0
    """Modulated damping per joule of surplus (eq. 19), always with its unit; 0: the surplus is not removed."""
    max_consecutive_losses: Annotated[int, quantity("count", ge=0, le=16)] = 0
    """Largest number of consecutive cycles without a new torque at the drive, in a group at any of its drives, that the
    certificates cover; each costs stiffness. 0 in a group: all axes always apply the torques of the same SYNC."""


@dataclass(frozen=True, slots=True)
class GuardedSettings:
    """Constants of `guarded` on one axis during a run."""

    sample_time: float  # [s]
    allowance: float  # [J]
    drag: Annotated[float, OFTEN_ZERO]  # in free motion [N or N*m]
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
    sustained: float  # stiffness that dry friction sustains with this encoder; 0: not used [N/m or N*m/rad]
    driven: float  # speed inward from which a hold brings in more than the encoder leaves uncertain [m/s or rad/s]
    path: float  # of the hand in the holds that a torque takes; 0 without a hand speed [m or rad]
    prediction: PredictionSettings
    longest_window: int  # of the velocity, in samples; 0 with an ideal encoder
    declared: Declared
    earned: float = 0.0  # energy kept for later contacts [J]
    outside: float = 0.0  # direction out of the environment, 1 or -1; 0: it has none or several
    turns: Annotated[bool, OFTEN_ZERO] = False  # whether it has none or several, with a declared hand force
    knows_turns: bool = False  # whether the environment states where its effort reverses
    by_place: Annotated[bool, OFTEN_ZERO] = False  # whether it is a sum, whose damping depends on the place


def settings_of(environment: Environment, parameters: GuardedParameters, loop: LoopProperties) -> GuardedSettings:
    """Return the constants of `guarded` on one axis.

    Raises:
        ParameterError: No torque can be certified from the declared properties, or `drag` is set without an
            `earned_energy` to collect.
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
        knows_turns=turns and tells_turns(environment),
        damping=min(environment.damping, of_loop.cap),
        by_place=getattr(environment, "damps_by_place", False),
    )


@lru_cache(maxsize=4)
def _settings_of_loop(parameters: GuardedParameters, loop: LoopProperties) -> GuardedSettings:
    """Return the settings that do not depend on the environment; cached, because a sweep needs them in every run.

    Raises:
        ParameterError: The declared properties certify no torque.
    """
    sample_time, mass, damping = loop.sample_time, loop.moving_mass, loop.device_damping or 0.0
    timing, response, speed = loop.timing, hand_response(parameters, loop), parameters.hand_speed or 0.0
    by_hand_force = response is not scalar_bounds.NO_RESPONSE
    _require_certifiable(parameters, loop, by_hand_force=by_hand_force)
    cap, late = min(_NO_CAP, damping_cap(loop.delay, mass, sample_time)), timing.late / sample_time
    damped, calm = scalar_bounds.renderable_by_device_damping(damping, sample_time, loop.delay), calm_stiffness_of(loop)
    return GuardedSettings(
        sample_time=sample_time,
        allowance=parameters.energy_allowance,
        drag=parameters.drag,
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
        sustained=scalar_bounds.sustained_by_friction(loop.device_friction or 0.0, loop.encoder_count),
        driven=_DRIVEN * loop.encoder_count / sample_time,
        path=speed * sample_time * (1 + loop.delay),
        prediction=prediction_settings(loop, PREDICTION_HOLDS + late),
        longest_window=max(2, round(_LONGEST_WINDOW / sample_time)) if loop.encoder_count else 0,
        declared=declared_of(parameters, loop, response),
    )


_DRIVEN: Final = 4.0
"""Counts that a hold moves inward, from which the energy that comes in exceeds what the encoder leaves uncertain."""
_LEANT: Final = 0.125
"""Part of the torque limit for a spring of which energy is kept, where dry friction is declared."""
_SWINGS: Final = 1000
"""Times that a hand in tremor may cross a count, for which energy is kept: at twice the stiffness that friction
sustains each costs 2 f_c times the count, and a wall that has lost it gets softer for good."""


def kept_for_contacts(
    environment: Environment, parameters: GuardedParameters, loop: LoopProperties, response: DisplacementResponse
) -> float:
    """Return the most energy that the account keeps to start later contacts [J]; see `start_energy`.

    If not declared, it is the energy for a spring of the environment's stiffness, or of the steepest slope of a sum (N4
    of `docs/theory/sums.md`). A stiffness above half of what the
    certificate permits at the largest force, or an environment that is no spring, counts as that half. This allows any
    contact up to a push of half the hand's pull. What a hand's tremor over counts may use up is kept as well.

    Raises:
        ParameterError: `drag` is set, but the energy kept is 0.
    """
    kept, stiffness = parameters.earned_energy, environment.linear_stiffness
    if stiffness is None:
        stiffness = getattr(environment, "steepest", None)
    if kept is None and response is not scalar_bounds.NO_RESPONSE and response.hand > 0.0 and stiffness != 0.0:
        holds = loop.delay + parameters.max_consecutive_losses
        half = 0.5 * scalar_bounds.renderable_by_hand_force(response, holds, _LARGEST)
        kept = scalar_bounds.start_energy(response, holds, half if stiffness is None else min(stiffness, half))
    if parameters.earned_energy is None and stiffness != 0.0:
        tremor = _SWINGS * 2.0 * (loop.device_friction or 0.0) * loop.encoder_count
        leaning = 0.5 * (_LEANT * (loop.torque_limit or 0.0)) ** 2 / calm_stiffness_of(loop) if tremor else 0.0
        kept = (kept or 0.0) + max(tremor, leaning)
    if parameters.drag > 0.0 and not kept:
        raise ParameterError(
            f"guarded: got drag {parameters.drag:g} with earned_energy 0, expected more than 0: the drag acts "
            "until that energy is stored; declare earned_energy, for example 5 mJ, or leave out drag"
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
    """Return the declared properties of loop, device and hand from which the certificates are computed."""
    timing, by_hand_force = loop.timing, response is not scalar_bounds.NO_RESPONSE
    damping, friction, speed = loop.device_damping or 0.0, loop.device_friction or 0.0, parameters.hand_speed or 0.0
    return Declared(
        timing.longest, loop.delay, parameters.max_consecutive_losses, by_hand_force, response, damping, speed,
        loop.encoder_count, timing.late, timing.late / timing.shortest, timing.left, friction,
        by_hand_force and not (damping or friction or speed),
    )  # fmt: skip


def calm_stiffness_of(loop: LoopProperties) -> float:
    """Return the largest stiffness that the sample rate renders without oscillation [N/m or N*m/rad]."""
    if loop.moving_mass is None:
        return _NO_CAP
    ideal = scalar_bounds.displacement_response(loop.sample_time, loop.moving_mass, 0.0, 0.0, 0.0, 0.0, loop.timing)
    damped = scalar_bounds.renderable_by_device_damping(loop.device_damping or 0.0, loop.sample_time, loop.delay)
    return max(damped, scalar_bounds.renderable_by_hand_force(ideal, loop.delay, 1.0))


def hand_response(parameters: GuardedParameters, loop: LoopProperties) -> DisplacementResponse:
    """Return the worst displacement by torques and hand in a hold; `NO_RESPONSE` if mass or hand force is not declared.

    Raises:
        ParameterError: The damping of the device has no upper bound.
    """
    if parameters.hand_force is None or loop.moving_mass is None:
        return scalar_bounds.NO_RESPONSE
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
    return scalar_bounds.displacement_response(
        loop.sample_time, loop.moving_mass, parameters.hand_force + friction, loop.device_damping or 0.0,
        loop.device_damping_bound, inf if push is None else push + friction, loop.timing, (braking, stiffness),
    )  # fmt: skip


_FADE: Final = 0.8
"""Factor by which the usable energy from the device's past dissipation decreases in each hold out of contact."""


@dataclass(slots=True)
class GuardedState:
    """State of `guarded` on one axis, kept from SYNC to SYNC."""

    zone: int = 0  # of contact
    true: float = 0.0  # displacement of the storage in the continuous environment [m or rad]
    h_s: float = 0.0  # [J]
    unrecovered: float = 0.0  # dissipated or leaked, and not paid [J]
    axis: stepped.Axis = field(default_factory=stepped.Axis)
    bound: TorqueBound = field(default_factory=TorqueBound)
    motion: PredictedMotion = field(default_factory=PredictedMotion)


class Memory(NamedTuple):
    """Buffers of `guarded` on one axis: those of every algorithm, and those of the torque bound."""

    axis: stepped.AxisMemory
    bound: BoundMemory


GuardedRun: TypeAlias = Run[GuardedSettings, GuardedState, Memory]
"""Settings, state and memory of one axis."""


def memory_of(settings: GuardedSettings, make_buffer: MakeBuffer) -> Memory:
    """Return the buffers of `guarded` on one axis."""
    axis = stepped.axis_memory(settings.declared.delay, settings.longest_window, make_buffer)
    return Memory(axis, bound_memory(settings.declared, axis.commands.torques, make_buffer))


def end(run: GuardedRun, position: float, torque_applied: float) -> tuple[float, float, float, float]:
    """Update motion and torque bound after a hold; return displacement, damper, modulated effort, uncertain energy."""
    settings, state, memory = run.settings, run.state, run.memory
    declared, bound, axis, commands = settings.declared, state.bound, state.axis, memory.axis.commands
    displacement, count, oldest = position - axis.position, declared.encoder_count, axis.oldest
    axis.position = position
    if axis.missed:
        axis.missed += int(axis.hold_length - 1.0)  # of SYNCs that were skipped in the gap no sample came either
        axis.hold_length = 1.0
        return displacement, 0.0, 0.0, end_several(run, displacement, torque_applied)
    bound.first = oldest - declared.delay
    uncertainty = end_hold(declared, bound, memory.bound, displacement, torque_applied, axis.hold_length)
    if axis.hold_length > 1.0:
        shorten(declared, bound, axis.hold_length)
        observe_mean(state.motion, displacement / axis.hold_length)
        restart_at_mean(settings, axis, memory.axis, displacement / axis.hold_length)
        axis.hold_length = 1.0
    else:
        observe(settings.prediction, state.motion, displacement, torque_applied)
        if count:
            update(axis.window, memory.axis.samples, count, settings.sample_time, position)
    if commands.torques[oldest] == torque_applied:
        return displacement, commands.dampers[oldest], commands.modulated[oldest], uncertainty
    damper, modulated = efforts_inside(commands, oldest, torque_applied)
    return displacement, damper, modulated, uncertainty


def end_several(run: GuardedRun, displacement: float, torque_applied: float) -> float:
    """Update motion and torque bound after holds with lost samples; return the uncertain energy of these holds [J]."""
    settings, state, memory = run.settings, run.state, run.memory
    axis, commands, holds = state.axis, memory.axis.commands, state.axis.missed + 1
    largest, apart = abs(torque_applied), 0.0
    for _ in range(axis.missed):
        sent = clipped(commands.torques[axis.oldest], settings.torque_limit)
        largest, apart = max(largest, abs(sent)), max(apart, abs(sent - torque_applied))
        axis.oldest = repeat(commands, axis.oldest)
    axis.missed = 0
    observe_mean(state.motion, displacement / holds)
    state.bound.first = axis.oldest - settings.declared.delay
    restart_at_mean(settings, axis, memory.axis, displacement / holds)
    return end_gap(settings.declared, state.bound, displacement, torque_applied, holds, largest, apart)


def restart_at_mean(settings: GuardedSettings, axis: stepped.Axis, memory: stepped.AxisMemory, moved: float) -> None:
    """Restart the window of the velocity estimate; the velocity is `moved` per hold [m or rad]."""
    if settings.longest_window:
        restart(axis.window, memory.samples, axis.position)
        axis.window.velocity = moved / settings.sample_time


def book(run: GuardedRun, h_i: float, h_pas: float, damped: float, ceiling: float) -> tuple[float, float, float, float]:
    """Book one hold as stored and surplus energy; return (h_r, deficit, leak, paid) [J], see `EnergyBalance`.

    Args:
        run: Run of the axis; its state is changed.
        h_i: Interaction energy of the hold [J].
        h_pas: Energy taken by the modulated damper [J].
        damped: Damper effort inside the applied torque times the displacement [J].
        ceiling: Energy that the environment stores at its true state [J]; the account keeps at most `earned_energy`
            more than this.
    """
    settings, state, slack = run.settings, run.state, 0.0
    axis = state.axis
    h_s, surplus = state.h_s + h_i - h_pas, axis.h_dis - h_pas
    ceiling += settings.earned
    if damped > 0.0 or h_s > ceiling:
        slack = free_energy(settings.declared, state.bound, run.memory.bound, h_s - surplus + settings.allowance)
        if slack > h_s:
            slack = h_s
    elif h_s >= 0.0:  # nothing is dissipated, leaked or lacking: nothing is to be settled
        state.h_s, axis.h_dis = h_s, surplus
        return 0.0, 0.0, 0.0, 0.0
    state.h_s, axis.h_dis, h_r, deficit, leak, paid = settle(h_s, surplus, damped, ceiling, slack)
    state.unrecovered += h_r + leak - paid
    return h_r, deficit, leak, paid


def relax(
    environment: Environment, run: GuardedRun, true: float, ceiling: float, holds: float
) -> tuple[float, float, float]:
    """Relax the environment over some holds; return (state, energy there, energy dissipated) [m or rad, J, J]."""
    relaxed, state = environment.relaxed(true, holds * run.settings.sample_time), run.state
    left = environment.stored_energy(relaxed)
    lost = min(state.h_s, max(0.0, ceiling - left))
    state.h_s -= lost
    state.unrecovered += lost
    return relaxed, left, lost


_NOT_BOUND, _BY_FORCE = Certificate.EXACT.value, Certificate.HAND_FORCE.value
_BY_DAMPING, _BY_FRICTION = Certificate.DEVICE_DAMPING.value, Certificate.DEVICE_FRICTION.value
_BY_SPEED = Certificate.HAND_SPEED.value
_DRAG_SHARE: Final = 0.5
"""Damping of the drag near rest, as a share of the largest one under which a free mass does not oscillate."""


def render(
    environment: Environment, run: GuardedRun, true: float, spring: float, ceiling: float, travel: float, inside: float,
    moved: float, same: bool,
) -> tuple[float, float, float, float, int]:  # fmt: skip
    """Compute the next torque in contact; return (torque, damper effort, modulated effort, damping, certificate).

    Args:
        environment: Environment rendered.
        run: Run of the axis.
        true: True state: displacement of the environment's storage [m or rad].
        spring: Spring effort at that state [N or N*m].
        ceiling: Energy that the environment stores at that state [J].
        travel: Change of the storage's displacement per hold [m or rad].
        inside: Displacement of the axis per hold, only the part inside the contact [m or rad].
        moved: Displacement of the axis per hold [m or rad].
        same: Whether the axis was in the same contact zone at the last position.
    """
    settings, state, queued = run.settings, run.state, run.memory.bound.under_way
    bound, energy = state.bound, state.h_s - state.axis.h_dis + settings.allowance
    if settings.longest_window:
        energy = certain_energy(state, energy)
    ahead = steady = settings.lead * travel
    if not environment.relaxes:
        ahead, mover_motion = predicted(settings.prediction, state.motion, queued, bound.first, travel)
        if state.h_s < ceiling and steady * spring > 0.0 and steady * spring > ahead * spring:
            ahead = steady  # going in, more may be taken in where the account is short
        if same:
            inside = mover_motion
    lead = environment.effort(environment.admissible(true + ahead, true)) - spring
    velocity = inside / settings.sample_time
    depth, damping = of_sum(environment, settings, true, spring, ceiling) if settings.by_place else (
        abs(true), settings.damping
    )  # fmt: skip
    softer = softened(settings, spring, depth) if settings.sustained else 1.0
    spring, lead = spring * softer, lead * softer
    spring, lead, damper, covered = efforts(run, depth, spring, lead, ahead, velocity, damping, energy, ceiling)
    rendered = damper / velocity if velocity != 0.0 else damping
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
    size, certificate = permitted_size(run, torque, energy, moved)
    asked = abs(torque)
    if size < asked:
        share = size / asked
        torque, damper, modulated, rendered = torque * share, damper * share, modulated * share, rendered * share
    elif covered & (softer == 1.0):
        certificate = _NOT_BOUND
    if settings.quantum > 0.0:
        torque = towards_zero(torque, settings.quantum)
    return torque, damper, modulated, rendered, certificate


def of_sum(
    environment: Environment, settings: GuardedSettings, true: float, spring: float, ceiling: float
) -> tuple[float, float]:
    """Return the depth of a spring of the same effort and energy [m or rad], and the damping, of a sum at a state."""
    damping = min(settings.damping, environment.damping_at(true))
    return (2.0 * ceiling / abs(spring) if spring != 0.0 else 0.0), damping


def permitted_size(run: GuardedRun, torque: float, energy: float, moved: float) -> tuple[float, int]:
    """Return the size of a torque, reduced to what limiter and certificates permit [N or N*m], and the certificate.

    Args:
        run: Run of the axis.
        torque: Requested torque, not 0 [N or N*m].
        energy: Energy that the account holds for it [J].
        moved: Displacement per hold [m or rad].
    """
    settings, state, memory = run.settings, run.state, run.memory
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
    """Return the energy that the next torques may return to the user, less what the encoder leaves uncertain [J].

    Energy that was dissipated or leaked is not available for torques, but it covers the uncertainty first: eq. 4 holds
    for the booked energy, eq. 3 for the true energy.
    """
    lacking = state.bound.uncertainty - state.unrecovered
    return energy - lacking if lacking > 0.0 else energy


def within_limits(settings: GuardedSettings, newest: float, sign: float, moved: float) -> float:
    """Return the largest torque along `sign` that the limiter permits [N or N*m]; see `drive.safety.limiter`.

    The bound is computed before the torque is certified: a certified torque that the limiter then reduced would absorb
    less energy than the next torque relies on.

    Args:
        settings: Constants of the run.
        newest: Torque sent last [N or N*m].
        sign: Direction of the torque, 1 or -1.
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


_DITHERED: Final = 2.0
"""Stiffness requested at most with a coarse encoder, over the one that friction sustains: up to it dither over one edge
costs nothing (`certified_torque`). A stiffer one loses at the impact what would hold it, and is felt softer."""


def softened(settings: GuardedSettings, spring: float, depth: float) -> float:
    """Return the share of a spring's effort [N or N*m] at a depth [m or rad] that is requested."""
    size, most = abs(spring), _DITHERED * settings.sustained * depth
    return most / size if 0.0 < most < size else 1.0


def efforts(
    run: GuardedRun, depth: float, spring: float, lead: float, ahead: float, velocity: float, damping: float,
    energy: float, ceiling: float,
) -> tuple[float, float, float, bool]:  # fmt: skip
    """Limit spring, prediction and damper efforts [N or N*m] to the energy; return them, and whether it covers all."""
    settings, bound = run.settings, run.state.bound
    damper, size, speed = damping * velocity, abs(spring), abs(velocity)
    room, led = settings.cap * speed, settings.calm * abs(ahead)
    if abs(damper) > room:
        damper = copysign(room, damper)
    permitted = 2.0 * settings.calm_stiffness * energy
    if not settings.declared.by_hand_force_alone:
        permitted = energy_permitted(settings, bound, spring + lead + damper, energy, ceiling)
        if settings.sustained > 0.0 and (velocity * spring <= 0.0 or speed < settings.driven):
            soft, further = soft_and_further(settings, bound, size, depth, energy)
            if soft + further < size:  # all of it would use up what the soft spring lives on
                permitted = min(permitted, (soft + further) * (soft + further))
                room = min(room, further)
                # A lead that takes torque away costs nothing: without it a spring gives out
                led = min(led, further) if lead * spring > 0.0 else led
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
    """Return the spring effort that device friction sustains, and the most that the energy covers beyond it [N or N*m].

    The energy of that spring is reserved for it, so that a wall gets softer but never vanishes. The rest of the energy
    covers further efforts, and the energy that one count leaves uncertain when they rise and fall. If less than half of
    the reserve is left, after a motion too fast for friction to cover, the spring is softer still.

    Args:
        settings: Constants of the run.
        bound: State of the torque bound.
        size: Requested effort [N or N*m].
        depth: Penetration into the contact, the size of the true state [m or rad].
        energy: Energy budget [J].
    """
    count, calm = settings.declared.encoder_count, settings.calm_stiffness or settings.damped_stiffness
    soft = min(size, settings.sustained * depth)
    reserve = 0.5 * soft * (depth - count) if depth > count else 0.0
    spare = energy + bound.dissipated - reserve
    if spare < 0.0:
        left = 2.0 * (spare + reserve)
        return (soft if left >= reserve else soft * left / reserve if left > 0.0 else 0.0), 0.0
    uncertainty = calm * count
    return soft, sqrt(uncertainty * uncertainty + 2.0 * calm * spare) - uncertainty


def energy_permitted(
    settings: GuardedSettings, bound: TorqueBound, whole: float, energy: float, ceiling: float
) -> float:
    """Return the square of the largest spring effort that the energy account covers [N^2 or N^2*m^2].

    Args:
        settings: Constants of the run.
        bound: State of the torque bound; its device dissipation is reduced to what the efforts need.
        whole: All efforts together [N or N*m].
        energy: Energy budget [J].
        ceiling: Energy stored at the true state [J].
    """
    enough = settings.earned
    if settings.damped_stiffness > 0.0:
        enough = max(enough, 0.5 * (whole * whole) / settings.damped_stiffness)
    keep(bound, energy, ceiling + enough)
    covered = settings.calm_stiffness * (energy + bound.dissipated)
    covered = 2.0 * max(covered, settings.damped_stiffness * (energy + certain_dissipation(bound)))
    held = settings.declared.friction + (sqrt(covered) if covered > 0.0 else 0.0)
    energy += max(0.0, bound.dissipated)
    if settings.path > 0.0 and energy > 0.0:
        held = max(held, settings.declared.friction + energy / settings.path)
    return held * held


def drag(run: GuardedRun, moved: float) -> tuple[float, int]:
    """Return the torque out of contact [N or N*m] and its certificate: it brakes until `earned_energy` is stored.

    Args:
        run: Run of the axis.
        moved: Displacement in a hold [m or rad].
    """
    settings, state = run.settings, run.state
    bound, energy = state.bound, state.h_s - state.axis.h_dis + settings.allowance
    if bound.dissipated > 0.0:  # reduced to the energy kept for later contacts
        have = max(0.0, state.h_s - state.axis.h_dis + bound.dissipated)
        keep(bound, state.h_s - state.axis.h_dis, max(_FADE * have, settings.earned))
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
    size, certificate = permitted_size(run, torque, energy, moved)
    return towards_zero(copysign(size, torque), settings.quantum), certificate


_FREE, _START, _EXACT = Branch.FREE.value, Branch.START.value, Branch.EXACT.value
_STICKY, _DEPLETED = Branch.STICKY.value, Branch.DEPLETED.value
_EXIT = Branch.EXIT.value


def step(environment: Environment, run: GuardedRun, position: float, torque_applied: float) -> EnergyBalance:
    """Book the hold that ended, and compute the next torque; see `Controller.step`.

    Of the energies that late torques and lost samples leave possible, the middle is booked, and half of the width is
    reserved as dissipated: torques are computed from the least energy.
    """
    settings, state, memory = run.settings, run.state, run.memory
    zone_before, axis = state.zone, state.axis
    state.zone = zone = environment.contact(position)
    if not axis.started:
        return start(run, position)
    holds, same, open_before = axis.missed + axis.hold_length, zone == zone_before, state.bound.resolution
    displacement, damper, modulated, uncertainty = end(run, position, torque_applied)
    reserved = 0.5 * (state.bound.resolution - open_before)
    true = environment.true_state(position, displacement, state.true if same else 0.0) if zone else 0.0
    if settings.turns:
        take_stretch(environment, settings, state.bound, position, true)
        look_for_turn(settings.declared, state.bound, memory.bound, displacement, holds)
    ceiling = environment.stored_energy(true) if zone else 0.0
    if settings.sustained > 0.0 and not settings.by_place:  # of what is requested at most, as `softened` does
        ceiling = min(ceiling, 0.5 * _DITHERED * settings.sustained * true * true)
    h_i, h_pas = -torque_applied * displacement - uncertainty, modulated * displacement  # eq. 2
    h_r, deficit, leak, paid = book(run, h_i, h_pas, damper * displacement, ceiling)
    if zone:
        if environment.relaxes:
            true, ceiling, lost = relax(environment, run, true, ceiling, holds)
            h_r += lost
        spring, moved = environment.effort(true), displacement / holds
        travel, inside = (true - state.true) / holds, moved
        if settings.longest_window or not same:
            travel, inside = motion_inside(environment, run, travel, displacement, holds, true, same)
        torque, damper, modulated, rendered, certificate = render(
            environment, run, true, spring, ceiling, travel, inside, moved, same
        )
        branch = _START if not same else _STICKY if h_i > 0.0 and displacement * spring < 0.0 else _EXACT
    else:
        torque, damper, modulated, rendered, certificate = 0.0, 0.0, 0.0, 0.0, _NOT_BOUND
        branch = _EXIT if zone_before or ((h_i != 0.0 or leak != 0.0) and settings.drag == 0.0) else _FREE
        if settings.drag or state.bound.dissipated > 0.0:
            torque, certificate = drag(run, displacement / holds)
    axis.oldest = send(memory.axis.commands, axis.oldest, torque, damper, modulated)
    state.true, h_s = true, state.h_s
    if reserved:
        h_i, h_r = h_i + reserved, h_r + reserved
    stored = true if h_s >= ceiling else environment.state_of_energy(h_s, true)
    return new(EnergyBalance, (
        torque, h_i, h_pas, h_i - h_pas, h_r, h_s, axis.h_dis, 0.0, deficit, leak, paid,
        _DEPLETED if deficit > 0.0 else branch, rendered, certificate, stored, 0.0,
    ))  # fmt: skip


def start(run: GuardedRun, position: float) -> EnergyBalance:
    """Start an axis at its first position [m or rad]; return an energy balance of zero."""
    bound, turns = run.state.bound, run.settings.turns
    begin(run.state.axis, run.memory.axis, position)
    bound.out, bound.turns, bound.is_near = run.settings.outside, turns, turns
    return AT_REST


def take_stretch(environment: Any, settings: GuardedSettings, bound: TorqueBound, position: float, true: float) -> None:
    """Store the interval around a position [m or rad] in which the effort does not reverse, and the direction out.

    If `knows_turns` is set, the environment must have `one_way`; otherwise the interval is empty.
    """
    bound.out = bound.above = bound.below = 0.0
    effort = environment.effort(true) if settings.knows_turns and environment.contact(position) else 0.0
    if effort != 0.0:
        low, high = environment.one_way(position)
        bound.out, bound.above, bound.below = -copysign(1.0, effort), high - position, position - low


def motion_inside(
    environment: Environment, run: GuardedRun, travel: float, displacement: float, holds: float, true: float, same: bool
) -> tuple[float, float]:
    """Return the displacements per hold of storage and damper [m or rad], from the velocity window if the axis has one.

    Args:
        environment: Environment rendered.
        run: Run of the axis, updated to its new position.
        travel: Change of the storage's displacement per hold; used only if `same` [m or rad].
        displacement: Displacement since the last position [m or rad].
        holds: Number of holds since the last position.
        true: True state: displacement of the storage [m or rad].
        same: Whether the axis was in the same contact zone at the last position.
    """
    inside = displacement / holds
    if not same:
        travel = inside
    if run.settings.longest_window and not environment.relaxes:
        travel = inside = run.state.axis.window.velocity * run.settings.sample_time
    if not same:
        inside = (true - environment.admissible(true - displacement, true)) / holds
    return travel, inside


class Guarded(stepped.SteppedController):
    """Controller that renders an environment with torques no larger than the certificates permit."""

    parameters_type: ClassVar[type[Parameters]] = GuardedParameters
    kernel: ClassVar[Kernel] = Kernel(settings_of, GuardedState, memory_of, step)

    def __init__(self, environment: Environment, parameters: GuardedParameters, loop: LoopProperties) -> None:
        super().__init__(environment, parameters, loop)
        self.max_consecutive_losses = parameters.max_consecutive_losses
        self.energy_allowance = parameters.energy_allowance
        self.hand_force = parameters.hand_force

    @property
    def lacks_push(self) -> bool:
        """Whether the direction out of the environment can change, but the hand's push is not declared."""
        settings: GuardedSettings = self._settings
        return settings.turns and settings.declared.response.push == inf

    @property
    def energy_resolution(self) -> float:
        """Largest error of sum(h_i) due to late torques and lost samples [J]; the middle of the range is booked."""
        resolution: float = self._state.bound.resolution
        return 0.5 * resolution

    @property
    def releasable(self) -> float:
        """Most energy that may still come out [J]: that of the account, and the device's dissipation kept for it."""
        state = self._state
        budget: float = state.h_s - state.axis.h_dis + self.energy_allowance + max(0.0, state.bound.dissipated)
        return budget

    def sample_lost(self) -> EnergyBalance:
        """Repeat the last command at a SYNC without a position; see `Controller.sample_lost`.

        The next `step` books the displacement of all these holds times the torque read back, less the uncertain energy.
        """
        return super().sample_lost()._replace(damping_rendered=0.0, certificate=_NOT_BOUND)
