"""A sphere (in a plane: a disc) to touch from outside, or a hollow one to stay in."""

from typing import Annotated, Literal, NamedTuple

from canhaptic.control.port_hamiltonian.shapes import Rendered, Surface, check_length, radial
from canhaptic.kernels import Buffer, Matrix
from canhaptic.units import Coordinates, quantity


class Sphere(Surface):
    """A sphere in task space; a disc in a plane."""

    centre: Coordinates
    """Task coordinates [m or rad] of the centre."""
    radius: Annotated[float, quantity("m", "rad", gt=0.0)]
    """Radius of the surface."""
    side: Literal["inside", "outside"] = "outside"
    """Side of the surface on which the handle moves freely."""

    def build(self, dimensions: int) -> Rendered:
        """Return the sphere; see `NetworkEnvironment`."""
        check_length("sphere", "centre", len(self.centre), dimensions)
        return self.behind(Round(list(self.centre), self.radius, 1.0 if self.side == "outside" else -1.0, dimensions))


class Round(NamedTuple):
    """Distance from a sphere, or a disc."""

    centre: Buffer  # [m or rad]
    radius: float  # [m or rad]
    sign: float  # 1: free space is outside; -1: inside
    dimensions: int  # of task space
    ports: int = 1

    def measure(self, position: Buffer, values: Buffer, rows: Matrix) -> None:
        """Write the distance from the surface and its normal."""
        row = rows[0]
        for i in range(len(row)):
            row[i] = position[i] - self.centre[i]
        values[0] = radial(row, self.radius, self.sign)
