"""Hard stop: a stiff, damped, one-sided end of travel at the handle (at the load, with a shaft compliance).

States added: <side>_stop_depth. Exact; contact and separation are bracketed to one tick. Energy: as `contact.py`.
Typical: 1e5..1e7 N/m for metal on rubber to metal on metal. Source: Goldsmith, "Impact", 1960; see `contact.py`.
"""

from typing import Annotated, Literal

from canhaptic.sim.plant.assembly import EffectParameters, PlantModel
from canhaptic.sim.plant.contact import Contact
from canhaptic.units import quantity


class HardStop(EffectParameters):
    """One end of travel; name the effect twice for two ends."""

    type: Literal["hard_stop"] = "hard_stop"
    position: Annotated[float, quantity("m", "rad", ge=-1e3, le=1e3)]
    """Position at which the handle meets the stop."""
    side: Literal["upper", "lower"] = "upper"
    """upper: stops motion towards +q; lower: towards -q."""
    stiffness: Annotated[float, quantity("N/m", "N*m/rad", gt=0.0, le=1e10)]
    """Stiffness of the stop."""
    damping: Annotated[float, quantity("N*s/m", "N*m*s/rad", ge=0.0, le=1e6)] = 0.0
    """Damping of the stop."""

    def add_to(self, scene: PlantModel) -> None:
        """Add the contact of the handle with the stop."""
        scene.claim(f"{self.side} hard stop", self.type)
        factor = 1.0 if self.side == "upper" else -1.0
        handle = len(scene.bodies) - 1
        name = f"{self.side}_stop"
        Contact(name, [(handle, factor)], factor * self.position, self.stiffness, self.damping).add_to(scene)
