"""An arm with two revolute joints in a plane, driven at the joints or both from the base."""

import math
from collections.abc import Sequence
from typing import Annotated, ClassVar, Literal

from pydantic import model_validator

from canhaptic.control.mechanisms.kinematics import Limit, Pose
from canhaptic.control.mechanisms.workspace import FromPose, check_box, outside_box
from canhaptic.units import Parameters, quantity

_NOWHERE = Pose((0.0, 0.0), ((0.0, 0.0), (0.0, 0.0)), Limit.SINGULAR.value)


class Planar2R(FromPose, Parameters):
    """x = base + l1 (cos a, sin a) + l2 (cos b, sin b), a = q1, b the direction of the second link."""

    axes: ClassVar[int] = 2
    dimensions: ClassVar[int] = 2

    first: Annotated[float, quantity("m", gt=0.0)]
    """Length l1 of the first link."""
    second: Annotated[float, quantity("m", gt=0.0)]
    """Length l2 of the second link."""
    base: tuple[Annotated[float, quantity("m")], Annotated[float, quantity("m")]] = (0.0, 0.0)
    """Where the first joint is in the plane."""
    elbow: Literal["relative", "absolute"] = "relative"
    """Whether q2 turns the second link against the first (motor at the elbow) or against the base (parallelogram)."""
    least_sine: Annotated[float, quantity("1", gt=0.0, lt=1.0)] = 0.1
    """Of the angle between the links; stretched or folded further than that, the pose is singular."""
    workspace_lower: tuple[float, ...] | None = None
    """Least task coordinates [m or rad] of the workspace, beyond which nothing is rendered; None: no such limit."""
    workspace_upper: tuple[float, ...] | None = None
    """Largest task coordinates [m or rad] of the workspace; None: no such limit."""

    @model_validator(mode="after")
    def _box(self) -> "Planar2R":
        check_box(self.workspace_lower, self.workspace_upper, 2)
        return self

    def pose(self, positions: Sequence[float]) -> Pose:
        """Returns the place of the handle; see `Kinematics`."""
        a = positions[0]
        relative = self.elbow == "relative"
        b = a + positions[1] if relative else positions[1]
        if not abs(math.sin(b - a)) >= self.least_sine:
            return _NOWHERE
        x1, y1 = self.first * math.cos(a), self.first * math.sin(a)
        x2, y2 = self.second * math.cos(b), self.second * math.sin(b)
        place = (self.base[0] + x1 + x2, self.base[1] + y1 + y2)
        jacobian = ((-y1 - y2, -y2), (x1 + x2, x2)) if relative else ((-y1, -y2), (x1, x2))
        outside = outside_box(place, self.workspace_lower, self.workspace_upper)
        return Pose(place, jacobian, Limit.WORKSPACE.value if outside else 0)
