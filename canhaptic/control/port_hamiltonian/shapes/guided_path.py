"""A guided path (virtual fixture): a spring and a damper towards a line through given points, free along it."""

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Annotated

from pydantic import model_validator

from canhaptic.control.port_hamiltonian.network import Damper, Network, Spring
from canhaptic.control.port_hamiltonian.shapes.geometry import Coordinates, Rendered, check_length
from canhaptic.control.port_hamiltonian.shapes.surface import Distance
from canhaptic.units import Parameters, quantity


class GuidedPath(Parameters):
    """Straight pieces from point to point; nothing is felt within `width` of them."""

    points: tuple[tuple[float, ...], ...]
    """Task coordinates [m or rad] of the corners, two at least."""
    stiffness: Annotated[float, quantity("N/m", "N*m/rad", gt=0.0, le=1e9)]
    """Of the spring towards the path."""
    damping: Annotated[float, quantity("N*s/m", "N*m*s/rad", ge=0.0, le=1e7)] = 0.0
    """Across the path."""
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
            raise ValueError("points: got the same point twice in a row, expected pieces with a length")
        return self

    def build(self, dimensions: int) -> Rendered:
        """Returns the path; see `NetworkEnvironment`."""
        check_length("guided_path", "points", len(self.points[0]), dimensions)
        ends = (*self.points, self.points[0]) if self.closed else self.points
        spring = Spring(stiffness=self.stiffness, lower=None, upper=self.width)
        dampers = [Damper(viscous=self.damping, beside=0)] if self.damping else []
        return Rendered(Network([spring], dampers, gain=[[1.0]]), _FromPath(ends, dimensions))


class _FromPath(Distance):
    def __init__(self, points: Sequence[Sequence[float]], dimensions: int) -> None:
        super().__init__(dimensions)
        pieces = []
        for a, b in pairwise(points):
            along = tuple(y - x for x, y in zip(a, b, strict=True))
            pieces.append((tuple(a), along, sum(v * v for v in along)))
        self._pieces = tuple(pieces)

    def measure(self, position: Sequence[float]) -> Coordinates:
        """Returns the distance from the nearest place of the path and the direction away from it."""
        least, nearest = math.inf, [0.0] * self.dimensions
        for start, along, square in self._pieces:
            offset = [p - s for p, s in zip(position, start, strict=True)]
            share = sum([o * a for o, a in zip(offset, along, strict=True)]) / square
            share = 0.0 if share < 0.0 else 1.0 if share > 1.0 else share
            away = [o - share * a for o, a in zip(offset, along, strict=True)]
            distance = sum([v * v for v in away])
            if distance < least:
                least, nearest = distance, away
        length = math.sqrt(least)
        row = tuple([v / length for v in nearest]) if length > 0.0 else (0.0,) * self.dimensions
        return Coordinates((length,), (row,))
