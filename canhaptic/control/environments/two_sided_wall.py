"""A slot: free in the middle, a spring-damper wall on either side."""

import math
from typing import Annotated

from pydantic import model_validator

from canhaptic.control.environments import LinearSpring, kept_on_side
from canhaptic.units import quantity


class TwoSidedWall(LinearSpring):
    """Two walls of the same stiffness that face each other; free from `lower` to `upper`."""

    lower: Annotated[float, quantity("m", "rad")]
    """Surface of the wall below."""
    upper: Annotated[float, quantity("m", "rad")]
    """Surface of the wall above; more than `lower`."""

    @model_validator(mode="after")
    def _in_order(self) -> "TwoSidedWall":
        if self.lower > self.upper:
            raise ValueError(f"lower {self.lower} lies above upper {self.upper}; swap them")
        return self

    def contact(self, position: float) -> int:
        """Return 1 in the wall below, 2 in the wall above, 0 between."""
        if position < self.lower:
            return 1
        return 2 if position > self.upper else 0

    def true_state(self, position: float, displacement: float, previous: float) -> float:
        """Return the penetration [m or rad]: negative in the wall below, positive in the wall above."""
        return position - (self.lower if position < self.lower else self.upper)

    def admissible(self, state: float, true: float) -> float:
        """Return the state, or 0 if it lies outside the wall."""
        return kept_on_side(state, true)

    def one_way(self, position: float) -> tuple[float, float]:
        """Return the interval of positions in the wall that contains `position` [m or rad]; empty between the walls."""
        if position < self.lower:
            return -math.inf, self.lower
        return (self.upper, math.inf) if position > self.upper else (position, position)

    def rests(self) -> tuple[float, float]:
        """Return the positions between the walls, from and to [m or rad]."""
        return self.lower, self.upper
