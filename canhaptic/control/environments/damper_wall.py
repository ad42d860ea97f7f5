"""A wall without a spring (k = 0): a damper beyond a surface, which slows the hand going in and coming out."""

from typing import Annotated, ClassVar

from canhaptic.control.environments.environment import OneSided, Side, StoresNothing
from canhaptic.units import Parameters, quantity


class DamperWall(OneSided, StoresNothing, Parameters):
    """A half space of viscous matter; nothing is stored."""

    damping: Annotated[float, quantity("N*s/m", "N*m*s/rad", ge=0.0, le=1e7)]
    """Coefficient d inside the half space."""
    position: Annotated[float, quantity("m", "rad")] = 0.0
    """Where the surface is."""
    side: Side = "below"
    """Where it is solid: below its position, or above it."""

    linear_stiffness: ClassVar[float] = 0.0
