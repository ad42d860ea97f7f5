"""The paper's virtual wall: a spring and a damper side by side, felt on one side of a plane (eqs. 12-14)."""

from math import copysign, sqrt
from typing import Annotated, ClassVar

from canhaptic.haptics.environments.sides import Side
from canhaptic.parameters import Parameters, quantity


class SpringDamperWall(Parameters):
    """A wall that is in contact while the position is beyond its surface."""

    stiffness: Annotated[float, quantity("N/m", "N*m/rad", ge=0.0, le=1e9)]
    """Of the spring behind the surface."""
    damping: Annotated[float, quantity("N*s/m", "N*m*s/rad", ge=0.0, le=1e7)] = 0.0
    """Of the damper beside the spring; it acts in contact only."""
    position: Annotated[float, quantity("m", "rad")] = 0.0
    """Where the surface is."""
    side: Side = "below"
    """Where the wall is solid: below its position, or above it."""

    relaxes: ClassVar[bool] = False

    @property
    def linear_stiffness(self) -> float:
        """Stiffness k [N/m or N*m/rad]."""
        return self.stiffness

    def contact(self, position: float) -> int:
        """Returns 1 inside the wall, 0 outside (eq. 12)."""
        if self.side == "below":
            return 1 if position < self.position else 0
        return 1 if position > self.position else 0

    def true_state(self, position: float, displacement: float, previous: float) -> float:
        """Returns x = q - q_w [m or rad] (eq. 14): negative in a wall below, positive in a wall above."""
        return position - self.position

    def admissible(self, state: float, true: float) -> float:
        """Returns the state, or 0 where it lies outside the wall."""
        return state if state * true >= 0.0 else 0.0

    def stored_energy(self, state: float) -> float:
        """Returns k x^2 / 2 [J]."""
        return 0.5 * self.stiffness * state * state

    def effort(self, state: float) -> float:
        """Returns k x [N or N*m]."""
        return self.stiffness * state

    def state_of_energy(self, energy: float, like: float) -> float:
        """Returns sqrt(2 H / k) with the sign of `like`; eq. 18 prints it positive, where contact has x < 0."""
        if self.stiffness == 0.0:
            return 0.0
        return copysign(sqrt(2.0 * energy / self.stiffness) if energy > 0.0 else 0.0, like)

    def relaxed(self, state: float, sample_time: float) -> float:
        """Returns the state: nothing relaxes."""
        return state
