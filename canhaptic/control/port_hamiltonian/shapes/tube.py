"""A straight tube to stay in, or a rod to touch from outside; along it the motion is free."""

from typing import Annotated, Final, Literal, NamedTuple

from canhaptic.control.port_hamiltonian.shapes import Rendered, Surface, check_length, radial, unit_vector
from canhaptic.errors import ParameterError
from canhaptic.kernels import Buffer, Matrix
from canhaptic.units import Coordinates, Numbers, quantity

_ON_THE_LINE: Final = 1e-12
"""Distance from the line, as a fraction of the radius, within which a position counts as on the line."""


class Tube(Surface):
    """A tube around the line through `point` along `direction`; in a plane a channel."""

    point: Coordinates
    """Any point of the line [m or rad]."""
    direction: Numbers
    """Direction of the line; its length does not matter."""
    radius: Annotated[float, quantity("m", "rad", gt=0.0)]
    """Distance of the surface from the line."""
    side: Literal["inside", "outside"] = "inside"
    """Side of the surface on which the handle moves freely."""

    def build(self, dimensions: int) -> Rendered:
        """Return the tube; see `NetworkEnvironment`."""
        if dimensions < 2:
            raise ParameterError(
                f"tube: got a task space of {dimensions} dimension, expected at least 2: motion along it is free, "
                "so nothing would be felt; use a box"
            )
        check_length("tube", "point", len(self.point), dimensions)
        direction = unit_vector("tube", "direction", self.direction, dimensions)
        return self.behind(
            AroundLine(
                list(self.point), list(direction), self.radius, 1.0 if self.side == "outside" else -1.0, dimensions
            )
        )


class AroundLine(NamedTuple):
    """Distance from a round surface about a line."""

    point: Buffer  # of the line [m or rad]
    direction: Buffer  # of length 1
    radius: float  # [m or rad]
    sign: float  # 1: free space is outside; -1: inside
    dimensions: int  # of task space
    ports: int = 1

    def measure(self, position: Buffer, values: Buffer, rows: Matrix) -> None:
        """Write the distance from the surface and its normal."""
        row, along, square, across = rows[0], 0.0, 0.0, 0
        for i in range(len(row)):
            row[i] = position[i] - self.point[i]
            along += row[i] * self.direction[i]
            if abs(self.direction[i]) < abs(self.direction[across]):
                across = i
        for i in range(len(row)):
            row[i] -= along * self.direction[i]
            square += row[i] * row[i]
        least = _ON_THE_LINE * self.radius
        if square <= least * least:  # what rounding leaves points anywhere: take one of the shortest ways out
            for i in range(len(row)):
                row[i] = least * ((1.0 if i == across else 0.0) - self.direction[across] * self.direction[i])
        values[0] = radial(row, self.radius, self.sign)
