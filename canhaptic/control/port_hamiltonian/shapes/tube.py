"""A straight tube to stay in, or a rod to touch from outside; along it the motion is free."""

from collections.abc import Sequence
from typing import Annotated, Literal

from canhaptic.control.port_hamiltonian.shapes.geometry import Coordinates, Rendered, check_length
from canhaptic.control.port_hamiltonian.shapes.surface import Distance, Surface, radial, unit_vector
from canhaptic.units import quantity


class Tube(Surface):
    """Around the line through `point` along `direction`; in a plane it is a channel."""

    point: tuple[float, ...]
    """Any one point [m or rad] of the line."""
    direction: tuple[float, ...]
    """Along the line; its length does not matter."""
    radius: Annotated[float, quantity("m", "rad", gt=0.0)]
    """From the line to the surface."""
    side: Literal["inside", "outside"] = "inside"
    """Where free space is."""

    def build(self, dimensions: int) -> Rendered:
        """Returns the tube; see `NetworkEnvironment`."""
        check_length("tube", "point", len(self.point), dimensions)
        check_length("tube", "direction, of at least 2 dimensions,", len(self.direction), max(2, dimensions))
        direction = unit_vector("tube", "direction", self.direction, dimensions)
        return self.behind(_AroundLine(self.point, direction, self.radius, self.side == "outside"))


class _AroundLine(Distance):
    def __init__(self, point: Sequence[float], direction: tuple[float, ...], radius: float, outwards: bool) -> None:
        super().__init__(len(point))
        self._point, self._direction, self._radius, self._outwards = tuple(point), direction, radius, outwards

    def measure(self, position: Sequence[float]) -> Coordinates:
        """Returns the distance from the surface and its normal."""
        offset = [p - c for p, c in zip(position, self._point, strict=True)]
        along = sum([o * d for o, d in zip(offset, self._direction, strict=True)])
        return radial(
            [o - along * d for o, d in zip(offset, self._direction, strict=True)], self._radius, self._outwards
        )
