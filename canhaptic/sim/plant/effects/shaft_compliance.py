"""Shaft compliance: a spring and damper between the motor (with the encoder) and the load (with the handle).

`mass` of the plant is then the motor's side. The hand and the hard stops act on the load.
States added: twist (motor minus load), load_velocity. Exact. Energy: stiffness twist^2 / 2 stored, damping dissipated.
Typical: 1e3..1e6 N/m. Source: Ellis, "Control System Design Guide", 2012, ch. 16.
"""

from typing import Annotated, Literal

from canhaptic.sim.plant.assembly import LEAST_MASS, MOTOR, Body, EffectParameters, LinearPart, PlantModel, Rows
from canhaptic.units import quantity

LOAD = 1
"""Index of the load among the bodies."""


class ShaftCompliance(EffectParameters):
    """A compliant shaft or belt between motor and handle."""

    rank = 0
    type: Literal["shaft_compliance"] = "shaft_compliance"
    stiffness: Annotated[float, quantity("N/m", "N*m/rad", gt=0.0, le=1e10)]
    """Stiffness of the shaft."""
    damping: Annotated[float, quantity("N*s/m", "N*m*s/rad", ge=0.0, le=1e6)] = 0.0
    """Damping of the shaft."""
    load_mass: Annotated[float, quantity("kg", "kg*m^2", ge=LEAST_MASS, le=1e6)]
    """Mass at the handle's end of the shaft; `plant.mass` is then the mass at the motor's end."""

    def add_to(self, scene: PlantModel) -> None:
        """Add the load and the shaft."""
        scene.claim("shaft", self.type)
        scene.shaft = (self.stiffness, self.damping)
        scene.add_state("twist")
        scene.add_state("load_velocity", scene.states["velocity"])
        scene.bodies.append(Body("load", self.load_mass, "load_velocity", (("position", 1.0), ("twist", -1.0))))
        scene.works[self.type] = "dissipated"
        scene.parts.append(LinearPart("twist", _write_twist))
        scene.parts.append(LinearPart(self.type, self._write))

    def _write(self, rows: Rows) -> None:
        twist, rate = rows.row(twist=1.0), rows.velocity(MOTOR) - rows.velocity(LOAD)
        force = self.stiffness * twist + self.damping * rate
        rows.forces[MOTOR] -= force
        rows.forces[LOAD] += force
        rows.add_storage(self.stiffness, twist)
        rows.add_power(self.type, self.damping * rate, rate)


def _write_twist(rows: Rows) -> None:
    """Write the rate of the twist."""
    rows.set_rate("twist", rows.velocity(MOTOR) - rows.velocity(LOAD))
