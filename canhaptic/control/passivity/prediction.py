"""Prediction of the axis to the hold in which the next torque acts: a model of the moving mass, corrected every hold.

With v the velocity at the last SYNC, f_1 ... f_n the torques under way and w the rest of the force on the mass,

    x_i = x_(i-1) + v_(i-1) T + (f_i + w) T^2 / 2m,   v_i = v_(i-1) + (f_i + w) T / m.

The displacement of the hold that ended corrects v at once: v = D/T + (f_0 + w) T / 2m. It corrects w by a small share,
so that at rest w is what the hand holds against the torque, and nothing is predicted. A prediction from the last
displacement alone has no f: one sample late it turns unstable at k T^2 / m = 0.01, and this one for no k that is
certified. The share is small because a mass that is declared too small makes w follow the torque. With the share of
1/16 that is taken here, no motion of a free mass at a spring that is certified grows for true masses up to 3 times the
declared one at a delay of one sample (2 times at two), and by no more than 0.51 % a hold for any. w has a rise that is
learnt in the same way, so that a hand that presses harder and harder is followed.
"""

from dataclasses import dataclass
from math import expm1
from typing import Final

from canhaptic.kernels import Buffer

PREDICTION_HOLDS: Final = 0.75
"""Prediction beyond the delay [holds]: 0.5 aims at the middle of the hold, and what is more calms a spring."""
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
        beyond: Additional holds of prediction beyond those under way.
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
        torques: Ring of torques, including those under way [N or N*m].
        first: Place of the one that acts first; below 0 it wraps.
        travel: Present motion per hold [m or rad]; all that a coarse encoder resolves of a slow motion.
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
