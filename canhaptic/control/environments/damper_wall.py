"""A wall without a spring (k = 0): a damper beyond a surface, which slows the hand going in and coming out."""

from typing import Annotated, ClassVar

from canhaptic.control.environments.environment import Side, is_beyond, kept_on_side
from canhaptic.units import Parameters, quantity


class DamperWall(Parameters):
    """A half space of viscous matter; nothing is stored."""

    damping: Annotated[float, quantity("N*s/m", "N*m*s/rad", ge=0.0, le=1e7)]
    """Coefficient d inside the half space."""
    position: Annotated[float, quantity("m", "rad")] = 0.0
    """Where the surface is."""
    side: Side = "below"
    """Where it is solid: below its position, or above it."""

    linear_stiffness: ClassVar[float] = 0.0
    relaxes: ClassVar[bool] = False

    @property
    def is_below(self) -> bool:
        """Whether it is solid below its position."""
        return self.side == "below"

    def contact(self, position: float) -> int:
        """Return 1 beyond the surface, 0 outside."""
        return int(is_beyond(position, self.position, self.is_below))

    def true_state(self, position: float, displacement: float, previous: float) -> float:
        """Return the depth q - q_w [m or rad]."""
        return position - self.position

    def admissible(self, state: float, true: float) -> float:
        """Return the state, or 0 where it lies outside."""
        return kept_on_side(state, true)

    def stored_energy(self, state: float) -> float:
        """Return 0 J."""
        return 0.0

    def effort(self, state: float) -> float:
        """Return 0 N."""
        return 0.0

    def state_of_energy(self, energy: float, like: float) -> float:
        """Return 0: no state stores energy."""
        return 0.0

    def relaxed(self, state: float, sample_time: float) -> float:
        """Return the state: nothing relaxes."""
        return state
