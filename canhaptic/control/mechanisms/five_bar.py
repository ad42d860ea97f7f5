"""A planar five-bar: two motors on the base, two proximal links, two distal links that meet at the handle."""

import math
from typing import Annotated, ClassVar, Literal, NamedTuple

from pydantic import model_validator

from canhaptic.control.mechanisms.kinematics import FromMechanism, Limit, WorkspaceBox, is_outside, workspace_box
from canhaptic.kernels import Buffer, Matrix
from canhaptic.units import Coordinates, Parameters, quantity

_WORKSPACE, _SINGULAR = Limit.WORKSPACE.value, Limit.SINGULAR.value


class FiveBarMap(NamedTuple):
    """Kinematic map of two motors and four links; see `FiveBar` and `KinematicsKernel`."""

    base: float
    proximal_1: float
    proximal_2: float
    distal_1: float
    distal_2: float
    is_below: bool
    least_sine: float
    box: WorkspaceBox

    def locate(self, positions: Buffer, place: Buffer, jacobian: Matrix) -> int:
        """Compute position and Jacobian of the handle into the buffers; return whether a limit is reached (`Limit`)."""
        l1, l2, l3, l4 = self.proximal_1, self.proximal_2, self.distal_1, self.distal_2
        ax, ay = l1 * math.cos(positions[0]), l1 * math.sin(positions[0])  # of the elbows, from their motors
        bx, by = l2 * math.cos(positions[1]), l2 * math.sin(positions[1])
        dx, dy = bx - ax + self.base, by - ay
        square = dx * dx + dy * dy
        span = math.sqrt(square)
        if not abs(l3 - l4) < span < l3 + l4:
            return _WORKSPACE
        along = (l3 * l3 - l4 * l4 + square) / (2.0 * span)
        height = math.sqrt(max(0.0, l3 * l3 - along * along))
        if self.is_below:
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
        place[0], place[1] = ax - 0.5 * self.base + cx, ay + cy
        jacobian[0][0], jacobian[0][1] = first * ey, -second * cy
        jacobian[1][0], jacobian[1][1] = -first * ex, second * cx
        return _WORKSPACE if is_outside(self.box, place) else 0


class FiveBar(FromMechanism, Parameters):
    """A five-bar with motors at (-base / 2, 0) and (base / 2, 0); angles are counted from the +x axis.

    With A and B the elbows, the handle p is where the circles of the distal links meet. Differentiating
    |p - A| = const and |p - B| = const gives p' from q1' and q2'. It fails where the distal links are in line (the
    handle cannot be held), and one motor has no effect where its two links are in line (the edge of the workspace).
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
    """Least sine of the angle between the distal links, and between each distal link and its proximal one."""
    workspace_lower: Coordinates | None = None
    """Least task coordinates [m or rad] of the workspace, beyond which nothing is rendered; None: no such limit."""
    workspace_upper: Coordinates | None = None
    """Largest task coordinates [m or rad] of the workspace; None: no such limit."""

    @model_validator(mode="after")
    def _closes(self) -> "FiveBar":
        workspace_box(self.workspace_lower, self.workspace_upper, 2)
        reach = sum(self.proximal) + sum(self.distal)
        if self.base >= reach:
            raise ValueError(f"base: got {self.base:g} m, expected < {reach:g} m, the length of all links together")
        return self

    def mechanism(self) -> FiveBarMap:
        """Return the kinematic map that the kernels call."""
        box = workspace_box(self.workspace_lower, self.workspace_upper, 2)
        return FiveBarMap(self.base, *self.proximal, *self.distal, self.assembly == "down", self.least_sine, box)
