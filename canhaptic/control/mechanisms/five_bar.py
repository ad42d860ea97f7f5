"""A planar five-bar: two motors on the base, two proximal links, two distal links that meet at the handle."""

import math
from collections.abc import Sequence
from typing import Annotated, ClassVar, Literal

from pydantic import model_validator

from canhaptic.control.mechanisms.kinematics import Limit, Pose
from canhaptic.control.mechanisms.workspace import FromPose, check_box, outside_box
from canhaptic.units import Parameters, quantity

_ZEROS = ((0.0, 0.0), (0.0, 0.0))
_SINGULAR = Pose((0.0, 0.0), _ZEROS, Limit.SINGULAR.value)
_APART = Pose((0.0, 0.0), _ZEROS, Limit.WORKSPACE.value)


class FiveBar(FromPose, Parameters):
    """Motors at (-base / 2, 0) and (base / 2, 0); angles counted from the +x axis.

    With A and B the elbows, the handle p is where the circles of the distal links meet. Differentiating
    |p - A| = const and |p - B| = const gives p' from q1' and q2'. It is lost where the distal links are in line (the
    handle cannot be held), and one motor loses its grip where its two links are in line (the edge of the workspace).
    """

    axes: ClassVar[int] = 2
    dimensions: ClassVar[int] = 2

    base: Annotated[float, quantity("m", ge=0.0)]
    """Distance between the motors."""
    proximal: tuple[Annotated[float, quantity("m", gt=0.0)], Annotated[float, quantity("m", gt=0.0)]]
    """Lengths of the links at the motors, first and second motor."""
    distal: tuple[Annotated[float, quantity("m", gt=0.0)], Annotated[float, quantity("m", gt=0.0)]]
    """Lengths of the links at the handle."""
    assembly: Literal["up", "down"] = "up"
    """Side of the line from first to second elbow on which the handle is: left of it (up) or right."""
    least_sine: Annotated[float, quantity("1", gt=0.0, lt=1.0)] = 0.1
    """Of the angle between the distal links, and between each distal link and its proximal one."""
    workspace_lower: tuple[float, ...] | None = None
    """Least task coordinates [m or rad] of the workspace, beyond which nothing is rendered; None: no such limit."""
    workspace_upper: tuple[float, ...] | None = None
    """Largest task coordinates [m or rad] of the workspace; None: no such limit."""

    @model_validator(mode="after")
    def _closes(self) -> "FiveBar":
        check_box(self.workspace_lower, self.workspace_upper, 2)
        reach = sum(self.proximal) + sum(self.distal)
        if self.base >= reach:
            raise ValueError(f"base: got {self.base:g} m, expected < {reach:g} m, the length of all links together")
        return self

    def pose(self, positions: Sequence[float]) -> Pose:
        """Returns the place of the handle; see `Kinematics`."""
        (l1, l2), (l3, l4), half = self.proximal, self.distal, 0.5 * self.base
        ax, ay = l1 * math.cos(positions[0]), l1 * math.sin(positions[0])  # of the elbows, from their motors
        bx, by = l2 * math.cos(positions[1]), l2 * math.sin(positions[1])
        dx, dy = bx - ax + self.base, by - ay
        square = dx * dx + dy * dy
        span = math.sqrt(square)
        if not abs(l3 - l4) < span < l3 + l4:
            return _APART
        along = (l3 * l3 - l4 * l4 + square) / (2.0 * span)
        height = math.sqrt(max(0.0, l3 * l3 - along * along))
        if self.assembly == "down":
            height = -height
        cx, cy = (along * dx - height * dy) / span, (along * dy + height * dx) / span  # first distal link
        ex, ey = cx - dx, cy - dy  # second distal link
        cross = cx * ey - cy * ex
        limit = self.least_sine
        if (
            abs(cross) < limit * l3 * l4
            or abs(ax * cy - ay * cx) < limit * l1 * l3
            or abs(bx * ey - by * ex) < limit * l2 * l4
        ):
            return _SINGULAR
        first, second = (ax * cy - ay * cx) / cross, (bx * ey - by * ex) / cross
        place = (ax - half + cx, ay + cy)
        outside = outside_box(place, self.workspace_lower, self.workspace_upper)
        return Pose(
            place, ((first * ey, -second * cy), (-first * ex, second * cx)), Limit.WORKSPACE.value if outside else 0
        )
