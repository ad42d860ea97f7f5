"""A viscous medium: a damper to ground everywhere, nothing stored."""

from typing import Annotated, ClassVar

from canhaptic.units import Parameters, quantity


class ViscousMedium(Parameters):
    """Honey: torque = -d v wherever the axis is."""

    damping: Annotated[float, quantity("N*s/m", "N*m*s/rad", ge=0.0, le=1e7)]
    """Coefficient d of the medium."""

    linear_stiffness: ClassVar[float] = 0.0
    relaxes: ClassVar[bool] = False

    def contact(self, position: float) -> int:
        """Return 1: the medium is everywhere."""
        return 1

    def true_state(self, position: float, displacement: float, previous: float) -> float:
        """Return the path since the start [m or rad]; nothing depends on it."""
        return previous + displacement

    def admissible(self, state: float, true: float) -> float:
        """Return the state: the medium has no surface."""
        return state

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
