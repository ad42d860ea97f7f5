"""A surface with Coulomb friction: sticks like a spring, slides at its limit (Prandtl's element)."""

import math
from typing import Annotated, ClassVar

from canhaptic.parameters import Parameters, quantity


class CoulombSurface(Parameters):
    """Friction along the axis, everywhere: an elastic bristle that yields at the friction effort.

    Being a storage that yields it is passive and has no switching velocity; its presliding stiffness is finite.
    """

    friction: Annotated[float, quantity("N", "N*m", ge=0.0, le=1e6)]
    """Effort at which it slides."""
    stiffness: Annotated[float, quantity("N/m", "N*m/rad", gt=0.0, le=1e9)]
    """Of the bristle before it slides."""
    damping: Annotated[float, quantity("N*s/m", "N*m*s/rad", ge=0.0, le=1e7)] = 0.0
    """Viscous damping beside the friction."""

    relaxes: ClassVar[bool] = True

    @property
    def linear_stiffness(self) -> float:
        """Stiffness k of the bristle [N/m or N*m/rad]."""
        return self.stiffness

    def contact(self, position: float) -> int:
        """Returns 1: the surface is everywhere."""
        return 1

    def true_state(self, position: float, displacement: float, previous: float) -> float:
        """Returns the strain of the bristle [m or rad] before it yields."""
        return previous + displacement

    def admissible(self, state: float, true: float) -> float:
        """Returns the state: the bristle works both ways."""
        return state

    def stored_energy(self, state: float) -> float:
        """Returns k x^2 / 2 [J]."""
        return 0.5 * self.stiffness * state * state

    def effort(self, state: float) -> float:
        """Returns k x [N or N*m]."""
        return self.stiffness * state

    def state_of_energy(self, energy: float, like: float) -> float:
        """Returns sqrt(2 H / k) with the sign of `like`."""
        return math.copysign(math.sqrt(2.0 * max(0.0, energy) / self.stiffness), like)

    def relaxed(self, state: float, sample_time: float) -> float:
        """Returns the state, or the strain at which the bristle yields; what it gives up is friction heat."""
        limit = self.friction / self.stiffness
        return min(max(state, -limit), limit)
