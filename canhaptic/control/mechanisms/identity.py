"""No mechanism: every motor axis is a coordinate of task space, as on an X-Y stage."""

from typing import Annotated, NamedTuple

from canhaptic.control.mechanisms.workspace import FromMechanism
from canhaptic.kernels import Buffer, Matrix
from canhaptic.units import Parameters, quantity


class IdentityMap(NamedTuple):
    """x = q; see `KinematicsKernel`."""

    axes: int

    def locate(self, positions: Buffer, place: Buffer, jacobian: Matrix) -> int:
        """Write the positions and a unit Jacobian."""
        for i in range(self.axes):
            place[i] = positions[i]
            jacobian[i][i] = 1.0
        return 0


class Identity(FromMechanism, Parameters):
    """x = q, for any number of axes, all in the same unit."""

    axes: Annotated[int, quantity("count", ge=1, le=16)]
    """Number of motor axes; of a group in a scene it follows from its `axes`."""

    @property
    def dimensions(self) -> int:
        """Dimensions of task space."""
        return self.axes

    def mechanism(self) -> IdentityMap:
        """Return the map."""
        return IdentityMap(self.axes)
