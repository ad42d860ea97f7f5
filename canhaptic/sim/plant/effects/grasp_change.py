"""Grasp change: at `time` the hand's stiffness and damping change; the voluntary motion goes on.

Needs a hand. States added: none (one mode per grasp). Exact; the time is rounded to a tick. Energy: work of the hand.
Typical: 50..1000 N/m within some tenths of a second. Source: Hajian and Howe, ASME J. Biomech. Eng. 119, 1997.
"""

from typing import Annotated, Literal

from canhaptic.errors import ParameterError
from canhaptic.sim.plant.assembly import EffectParameters, PlantModel
from canhaptic.units import quantity


class GraspChange(EffectParameters):
    """Another grasp from a given time on; name the effect again for further changes."""

    type: Literal["grasp_change"] = "grasp_change"
    time: Annotated[float, quantity("s", ge=0.0, le=1e6)]
    """Time of the change, from the start of the plant."""
    stiffness: Annotated[float, quantity("N/m", "N*m/rad", ge=0.0, le=1e8)]
    """Stiffness of the hand's grip from then on."""
    damping: Annotated[float, quantity("N*s/m", "N*m*s/rad", ge=0.0, le=1e6)]
    """Damping of the hand's grip from then on."""

    def add_to(self, scene: PlantModel) -> None:
        """Add a grasp to the hand and the time at which it begins.

        Raises:
            ParameterError: There is no hand.
        """
        if scene.hand is None:
            raise ParameterError("grasp_change: got no hand, expected user.stiffness or user.damping > 0; give one")
        mode = scene.hand.add_grasp(self.stiffness, self.damping)
        scene.schedule.append((self.time, scene.hand.name, mode))
