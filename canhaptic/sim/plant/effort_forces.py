"""Forces that are not piecewise affine, each as its mean over a substep.

The functions are kernels, for single plants and for compiled batches. The equations are in the files of the effects.
"""

from dataclasses import dataclass
from math import copysign, exp, expm1, pi, sin
from typing import Final

from canhaptic.sim.plant.assembly import Account, NonlinearForce

DETENT, RIPPLE, FALLING, BRISTLE = 0, 1, 2, 3
"""Kinds of `Effort`: of cogging, torque_ripple, stribeck_friction and lugre_friction."""
_TURN: Final = 2.0 * pi


@dataclass(frozen=True, slots=True)
class Effort:
    """One force of any kind; parameters that a kind does not have are 0."""

    kind: int
    amplitude: float = 0.0  # of a detent [N or N*m], of a ripple as a part of the torque
    pitch: float = 1.0  # [m or rad]
    phase: float = 0.0  # [rad]
    kinetic: float = 0.0  # friction of a fast slide; of FALLING the friction that another part exerts [N or N*m]
    static: float = 0.0  # friction at which it breaks away [N or N*m]
    stribeck_velocity: float = 1.0  # [m/s or rad/s]
    bristle_stiffness: float = 0.0  # [N/m or N*m/rad]
    bristle_damping: float = 0.0  # [N*s/m or N*m*s/rad]
    viscous: float = 0.0  # [N*s/m or N*m*s/rad]


@dataclass(slots=True)
class Bristle:
    """State of a bristle force."""

    deflection: float = 0.0  # [m or rad]


def mean_force(
    effort: Effort, bristle: Bristle, position: float, travel: float, duration: float, torque: float
) -> float:
    """Return the mean force [N or N*m] over a substep.

    Args:
        effort: The force.
        bristle: State at the start of the substep.
        position: Position at the start [m or rad].
        travel: Displacement in the substep [m or rad].
        duration: Duration of the substep [s].
        torque: Mean torque of the motor over the substep [N or N*m].
    """
    if effort.kind == DETENT:
        return -effort.amplitude * mean_sine(_TURN / effort.pitch, effort.phase, position, travel)
    if effort.kind == RIPPLE:
        return torque * effort.amplitude * mean_sine(_TURN / effort.pitch, effort.phase, position, travel)
    if effort.kind == FALLING:
        return falling_friction(effort, travel, duration)
    return bristle_force(effort, bristle, travel, duration)


def mean_sine(wave_number: float, phase: float, position: float, travel: float) -> float:
    """Return the mean of sin(wave_number * q + phase) from `position` to `position + travel`, without cancellation."""
    half = 0.5 * wave_number * travel
    spread = sin(half) / half if half != 0.0 else 1.0
    return sin(wave_number * (position + 0.5 * travel) + phase) * spread


def falling_friction(effort: Effort, travel: float, duration: float) -> float:
    """Return the friction in excess of kinetic friction at the mean velocity [N or N*m]."""
    if travel == 0.0:
        return 0.0
    ratio = travel / (duration * effort.stribeck_velocity)
    return -copysign((effort.static - effort.kinetic) * exp(-ratio * ratio), travel)


def bristle_force(effort: Effort, bristle: Bristle, travel: float, duration: float) -> float:
    """Return the mean friction of bristles [N or N*m]."""
    if duration == 0.0:
        return -effort.bristle_stiffness * bristle.deflection
    end, mean = bent(effort, bristle, travel, duration)
    bending = effort.bristle_damping * (end - bristle.deflection) / duration
    return -(effort.bristle_stiffness * mean + bending + effort.viscous * travel / duration)


def bend(effort: Effort, bristle: Bristle, travel: float, duration: float) -> None:
    """Update the bending of the bristle over a substep."""
    if effort.kind == BRISTLE:
        bristle.deflection = bent(effort, bristle, travel, duration)[0]


def bent(effort: Effort, bristle: Bristle, travel: float, duration: float) -> tuple[float, float]:
    """Return the bristle's deflection after a substep, and its mean, at a constant velocity [m or rad]."""
    deflection = bristle.deflection
    if travel == 0.0:
        return deflection, deflection
    ratio = travel / (duration * effort.stribeck_velocity)
    level = effort.kinetic + (effort.static - effort.kinetic) * exp(-ratio * ratio)
    sliding = copysign(level / effort.bristle_stiffness, travel)
    lengths = abs(travel) * effort.bristle_stiffness / level  # travel by the length in which the rest falls to 1/e
    lost = -expm1(-lengths)
    end = deflection + (sliding - deflection) * lost
    return end, sliding + (deflection - sliding) * (lost / lengths if lengths != 0.0 else 1.0)


def held_energy(effort: Effort, bristle: Bristle, position: float) -> float:
    """Energy stored in a force [J]; 0 at the middle of a detent and for a relaxed bristle."""
    if effort.kind == DETENT:
        wave_number = _TURN / effort.pitch
        half = sin(0.5 * (wave_number * position + effort.phase))
        return 2.0 * effort.amplitude / wave_number * half * half
    return 0.5 * effort.bristle_stiffness * bristle.deflection**2


class EffortForce(NonlinearForce):
    """A force of this module as a part of a plant.

    Args:
        effort: The force.
        account: Energy account of its work; None if the work is stored.
    """

    def __init__(self, effort: Effort, account: Account | None) -> None:
        self.effort, self.account = effort, account
        self.state_names = ("bristle_deflection",) if effort.kind == BRISTLE else ()
        self._bristle = Bristle()

    def reset(self) -> None:
        """Relax the bristle."""
        self._bristle.deflection = 0.0

    def force(self, position: float, travel: float, duration: float, torque: float) -> float:
        """Return the mean force [N or N*m] over a substep that starts at `position` and moves by `travel`."""
        return mean_force(self.effort, self._bristle, position, travel, duration, torque)

    def commit(self, position: float, travel: float, duration: float, torque: float) -> None:
        """Update the state at the end of a substep."""
        bend(self.effort, self._bristle, travel, duration)

    def stored(self, position: float) -> float:
        """Return the energy stored in it [J]."""
        return held_energy(self.effort, self._bristle, position)
