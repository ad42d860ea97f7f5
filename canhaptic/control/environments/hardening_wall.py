"""A wall that grows stiffer with depth, as most real materials do: effort k x + k3 x^3."""

import math
from typing import Annotated

from canhaptic.control.environments import OneSided
from canhaptic.units import quantity


class HardeningWall(OneSided):
    """A one-sided wall with the stored energy k x^2 / 2 + k3 x^4 / 4."""

    stiffness: Annotated[float, quantity("N/m", "N*m/rad", ge=0.0, le=1e9)]
    """Linear coefficient k."""
    hardening: Annotated[float, quantity("N/m^3", "N*m/rad^3", ge=0.0, le=1e15)]
    """Cubic coefficient k3."""
    damping: Annotated[float, quantity("N*s/m", "N*m*s/rad", ge=0.0, le=1e7)] = 0.0
    """Coefficient of the damper in parallel with the spring; it acts in contact only."""

    @property
    def linear_stiffness(self) -> float | None:
        """Stiffness k [N/m or N*m/rad] without hardening, else None."""
        return self.stiffness if self.hardening == 0.0 else None

    def stored_energy(self, state: float) -> float:
        """Return k x^2 / 2 + k3 x^4 / 4 [J]."""
        square = state * state
        return square * (0.5 * self.stiffness + 0.25 * self.hardening * square)

    def effort(self, state: float) -> float:
        """Return k x + k3 x^3 [N or N*m]."""
        return state * (self.stiffness + self.hardening * state * state)

    def state_of_energy(self, energy: float, like: float) -> float:
        """Return the state that stores H [J], with the sign of `like`: x^2 = 4 H / (k + sqrt(k^2 + 4 k3 H))."""
        if energy <= 0.0:
            return 0.0
        below = self.stiffness + math.sqrt(self.stiffness * self.stiffness + 4.0 * self.hardening * energy)
        return math.copysign(math.sqrt(4.0 * energy / below), like) if below else 0.0
