"""A wall without a spring (k = 0): a damper beyond a surface, which slows the hand going in and coming out."""

from typing import Annotated, ClassVar

from canhaptic.control.environments import OneSided, StoresNothing
from canhaptic.units import quantity


class DamperWall(OneSided, StoresNothing):
    """A half space of viscous matter; nothing is stored."""

    damping: Annotated[float, quantity("N*s/m", "N*m*s/rad", ge=0.0, le=1e7)]
    """Viscous damping inside the half space."""

    linear_stiffness: ClassVar[float] = 0.0
    rests = StoresNothing.rests
