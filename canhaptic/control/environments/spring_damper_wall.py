"""The paper's virtual wall: a spring and a damper side by side, felt on one side of a plane (eqs. 12-14)."""

from typing import Annotated, ClassVar

from canhaptic.control.environments.environment import LinearSpring, Side
from canhaptic.units import quantity


class SpringDamperWall(LinearSpring):
    """A wall that is in contact while the position is beyond its surface."""

    position: Annotated[float, quantity("m", "rad")] = 0.0
    """Where the surface is."""
    side: Side = "below"
    """Where the wall is solid: below its position, or above it."""

    relaxes: ClassVar[bool] = False

    @property
    def is_below(self) -> bool:
        """Whether it is solid below its position."""
        return self.side == "below"

    def contact(self, position: float) -> int:
        """Return 1 inside the wall, 0 outside (eq. 12)."""  # not by `sides`: most scenes ask this at every SYNC
        if self.is_below:
            return 1 if position < self.position else 0
        return 1 if position > self.position else 0

    def true_state(self, position: float, displacement: float, previous: float) -> float:
        """Return x = q - q_w [m or rad] (eq. 14): negative in a wall below, positive in a wall above."""
        return position - self.position

    def admissible(self, state: float, true: float) -> float:
        """Return the state, or 0 where it lies outside the wall."""
        return state if state * true >= 0.0 else 0.0

    def relaxed(self, state: float, sample_time: float) -> float:
        """Return the state: nothing relaxes."""
        return state
