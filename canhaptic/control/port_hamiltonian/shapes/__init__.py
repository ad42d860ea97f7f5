"""Virtual objects in task space, each a port-Hamiltonian network, and the map from task space to its ports.

The map consists of coordinates whose increments move the ports, and of their gradients.

A contact with a surface has one coordinate: the distance from it, negative inside the material. Its increment is exact
for any curvature; the force acts along its gradient at the start of the hold, and the account, which is computed from
the torques, includes the effect of curvature.
"""

import math
from collections.abc import Sequence
from math import cos
from typing import Annotated, Final, NamedTuple, Protocol

from canhaptic.control.port_hamiltonian.network import Damper, Network, Spring
from canhaptic.errors import ParameterError
from canhaptic.kernels import Buffer, Matrix, list_of_zeros, zeros
from canhaptic.units import Parameters, quantity


class Geometry(Protocol):
    """Positions of a network's ports in task space. Immutable; as a NamedTuple of numbers and buffers it is compiled.

    Attributes:
        dimensions: Number of dimensions of task space.
        ports: Number of ports of the network.
    """

    @property
    def dimensions(self) -> int:
        """Dimensions of task space."""

    @property
    def ports(self) -> int:
        """Number of ports of the network."""

    def measure(self, position: Buffer, values: Buffer, rows: Matrix) -> None:
        """Write the coordinates of the ports at a position.

        Args:
            position: Position in task space [m or rad], (dimensions,).
            values: Receives the coordinates [m or rad], (ports,).
            rows: Receives d values / d position, (ports, dimensions).
        """


class Mover(NamedTuple):
    """A prescribed motion w(t) = half (1 - cos(rate t)), subtracted from each port coordinate; its energy is booked."""

    half: float = 0.0  # 0: nothing moves [m or rad]
    rate: float = 0.0  # [rad/s]


STILL: Final = Mover()


def moved_by(mover: Mover, time: float) -> float:
    """Return w(t) [m or rad] at a time [s]."""
    return mover.half * (1.0 - cos(mover.rate * time))


class Rendered(NamedTuple):
    """A network, its geometry, and its mover."""

    network: Network
    geometry: Geometry
    mover: Mover = STILL


class LinearGeometry(NamedTuple):
    """Geometry of ports with the coordinates A p - offset, p the position in task space."""

    matrix: Matrix  # A, one row for each port
    offset: Buffer  # [m or rad]
    ports: int
    dimensions: int  # of task space

    def measure(self, position: Buffer, values: Buffer, rows: Matrix) -> None:
        """Write A p - offset and A."""
        for i in range(len(values)):
            row, into, total = self.matrix[i], rows[i], -self.offset[i]
            for j in range(len(row)):
                total += row[j] * position[j]
                into[j] = row[j]
            values[i] = total


def linear_geometry(rows: Sequence[Sequence[float]], offset: Sequence[float]) -> LinearGeometry:
    """Return ports with the coordinates A p - offset.

    Args:
        rows: A, one row for each port.
        offset: One entry for each port [m or rad].
    """
    matrix = [[float(v) for v in row] for row in rows]
    return LinearGeometry(matrix, [float(v) for v in offset], len(matrix), len(matrix[0]))


def coordinates_at(geometry: Geometry, position: Sequence[float]) -> Buffer:
    """Return the coordinates of the ports at a position [m or rad]."""
    values = list_of_zeros(geometry.ports)
    geometry.measure(list(position), values, zeros(geometry.ports, geometry.dimensions))
    return values


def identity_rows(size: int) -> list[list[float]]:
    """Return the rows of a unit matrix."""
    return [[1.0 if i == j else 0.0 for j in range(size)] for i in range(size)]


def check_length(owner: str, name: str, seen: int, dimensions: int) -> None:
    """Check that a vector or matrix has one entry or row for each dimension of task space.

    Raises:
        ParameterError: The number differs.
    """
    if seen != dimensions:
        raise ParameterError(
            f"{owner}.{name}: got {seen} entries, expected {dimensions}, one for each dimension of task space"
        )


class Surface(Parameters):
    """Material behind a surface: a spring and a damper in parallel, felt where the distance is negative."""

    stiffness: Annotated[float, quantity("N/m", "N*m/rad", ge=0.0, le=1e9)]
    """Stiffness of the spring behind the surface."""
    hardening: Annotated[float, quantity("N/m^3", "N*m/rad^3", ge=0.0, le=1e15)] = 0.0
    """Cubic coefficient k3."""
    damping: Annotated[float, quantity("N*s/m", "N*m*s/rad", ge=0.0, le=1e7)] = 0.0
    """Coefficient of the damper in parallel with the spring; it acts in contact only."""

    def network(self) -> Network:
        """Return spring and damper at one port, engaged below 0."""
        return Network(
            [Spring(stiffness=self.stiffness, hardening=self.hardening, upper=None)],
            [Damper(viscous=self.damping, beside=0)] if self.damping else [],
            gain=[[1.0]],
        )

    def behind(self, geometry: Geometry, mover: Mover = STILL) -> Rendered:
        """Return the material, with the geometry that measures the distance from its surface, and with the mover."""
        return Rendered(self.network(), geometry, mover)


def unit_vector(owner: str, name: str, vector: Sequence[float], dimensions: int) -> tuple[float, ...]:
    """Return the direction of a vector.

    Raises:
        ParameterError: It has another number of entries than task space, or no direction.
    """
    length = math.hypot(*vector)
    if len(vector) != dimensions or not (length > 0.0 and math.isfinite(length)):
        raise ParameterError(
            f"{owner}.{name}: got {tuple(vector)}, expected {dimensions} finite numbers that are not all 0"
        )
    return tuple(v / length for v in vector)


def radial(row: Buffer, radius: float, sign: float) -> float:
    """Return the distance from a round surface [m or rad], and replace `row` by the gradient of that distance.

    Args:
        row: Offset from the centre, or from the nearest point of the axis [m or rad]; the gradient afterwards.
        radius: Radius of the surface [m or rad].
        sign: 1 where free space is outside, else -1.
    """
    square = 0.0
    for offset in row:
        square += offset * offset
    length = math.sqrt(square)
    if length > 0.0:
        for i in range(len(row)):
            row[i] = sign * row[i] / length
    else:  # at the very centre no way out is shorter than another
        for i in range(len(row)):
            row[i] = sign if i == 0 else 0.0
    return sign * (length - radius)
