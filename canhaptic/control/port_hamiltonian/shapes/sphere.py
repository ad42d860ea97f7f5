"""A sphere (in a plane: a disc) to touch from outside, or a hollow one to stay in."""

from collections.abc import Sequence
from typing import Annotated, Literal

from canhaptic.control.port_hamiltonian.shapes.geometry import Coordinates, Rendered, check_length
from canhaptic.control.port_hamiltonian.shapes.surface import Distance, Surface, radial
from canhaptic.units import quantity


class Sphere(Surface):
    """Round in every coordinate of task space."""

    centre: tuple[float, ...]
    """Task coordinates [m or rad] of the centre."""
    radius: Annotated[float, quantity("m", "rad", gt=0.0)]
    """From the centre to the surface."""
    side: Literal["inside", "outside"] = "outside"
    """Where free space is."""

    def build(self, dimensions: int) -> Rendered:
        """Returns the sphere; see `NetworkEnvironment`."""
        check_length("sphere", "centre", len(self.centre), dimensions)
        return self.behind(_Round(self.centre, self.radius, self.side == "outside"))


class _Round(Distance):
    def __init__(self, centre: Sequence[float], radius: float, outwards: bool) -> None:
        super().__init__(len(centre))
        self._centre, self._radius, self._outwards = tuple(centre), radius, outwards

    def measure(self, position: Sequence[float]) -> Coordinates:
        """Returns the distance from the surface and its normal."""
        offset = [p - c for p, c in zip(position, self._centre, strict=True)]
        return radial(offset, self._radius, self._outwards)
