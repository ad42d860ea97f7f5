"""From task space to the ports of a network: coordinates whose increments move the ports, and their gradients.

A contact with a curved surface has one coordinate, the distance from it. Its increment is exact for any curvature;
the force acts along its gradient at the start of the hold, and what curvature adds is seen by the account, which is
kept from the torques.
"""

from collections.abc import Sequence
from typing import NamedTuple, Protocol

from canhaptic.control.port_hamiltonian.network import Network
from canhaptic.errors import ParameterError

_Rows = tuple[tuple[float, ...], ...]


class Coordinates(NamedTuple):
    """The ports' coordinates at a position and their gradients."""

    values: tuple[float, ...]  # (ports,)
    rows: _Rows  # d values / d position, (ports, dimensions)


class Geometry(Protocol):
    """Where the ports of a network are in task space. Immutable.

    Attributes:
        dimensions: Of task space.
        ports: Of the network.
    """

    dimensions: int
    ports: int

    def measure(self, position: Sequence[float]) -> Coordinates:
        """Returns the coordinates of the ports at a position [m or rad]."""

    def mover(self, time: float) -> tuple[float, ...] | None:
        """Returns what is taken off each coordinate by a prescribed motion at a time [s]; None where nothing moves.

        The motion starts at 0 s with zeros. Its energy enters the network at a port of its own.
        """


class Rendered(NamedTuple):
    """A network and where it is."""

    network: Network
    geometry: Geometry


class LinearGeometry:
    """Coordinates A p - offset."""

    def __init__(self, rows: Sequence[Sequence[float]], offset: Sequence[float]) -> None:
        """Makes the geometry.

        Args:
            rows: A, one row for each port.
            offset: One entry for each port [m or rad].
        """
        self._rows = tuple(tuple(float(v) for v in row) for row in rows)
        self._offset = tuple(float(v) for v in offset)
        self.ports, self.dimensions = len(self._rows), len(self._rows[0])

    def measure(self, position: Sequence[float]) -> Coordinates:
        """Returns A p - offset and A."""
        values = []
        for row, offset in zip(self._rows, self._offset, strict=True):
            total = -offset
            for a, p in zip(row, position, strict=True):
                total += a * p
            values.append(total)
        return Coordinates(tuple(values), self._rows)

    def mover(self, time: float) -> tuple[float, ...] | None:
        """Returns None: nothing moves."""
        return None


def identity_rows(size: int) -> list[list[float]]:
    """Returns the rows of a unit matrix."""
    return [[1.0 if i == j else 0.0 for j in range(size)] for i in range(size)]


def check_length(owner: str, name: str, seen: int, dimensions: int) -> None:
    """Checks that a vector or matrix has one entry or row for each dimension of task space.

    Raises:
        ParameterError: It does not.
    """
    if seen != dimensions:
        raise ParameterError(
            f"{owner}.{name}: got {seen} entries, expected {dimensions}, one for each dimension of task space"
        )
