"""Coulomb friction with stiction on the motor's body: three modes, stuck, forward and backward.

Sliding: F = -kinetic * sign(v). At rest the body is held, exactly, until the other forces exceed `static`.
States added: none. Exact: breakaway and sticking are bracketed to one tick. Energy: kinetic friction times path is
dissipated, and so is the kinetic energy left when the body sticks. Typical: 0.01..2 N.
Source: Karnopp, ASME J. Dynamic Systems 107, 1985; see `canhaptic.sim.plant.contact`.
"""

from typing import Literal

from canhaptic.sim.plant.assembly import EffectParameters, PlantModel
from canhaptic.sim.plant.contact import DryFriction


class CoulombFriction(EffectParameters, DryFriction):
    """Dry friction with stiction."""

    type: Literal["coulomb_friction"] = "coulomb_friction"

    def add_to(self, scene: PlantModel) -> None:
        """Add the part with its three modes."""
        scene.claim("friction model", self.type)
        self.add_stick_slip(scene, self.type)
