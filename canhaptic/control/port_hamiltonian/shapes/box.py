"""A box with its faces along the axes of task space: a room to stay in, or a body to touch from outside."""

from math import inf
from typing import Literal, NamedTuple

from pydantic import model_validator

from canhaptic.control.port_hamiltonian.network import Damper, Network, Spring
from canhaptic.control.port_hamiltonian.shapes import Rendered, Surface, check_length, identity_rows, linear_geometry
from canhaptic.kernels import Buffer, Matrix
from canhaptic.units import Coordinates


class Box(Surface):
    """A box from `lower` to `upper` in every coordinate."""

    lower: Coordinates
    """Least task coordinates [m or rad] of the box."""
    upper: Coordinates
    """Largest task coordinates [m or rad]; each above its entry of `lower`."""
    side: Literal["inside", "outside"] = "inside"
    """Side of the faces on which the handle moves freely."""

    @model_validator(mode="after")
    def _has_inside(self) -> "Box":
        if len(self.lower) != len(self.upper) or not all(a < b for a, b in zip(self.lower, self.upper, strict=False)):
            raise ValueError(
                f"got lower {self.lower} and upper {self.upper}, expected lower < upper in every coordinate"
            )
        return self

    def build(self, dimensions: int) -> Rendered:
        """Return the box; see `NetworkEnvironment`."""
        check_length("box", "lower", len(self.lower), dimensions)
        if self.side == "outside":
            return self.behind(BoxInside(list(self.lower), list(self.upper), dimensions))
        springs = [
            Spring(stiffness=self.stiffness, hardening=self.hardening, lower=low, upper=high)
            for low, high in zip(self.lower, self.upper, strict=True)
        ]
        dampers = [Damper(viscous=self.damping, beside=i) for i in range(dimensions)] if self.damping else []
        rows = identity_rows(dimensions)
        return Rendered(Network(springs, dampers, gain=rows), linear_geometry(rows, [0.0] * dimensions))


class BoxInside(NamedTuple):
    """Distance from the nearest face of a box; continuous inside it, with a kink where the nearest face changes."""

    lower: Buffer
    upper: Buffer
    dimensions: int  # of task space
    ports: int = 1

    def measure(self, position: Buffer, values: Buffer, rows: Matrix) -> None:
        """Write the largest distance from any face's plane, and the normal of that face."""
        largest, axis, sign = -inf, 0, 1.0
        for i in range(len(self.lower)):
            below, above = self.lower[i] - position[i], position[i] - self.upper[i]
            distance, side = (below, -1.0) if below > above else (above, 1.0)
            if distance > largest:
                largest, axis, sign = distance, i, side
            rows[0][i] = 0.0
        values[0], rows[0][axis] = largest, sign
