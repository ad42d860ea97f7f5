"""LuGre friction: bristles that bend before they slip (pre-sliding), with Stribeck's characteristic when they slide.

    dz/dt = v - bristle_stiffness |v| / g(v) * z,   g(v) = kinetic + (static - kinetic) exp(-(v / stribeck_velocity)^2)
    F = -(bristle_stiffness z + bristle_damping dz/dt + viscous v)

The bristle takes an exponential update at the mean velocity of a substep; explicit Euler is unstable at one step a
period. States added: bristle_deflection; travel, effort (`splitting.py`). Order 2.
Energy: bristle_stiffness z^2 / 2 is stored, the rest of force times path is dissipated. With a constant bristle_damping
LuGre is passive for every motion only if bristle_damping <= viscous * kinetic / (static - kinetic) (Barahanov and
Ortega, IEEE Trans. Automatic Control 45(7), 2000); above this limit `dissipated` may decrease for a moment.
Source: Canudas de Wit, Olsson, Astrom, Lischinsky, IEEE Trans. Automatic Control 40(3), 1995.
"""

import math
from typing import Annotated, ClassVar, Literal

from canhaptic.sim.plant.assembly import EffectParameters, PlantModel
from canhaptic.sim.plant.contact import DryFriction
from canhaptic.sim.plant.splitting import BRISTLE, Effort, EffortForce
from canhaptic.units import quantity


class LuGreFriction(EffectParameters, DryFriction):
    """Dry friction with pre-sliding displacement."""

    order: ClassVar[int | None] = 2
    type: Literal["lugre_friction"] = "lugre_friction"
    stribeck_velocity: Annotated[float, quantity("m/s", "rad/s", gt=0.0, le=1e3)]
    """Velocity at which the friction has fallen by 63 % of the way from `static` to `kinetic`."""
    bristle_stiffness: Annotated[float, quantity("N/m", "N*m/rad", ge=1e-6, le=1e9)]
    """Stiffness of the bristles before they slip."""
    bristle_damping: Annotated[float, quantity("N*s/m", "N*m*s/rad", ge=0.0, le=1e6)] = 0.0
    """Damping of the bristles."""
    viscous: Annotated[float, quantity("N*s/m", "N*m*s/rad", ge=0.0, le=1e6)] = 0.0
    """Viscous friction in parallel with the bristles."""

    def add_to(self, scene: PlantModel) -> None:
        """Add the force of the bristle."""
        scene.claim("friction model", self.type)
        scene.efforts.append(EffortForce(Effort(BRISTLE, **self.model_dump(exclude={"type"})), "dissipated"))

    def fastest(self, mass: float, torque: float) -> float:
        """Return the natural frequency of a mass [kg or kg*m^2] on the stiffness of the bristles [rad/s]."""
        return math.sqrt(self.bristle_stiffness / mass)
