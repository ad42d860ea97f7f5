"""Free space: no contact anywhere, to feel the bare device, and to check that a controller adds no torque."""

from typing import ClassVar

from canhaptic.control.environments import StoresNothing
from canhaptic.units import Parameters


class FreeSpace(StoresNothing, Parameters):
    """No contact anywhere."""

    damping: ClassVar[float] = 0.0
    linear_stiffness: ClassVar[float] = 0.0

    def contact(self, position: float) -> int:
        """Return 0: no position is in contact."""
        return 0
