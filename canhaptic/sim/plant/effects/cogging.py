"""Cogging: the detent torque of magnets and slots, F = -amplitude * sin(2 pi q / pitch + phase), at any motor torque.

A potential force: over a substep the mean along the travel is taken in closed form (a discrete gradient), so that the
energy it stores is returned. States added: travel, effort (`splitting.py`). Order 2.
Energy: stored. Typical: 0.5..3 % of the rated torque, pitch = one turn / lcm(poles, slots).
Source: Hanselman, "Brushless Permanent Magnet Motor Design", 2nd ed., 2003, ch. 4.
"""

import math
from typing import Annotated, Literal

from canhaptic.sim.plant.assembly import EffectParameters, PlantModel
from canhaptic.sim.plant.splitting import DETENT, Effort, EffortForce
from canhaptic.units import quantity


class Cogging(EffectParameters):
    """A periodic detent."""

    order = 2
    type: Literal["cogging"] = "cogging"
    amplitude: Annotated[float, quantity("N", "N*m", ge=0.0, le=1e6)]
    """Largest detent force."""
    pitch: Annotated[float, quantity("m", "rad", ge=1e-9, le=1e3)]
    """Distance from one detent to the next."""
    phase: Annotated[float, quantity("rad", ge=-10.0, le=10.0)] = 0.0
    """Phase of the sine at position 0."""

    def add_to(self, scene: PlantModel) -> None:
        """Add the cogging as a force on the motor."""
        scene.efforts.append(EffortForce(Effort(DETENT, self.amplitude, self.pitch, self.phase), None))

    def fastest(self, mass: float, torque: float) -> float:
        """Return the natural frequency of a mass [kg or kg*m^2] on the stiffness of a detent [rad/s]."""
        return math.sqrt(2.0 * math.pi * self.amplitude / (self.pitch * mass))
