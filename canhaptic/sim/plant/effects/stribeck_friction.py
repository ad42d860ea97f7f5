"""Stribeck friction: dry friction that falls from `static` to `kinetic` as the body begins to slide.

F = -[kinetic + (static - kinetic) exp(-(v / stribeck_velocity)^2)] sign(v); stuck up to `static`. The constant part
and stiction are modes of the exact core; the falling part depends on the mean velocity of a substep.
States added: travel, effort (`splitting.py`). Order 2, sticking and breakaway included.
Energy: friction times path is dissipated. Typical stribeck velocity: 1..50 mm/s.
Source: Armstrong-Helouvry, Dupont, Canudas de Wit, Automatica 30(7), 1994.
"""

from typing import Annotated, ClassVar, Literal

from canhaptic.sim.plant.assembly import EffectParameters, PlantModel
from canhaptic.sim.plant.contact import DryFriction
from canhaptic.sim.plant.splitting import FALLING, Effort, EffortForce
from canhaptic.units import quantity


class StribeckFriction(EffectParameters, DryFriction):
    """Dry friction with a falling characteristic; the cause of stick-slip."""

    order: ClassVar[int | None] = 2
    type: Literal["stribeck_friction"] = "stribeck_friction"
    stribeck_velocity: Annotated[float, quantity("m/s", "rad/s", gt=0.0, le=1e3)]
    """Velocity at which the friction has fallen by 63 % of the way from `static` to `kinetic`."""

    def add_to(self, scene: PlantModel) -> None:
        """Add the modes of dry friction and the force of the falling part."""
        scene.claim("friction model", self.type)
        self.add_stick_slip(scene, self.type)
        scene.efforts.append(EffortForce(Effort(FALLING, **self.model_dump(exclude={"type"})), "dissipated"))

    def fastest(self, mass: float, torque: float) -> float:
        """Return the rate at which the falling friction accelerates a mass [kg or kg*m^2] [1/s]."""
        return (self.static - self.kinetic) / (self.stribeck_velocity * mass)
