"""An arm with two revolute joints in a plane, driven at the joints or both from the base."""

import math
from typing import Annotated, ClassVar, Literal, NamedTuple

from pydantic import model_validator

from canhaptic.control.mechanisms.kinematics import FromMechanism, Limit, WorkspaceBox, is_outside, workspace_box
from canhaptic.kernels import Buffer, Matrix
from canhaptic.units import Coordinates, Parameters, quantity

_WORKSPACE, _SINGULAR = Limit.WORKSPACE.value, Limit.SINGULAR.value


class LinkMap(NamedTuple):
    """Kinematic map of an arm with two links; see `Planar2R` and `KinematicsKernel`."""

    first: float
    second: float
    base_x: float
    base_y: float
    relative: bool
    least_sine: float
    box: WorkspaceBox

    def locate(self, positions: Buffer, place: Buffer, jacobian: Matrix) -> int:
        """Compute position and Jacobian of the handle into the buffers; return whether a limit is reached (`Limit`)."""
        a = positions[0]
        b = a + positions[1] if self.relative else positions[1]
        if not abs(math.sin(b - a)) >= self.least_sine:
            return _SINGULAR
        x1, y1 = self.first * math.cos(a), self.first * math.sin(a)
        x2, y2 = self.second * math.cos(b), self.second * math.sin(b)
        place[0], place[1] = self.base_x + x1 + x2, self.base_y + y1 + y2
        if self.relative:
            jacobian[0][0], jacobian[1][0] = -y1 - y2, x1 + x2
        else:
            jacobian[0][0], jacobian[1][0] = -y1, x1
        jacobian[0][1], jacobian[1][1] = -y2, x2
        return _WORKSPACE if is_outside(self.box, place) else 0


class Planar2R(FromMechanism, Parameters):
    """x = base + l1 (cos a, sin a) + l2 (cos b, sin b), a = q1, b the direction of the second link."""

    axes: ClassVar[int] = 2
    dimensions: ClassVar[int] = 2

    first: Annotated[float, quantity("m", gt=0.0)]
    """Length l1 of the first link."""
    second: Annotated[float, quantity("m", gt=0.0)]
    """Length l2 of the second link."""
    base: tuple[Annotated[float, quantity("m")], Annotated[float, quantity("m")]] = (0.0, 0.0)
    """Position of the first joint in the plane."""
    elbow: Literal["relative", "absolute"] = "relative"
    """Whether q2 turns the second link against the first (motor at the elbow) or against the base (parallelogram)."""
    least_sine: Annotated[float, quantity("1", gt=0.0, lt=1.0)] = 0.1
    """Least sine of the angle between the links; stretched or folded further than that, the pose is singular."""
    workspace_lower: Coordinates | None = None
    """Least task coordinates [m or rad] of the workspace, beyond which nothing is rendered; None: no such limit."""
    workspace_upper: Coordinates | None = None
    """Largest task coordinates [m or rad] of the workspace; None: no such limit."""

    @model_validator(mode="after")
    def _box(self) -> "Planar2R":
        workspace_box(self.workspace_lower, self.workspace_upper, 2)
        return self

    def mechanism(self) -> LinkMap:
        """Return the kinematic map that the kernels call."""
        box = workspace_box(self.workspace_lower, self.workspace_upper, 2)
        return LinkMap(self.first, self.second, *self.base, self.elbow == "relative", self.least_sine, box)
