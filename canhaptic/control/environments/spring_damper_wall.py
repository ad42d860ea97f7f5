"""The paper's virtual wall: a spring and a damper in parallel, felt on one side of a plane (eqs. 12-14)."""

from typing import Annotated

from canhaptic.control.environments.environment import LinearSpring, OneSided, Side
from canhaptic.units import quantity


class SpringDamperWall(OneSided, LinearSpring):
    """A wall that is in contact while the position is beyond its surface."""

    position: Annotated[float, quantity("m", "rad")] = 0.0
    """Where the surface is."""
    side: Side = "below"
    """Where the wall is solid: below its position, or above it."""
