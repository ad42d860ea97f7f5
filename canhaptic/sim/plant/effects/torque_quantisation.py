"""Torque quantisation: the current controller resolves the torque in steps of `quantum`.

States added: none. Exact. Energy: motor work uses the rounded torque. Typical: rated torque / 1000 .. / 10 000.
Source: CiA 402-2, 0x6071 in per mille of 0x6076; current sensors of 10..12 bits.
"""

from typing import Annotated, Literal

from canhaptic.sim.plant.assembly import EffectParameters, PlantModel, TorqueCommand
from canhaptic.units import quantity


class TorqueQuantisation(EffectParameters):
    """A motor torque that changes in whole steps."""

    rank = 2
    type: Literal["torque_quantisation"] = "torque_quantisation"
    quantum: Annotated[float, quantity("N", "N*m", gt=0.0, le=1e6)]
    """Smallest step of the torque."""

    def add_to(self, scene: PlantModel) -> None:
        """Add the rounding of the torque to its steps."""
        scene.claim("torque quantisation", self.type)
        scene.commands.append(_Rounding(self.quantum))


class _Rounding(TorqueCommand):
    """The rounding of a held torque."""

    def __init__(self, quantum: float) -> None:
        self._quantum = quantum

    def apply(self, torque: float, duration: float) -> float:
        """Return the nearest multiple of the quantum [N or N*m]."""
        return round(torque / self._quantum) * self._quantum
