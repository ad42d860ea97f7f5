"""A guided path (virtual fixture): a spring and a damper towards a line through given points, free along it."""

from collections.abc import Sequence
from itertools import pairwise
from math import inf, sqrt
from typing import Annotated, NamedTuple

from pydantic import model_validator

from canhaptic.control.port_hamiltonian.network import Damper, Network, Spring
from canhaptic.control.port_hamiltonian.shapes import Rendered, check_length
from canhaptic.kernels import Buffer, Matrix
from canhaptic.units import Coordinates, Parameters, quantity


class GuidedPath(Parameters):
    """A path of straight segments from point to point; nothing is felt within `width` of it."""

    points: tuple[Coordinates, ...]
    """Task coordinates [m or rad] of the corners, two at least."""
    stiffness: Annotated[float, quantity("N/m", "N*m/rad", gt=0.0, le=1e9)]
    """Stiffness of the spring towards the path."""
    damping: Annotated[float, quantity("N*s/m", "N*m*s/rad", ge=0.0, le=1e7)] = 0.0
    """Damping coefficient across the path."""
    width: Annotated[float, quantity("m", "rad", ge=0.0)] = 0.0
    """Distance from the path at which the spring begins."""
    closed: bool = False
    """Whether the last point is joined to the first."""

    @model_validator(mode="after")
    def _is_a_line(self) -> "GuidedPath":
        if len(self.points) < 2 or any(len(point) != len(self.points[0]) for point in self.points):
            raise ValueError(f"points: got {len(self.points)}, expected at least 2 with equally many coordinates")
        ends = (*self.points, self.points[0]) if self.closed else self.points
        if any(a == b for a, b in pairwise(ends)):
            raise ValueError("points: got the same point twice in a row, expected neighbouring points that differ")
        return self

    def build(self, dimensions: int) -> Rendered:
        """Return the path; see `NetworkEnvironment`."""
        check_length("guided_path", "points", len(self.points[0]), dimensions)
        ends = (*self.points, self.points[0]) if self.closed else self.points
        spring = Spring(stiffness=self.stiffness, lower=None, upper=self.width)
        dampers = [Damper(viscous=self.damping, beside=0)] if self.damping else []
        return Rendered(Network([spring], dampers, gain=[[1.0]]), path_through(ends))


class FromPath(NamedTuple):
    """Distance from the nearest of several straight segments."""

    starts: Matrix  # (pieces, dimensions) [m or rad]
    along: Matrix  # from start to end
    squares: Buffer  # of the lengths
    dimensions: int  # of task space
    ports: int = 1

    def measure(self, position: Buffer, values: Buffer, rows: Matrix) -> None:
        """Write the distance from the nearest point of the path and the direction away from it."""
        least, nearest, place = inf, 0, 0.0
        for piece in range(len(self.squares)):
            start, along, total = self.starts[piece], self.along[piece], 0.0
            for i in range(len(position)):
                total += (position[i] - start[i]) * along[i]
            share = min(max(total / self.squares[piece], 0.0), 1.0)
            distance = 0.0
            for i in range(len(position)):
                away = position[i] - start[i] - share * along[i]
                distance += away * away
            if distance < least:
                least, nearest, place = distance, piece, share
        start, along, length, row = self.starts[nearest], self.along[nearest], sqrt(least), rows[0]
        for i in range(len(position)):
            row[i] = (position[i] - start[i] - place * along[i]) / length if length > 0.0 else 0.0
        values[0] = length


def path_through(points: Sequence[Sequence[float]]) -> FromPath:
    """Return the path from point to point."""
    starts = [list(a) for a, _ in pairwise(points)]
    along = [[y - x for x, y in zip(a, b, strict=True)] for a, b in pairwise(points)]
    return FromPath(starts, along, [sum(v * v for v in piece) for piece in along], len(starts[0]))
