"""A viscoelastic medium: a spring that gives way with time (Maxwell), with a damper beside it (Jeffreys)."""

import math
from typing import Annotated, ClassVar

from canhaptic.parameters import Parameters, quantity


class ViscoelasticMedium(Parameters):
    """Dough: stiff against a quick motion, yielding to a slow one; it remembers for about its relaxation time."""

    stiffness: Annotated[float, quantity("N/m", "N*m/rad", gt=0.0, le=1e9)]
    """Of the spring that gives way."""
    relaxation_time: Annotated[float, quantity("s", gt=0.0)]
    """Time in which a spring left alone falls to 1/e: series damping over stiffness."""
    damping: Annotated[float, quantity("N*s/m", "N*m*s/rad", ge=0.0, le=1e7)] = 0.0
    """Of the damper beside it."""

    relaxes: ClassVar[bool] = True

    @property
    def linear_stiffness(self) -> float:
        """Stiffness k of the spring [N/m or N*m/rad]."""
        return self.stiffness

    def contact(self, position: float) -> int:
        """Returns 1: the medium is everywhere."""
        return 1

    def true_state(self, position: float, displacement: float, previous: float) -> float:
        """Returns the strain of the spring [m or rad] before it relaxes."""
        return previous + displacement

    def admissible(self, state: float, true: float) -> float:
        """Returns the state: the spring works both ways."""
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
        """Returns x exp(-T / relaxation time): exact for a hold in which nothing moves."""
        return state * math.exp(-sample_time / self.relaxation_time)
