"""Backlash: a gap in the shaft; its two flanks have the shaft's stiffness and damping, in the middle there is no force.

Needs `shaft_compliance`. States added: forward_flank_depth, backward_flank_depth. Exact. Energy: as `contact.py`.
Typical: 0.1..10 mrad. Source: Nordin and Gutman, "Controlling mechanical systems with backlash - a survey", Automatica
38(10), 2002; a flank recovers in the gap as in their physical model of a damped shaft.
"""

from typing import Annotated, Literal

from canhaptic.errors import ParameterError
from canhaptic.sim.plant.assembly import MOTOR, EffectParameters, PlantModel
from canhaptic.sim.plant.contact import Contact
from canhaptic.sim.plant.effects.shaft_compliance import LOAD
from canhaptic.units import quantity


class Backlash(EffectParameters):
    """Backlash (play) in the shaft between motor and load."""

    type: Literal["backlash"] = "backlash"
    gap: Annotated[float, quantity("m", "rad", gt=0.0, le=1e3)]
    """Whole play, from flank to flank."""

    def add_to(self, scene: PlantModel) -> None:
        """Replace the shaft's spring by two flanks.

        Raises:
            ParameterError: There is no shaft.
        """
        if scene.shaft is None:
            raise ParameterError(
                "backlash: got no shaft_compliance, expected one; backlash is a gap in a shaft: add a shaft_compliance"
            )
        scene.claim("backlash", self.type)
        stiffness, damping = scene.shaft
        scene.parts = [part for part in scene.parts if part.name != "shaft_compliance"]
        del scene.works["shaft_compliance"]
        for name, factor in (("forward_flank", 1.0), ("backward_flank", -1.0)):
            sides = [(MOTOR, factor), (LOAD, -factor)]
            Contact(name, sides, 0.5 * self.gap, stiffness, damping).add_to(scene)
