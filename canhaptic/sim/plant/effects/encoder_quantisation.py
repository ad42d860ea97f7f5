"""Encoder quantisation: the reading is the nearest multiple of `count`, in addition to the drive's own counts.

States added: none. Exact. Energy: none. Typical: 1e-7..1e-4 m. Source: any incremental encoder.
"""

import math
from typing import Annotated, Literal

from canhaptic.sim.plant.assembly import EffectParameters, PlantModel
from canhaptic.units import quantity


class EncoderQuantisation(EffectParameters):
    """A coarse encoder."""

    rank = 2
    type: Literal["encoder_quantisation"] = "encoder_quantisation"
    count: Annotated[float, quantity("m", "rad", ge=1e-15, le=1e3)]
    """Displacement of one count."""

    def add_to(self, scene: PlantModel) -> None:
        """Add the rounding of the reading."""
        scene.claim("encoder quantisation", self.type)
        scene.encoders.append(self)

    def read(self, position: float, tick: int, seed: int) -> float:
        """The nearest count [m or rad]; a position that is not finite is returned as it is."""
        return round(position / self.count) * self.count if math.isfinite(position) else position
