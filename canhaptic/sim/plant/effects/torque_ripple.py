"""Torque ripple: the torque constant varies with position, F = torque * amplitude * sin(2 pi q / pitch + phase).

States added: travel, effort (`splitting.py`). Order 2. Energy: booked as work of the motor; the true work of the motor
then differs from that of the torque demand by at most the fraction `amplitude`.
Typical: 1..5 % at the 6th electrical harmonic. Source: Hanselman, "Brushless Permanent Magnet Motor Design", 2003.
"""

import math
from typing import Annotated, Literal

from canhaptic.sim.plant.assembly import EffectParameters, PlantModel
from canhaptic.sim.plant.splitting import RIPPLE, Effort, EffortForce
from canhaptic.units import quantity


class TorqueRipple(EffectParameters):
    """A torque constant that depends on position."""

    order = 2
    type: Literal["torque_ripple"] = "torque_ripple"
    amplitude: Annotated[float, quantity("1", ge=0.0, lt=1.0)]
    """Amplitude of the ripple, as a fraction of the torque."""
    pitch: Annotated[float, quantity("m", "rad", ge=1e-9, le=1e3)]
    """Period of the ripple."""
    phase: Annotated[float, quantity("rad", ge=-10.0, le=10.0)] = 0.0
    """Phase of the sine at position 0."""

    def add_to(self, scene: PlantModel) -> None:
        """Add the ripple as a force on the motor."""
        scene.efforts.append(EffortForce(Effort(RIPPLE, self.amplitude, self.pitch, self.phase), "motor"))

    def fastest(self, mass: float, torque: float) -> float:
        """Return the natural frequency of a mass [kg or kg*m^2] on the ripple of the largest torque [rad/s]."""
        return math.sqrt(2.0 * math.pi * self.amplitude * torque / (self.pitch * mass))
