"""A surface with Coulomb friction: sticks like a spring, slides at its limit (Prandtl's element)."""

from typing import Annotated, ClassVar

from canhaptic.control.environments import LinearSpring
from canhaptic.units import quantity


class CoulombSurface(LinearSpring):
    """Friction along the axis, everywhere: an elastic bristle that yields at the friction effort.

    A bristle that yields is passive and needs no sign of the velocity; its presliding stiffness is finite.
    """

    friction: Annotated[float, quantity("N", "N*m", ge=0.0, le=1e6)]
    """Friction force at which the surface slides."""
    stiffness: Annotated[float, quantity("N/m", "N*m/rad", gt=0.0, le=1e9)]
    """Stiffness of the bristle before it slides."""

    relaxes: ClassVar[bool] = True

    def relaxed(self, state: float, sample_time: float) -> float:
        """Return the state, limited to the strain at which the bristle yields; the released energy becomes heat."""
        limit = self.friction / self.stiffness
        return min(max(state, -limit), limit)
