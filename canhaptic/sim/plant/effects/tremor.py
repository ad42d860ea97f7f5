"""Physiological tremor: a sinusoid on top of the voluntary motion, felt through the hand's impedance.

Needs a hand with stiffness or damping. States added: tremor_sine, tremor_cosine. Exact. Energy: work of the hand.
Typical: 8..12 Hz, 0.05..1 mm. Source: Elble and Koller, "Tremor", 1990; Riviere et al., IEEE Trans. Robotics 19, 2003.
"""

import math
from typing import Annotated, Literal

from canhaptic.errors import ParameterError
from canhaptic.sim.plant.assembly import EffectParameters, PlantModel
from canhaptic.units import quantity


class Tremor(EffectParameters):
    """A sinusoidal trembling of the hand."""

    type: Literal["tremor"] = "tremor"
    amplitude: Annotated[float, quantity("m", "rad", ge=0.0, le=1e3)]
    """Amplitude of the tremor."""
    frequency: Annotated[float, quantity("Hz", gt=0.0, le=1e3)] = 8.0
    """Frequency of the tremor."""
    phase: Annotated[float, quantity("rad", ge=-10.0, le=10.0)] = 0.0
    """Phase at the start of the plant."""

    def add_to(self, scene: PlantModel) -> None:
        """Add an oscillator to the motion that the hand follows.

        Raises:
            ParameterError: There is no hand that could transmit it.
        """
        if scene.hand is None:
            raise ParameterError("tremor: got no hand, expected user.stiffness or user.damping > 0; give the user one")
        scene.claim("tremor", self.type)
        scene.hand.follow(scene, "tremor", self.amplitude, 2.0 * math.pi * self.frequency, self.phase)
