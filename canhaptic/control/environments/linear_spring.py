"""Common part of environments with a linear spring: stored energy, effort, and the damper in parallel."""

from math import copysign, sqrt
from typing import Annotated

from canhaptic.units import Parameters, quantity


class LinearSpring(Parameters):
    """A spring with the stored energy k x^2 / 2, and a damper in parallel."""

    stiffness: Annotated[float, quantity("N/m", "N*m/rad", ge=0.0, le=1e9)]
    """Stiffness of the spring."""
    damping: Annotated[float, quantity("N*s/m", "N*m*s/rad", ge=0.0, le=1e7)] = 0.0
    """Coefficient of the damper in parallel with the spring; it acts in contact only."""

    @property
    def linear_stiffness(self) -> float:
        """Stiffness k [N/m or N*m/rad]."""
        return self.stiffness

    def stored_energy(self, state: float) -> float:
        """Return k x^2 / 2 [J]."""
        return 0.5 * self.stiffness * state * state

    def effort(self, state: float) -> float:
        """Return k x [N or N*m]."""
        return self.stiffness * state

    def state_of_energy(self, energy: float, like: float) -> float:
        """Return sqrt(2 H / k) with the sign of `like`; eq. 18 prints it positive, where contact has x < 0."""
        if self.stiffness == 0.0:
            return 0.0
        return copysign(sqrt(2.0 * energy / self.stiffness) if energy > 0.0 else 0.0, like)
