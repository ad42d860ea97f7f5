"""Viscous friction of bearings and grease: F = -damping * v on the motor's body.

States added: none. Exact. Energy: damping * v^2 is dissipated. Typical: 0.01..5 N*s/m for haptic devices.
Source: Armstrong-Helouvry, Dupont, Canudas de Wit, Automatica 30(7), 1994.
"""

from typing import Annotated, Literal

from canhaptic.sim.plant.assembly import MOTOR, EffectParameters, LinearPart, PlantModel, Rows
from canhaptic.units import quantity


class ViscousFriction(EffectParameters):
    """Force proportional to the velocity and opposite to it."""

    type: Literal["viscous_friction"] = "viscous_friction"
    damping: Annotated[float, quantity("N*s/m", "N*m*s/rad", ge=0.0, le=1e6)]
    """Force per velocity."""

    def add_to(self, scene: PlantModel) -> None:
        """Add the force on the motor's body."""
        scene.claim("viscous friction", self.type)
        scene.works[self.type] = "dissipated"
        scene.parts.append(LinearPart(self.type, self._write))

    def _write(self, rows: Rows) -> None:
        velocity = rows.velocity(MOTOR)
        rows.forces[MOTOR] -= self.damping * velocity
        rows.add_power(self.type, self.damping * velocity, velocity)
