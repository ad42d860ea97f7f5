"""No mechanism: every motor axis is a coordinate of task space, as on an X-Y stage."""

from collections.abc import Sequence
from typing import Annotated

from pydantic import PrivateAttr

from canhaptic.control.mechanisms.kinematics import Pose
from canhaptic.control.mechanisms.workspace import FromPose, Rows
from canhaptic.units import Parameters, quantity


class Identity(FromPose, Parameters):
    """x = q, for any number of axes, all in the same unit."""

    axes: Annotated[int, quantity("count", ge=1, le=16)]
    """Number of motor axes; of a group in a scene it follows from its `axes`."""
    _rows: Rows = PrivateAttr(default=())

    def model_post_init(self, context: object, /) -> None:
        """Keeps the Jacobian ready."""
        self._rows = tuple(tuple(1.0 if i == j else 0.0 for j in range(self.axes)) for i in range(self.axes))

    @property
    def dimensions(self) -> int:
        """Of task space."""
        return self.axes

    def pose(self, positions: Sequence[float]) -> Pose:
        """Returns the positions and a unit Jacobian."""
        return Pose(tuple(positions), self._rows)
