"""Free space: nothing to touch. For feeling the device alone, and for checking that a controller adds nothing."""

from typing import ClassVar

from canhaptic.units import Parameters


class FreeSpace(Parameters):
    """No contact anywhere."""

    damping: ClassVar[float] = 0.0
    linear_stiffness: ClassVar[float] = 0.0
    relaxes: ClassVar[bool] = False

    def contact(self, position: float) -> int:
        """Return 0."""
        return 0

    def true_state(self, position: float, displacement: float, previous: float) -> float:
        """Return 0."""
        return 0.0

    def admissible(self, state: float, true: float) -> float:
        """Return 0."""
        return 0.0

    def stored_energy(self, state: float) -> float:
        """Return 0 J."""
        return 0.0

    def effort(self, state: float) -> float:
        """Return 0 N."""
        return 0.0

    def state_of_energy(self, energy: float, like: float) -> float:
        """Return 0."""
        return 0.0

    def relaxed(self, state: float, sample_time: float) -> float:
        """Return the state."""
        return state
