"""A box with its faces along the axes of task space: a room to stay in, or a body to touch from outside."""

from collections.abc import Sequence
from typing import Literal

from pydantic import model_validator

from canhaptic.control.port_hamiltonian.network import Damper, Network, Spring
from canhaptic.control.port_hamiltonian.shapes.geometry import (
    Coordinates,
    LinearGeometry,
    Rendered,
    check_length,
    identity_rows,
)
from canhaptic.control.port_hamiltonian.shapes.surface import Distance, Surface


class Box(Surface):
    """From `lower` to `upper` in every coordinate."""

    lower: tuple[float, ...]
    """Least task coordinates [m or rad] of the box."""
    upper: tuple[float, ...]
    """Largest task coordinates [m or rad]; each more than that of `lower`."""
    side: Literal["inside", "outside"] = "inside"
    """Where free space is."""

    @model_validator(mode="after")
    def _has_inside(self) -> "Box":
        if len(self.lower) != len(self.upper) or any(a >= b for a, b in zip(self.lower, self.upper, strict=False)):
            raise ValueError(
                f"got lower {self.lower} and upper {self.upper}, expected lower < upper in every coordinate"
            )
        return self

    def build(self, dimensions: int) -> Rendered:
        """Returns the box; see `NetworkEnvironment`."""
        check_length("box", "lower", len(self.lower), dimensions)
        if self.side == "outside":
            return self.behind(_Body(self.lower, self.upper))
        springs = [
            Spring(stiffness=self.stiffness, hardening=self.hardening, lower=low, upper=high)
            for low, high in zip(self.lower, self.upper, strict=True)
        ]
        dampers = [Damper(viscous=self.damping, beside=i) for i in range(dimensions)] if self.damping else []
        rows = identity_rows(dimensions)
        return Rendered(Network(springs, dampers, gain=rows), LinearGeometry(rows, [0.0] * dimensions))


class _Body(Distance):
    """Distance from the nearest face; inside the body it is continuous, and the face changes on its ridges."""

    def __init__(self, lower: Sequence[float], upper: Sequence[float]) -> None:
        super().__init__(len(lower))
        self._faces = tuple(zip(lower, upper, strict=True))

    def measure(self, position: Sequence[float]) -> Coordinates:
        """Returns the largest distance from any face's plane, and the normal of that face."""
        largest, axis, sign = -float("inf"), 0, 1.0
        for i, (value, (low, high)) in enumerate(zip(position, self._faces, strict=True)):
            below, above = low - value, value - high
            distance, side = (below, -1.0) if below > above else (above, 1.0)
            if distance > largest:
                largest, axis, sign = distance, i, side
        row = [0.0] * self.dimensions
        row[axis] = sign
        return Coordinates((largest,), (tuple(row),))
