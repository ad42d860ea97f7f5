"""Torque saturation: the drive cannot give more than `limit`. The held torque is clipped before it reaches the motor.

States added: none. Exact. Energy: motor work uses the clipped torque. Typical: 2..4 times the rated torque.
Source: CiA 402-2, object 0x6072; any drive's peak current.
"""

from typing import Annotated, Literal

from canhaptic.sim.plant.assembly import EffectParameters, PlantModel, TorqueCommand
from canhaptic.units import quantity


class TorqueSaturation(EffectParameters):
    """A limit of the motor's torque, the same in both directions."""

    type: Literal["torque_saturation"] = "torque_saturation"
    limit: Annotated[float, quantity("N", "N*m", gt=0.0, le=1e6)]
    """Largest torque of the motor."""

    def add_to(self, scene: PlantModel) -> None:
        """Add the limit, which clips the torque."""
        scene.claim("torque saturation", self.type)
        scene.commands.append(_Clip(self.limit))


class _Clip(TorqueCommand):
    """The clip of a held torque."""

    def __init__(self, limit: float) -> None:
        self.passes = self._limit = limit

    def apply(self, torque: float, duration: float) -> float:
        """Return the torque within the limit [N or N*m]."""
        return min(max(torque, -self._limit), self._limit)
