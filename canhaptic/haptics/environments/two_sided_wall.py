"""A slot: free in the middle, a spring-damper wall on either side."""

import math
from typing import Annotated, ClassVar

from pydantic import model_validator

from canhaptic.haptics.environments.sides import kept_on_side
from canhaptic.parameters import Parameters, quantity


class TwoSidedWall(Parameters):
    """Two walls of the same stiffness that face each other; free from `lower` to `upper`."""

    stiffness: Annotated[float, quantity("N/m", "N*m/rad", ge=0.0, le=1e9)]
    """Of the spring behind each surface."""
    damping: Annotated[float, quantity("N*s/m", "N*m*s/rad", ge=0.0, le=1e7)] = 0.0
    """Of the damper beside the spring; it acts in contact only."""
    lower: Annotated[float, quantity("m", "rad")]
    """Surface of the wall below."""
    upper: Annotated[float, quantity("m", "rad")]
    """Surface of the wall above; more than `lower`."""

    relaxes: ClassVar[bool] = False

    @model_validator(mode="after")
    def _in_order(self) -> "TwoSidedWall":
        if self.lower > self.upper:
            raise ValueError(f"lower {self.lower} lies above upper {self.upper}; swap them")
        return self

    @property
    def linear_stiffness(self) -> float:
        """Stiffness k of either wall [N/m or N*m/rad]."""
        return self.stiffness

    def contact(self, position: float) -> int:
        """Returns 1 in the wall below, 2 in the wall above, 0 between."""
        if position < self.lower:
            return 1
        return 2 if position > self.upper else 0

    def true_state(self, position: float, displacement: float, previous: float) -> float:
        """Returns the penetration [m or rad]: negative in the wall below, positive in the wall above."""
        return position - (self.lower if position < self.lower else self.upper)

    def admissible(self, state: float, true: float) -> float:
        """Returns the state, or 0 where it lies outside the wall."""
        return kept_on_side(state, true)

    def stored_energy(self, state: float) -> float:
        """Returns k x^2 / 2 [J]."""
        return 0.5 * self.stiffness * state * state

    def effort(self, state: float) -> float:
        """Returns k x [N or N*m]."""
        return self.stiffness * state

    def state_of_energy(self, energy: float, like: float) -> float:
        """Returns sqrt(2 H / k) with the sign of `like`."""
        if self.stiffness == 0.0:
            return 0.0
        return math.copysign(math.sqrt(2.0 * max(0.0, energy) / self.stiffness), like)

    def relaxed(self, state: float, sample_time: float) -> float:
        """Returns the state: nothing relaxes."""
        return state
