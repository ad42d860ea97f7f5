"""A viscous medium: a damper to ground everywhere, nothing stored."""

from typing import Annotated, ClassVar

from canhaptic.control.environments import StoresNothing
from canhaptic.units import Parameters, quantity


class ViscousMedium(StoresNothing, Parameters):
    """Honey: torque = -d v wherever the axis is."""

    damping: Annotated[float, quantity("N*s/m", "N*m*s/rad", ge=0.0, le=1e7)]
    """Viscous damping of the medium."""

    linear_stiffness: ClassVar[float] = 0.0
