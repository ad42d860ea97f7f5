"""A sum of networks in one task space: each keeps its storages and ports, and their forces add, with one account."""

from collections.abc import Sequence
from functools import reduce
from typing import Any, NamedTuple

from canhaptic.control.port_hamiltonian.network import joined
from canhaptic.control.port_hamiltonian.shapes import STILL, Geometry, Rendered
from canhaptic.errors import ParameterError
from canhaptic.kernels import Buffer, Matrix, list_of_zeros, zeros
from canhaptic.units import Parameters


class BothGeometries(NamedTuple):
    """The ports of one geometry, then the ports of another. Each geometry is measured with its own buffers."""

    first: Any
    second: Any
    first_values: Buffer
    first_rows: Matrix
    second_values: Buffer
    second_rows: Matrix
    ports: int
    dimensions: int  # of task space

    def measure(self, position: Buffer, values: Buffer, rows: Matrix) -> None:
        """Write the coordinates of all ports, and their gradients."""
        self.first.measure(position, self.first_values, self.first_rows)
        self.second.measure(position, self.second_values, self.second_rows)
        count = len(self.first_values)
        for i in range(len(values)):
            if i < count:
                values[i] = self.first_values[i]
            else:
                values[i] = self.second_values[i - count]
            for j in range(len(position)):
                if i < count:
                    rows[i][j] = self.first_rows[i][j]
                else:
                    rows[i][j] = self.second_rows[i - count][j]


def both(first: Geometry, second: Geometry) -> BothGeometries:
    """Return the ports of two geometries of one task space."""
    rooms = [(list_of_zeros(of.ports), zeros(of.ports, of.dimensions)) for of in (first, second)]
    return BothGeometries(first, second, *rooms[0], *rooms[1], first.ports + second.ports, first.dimensions)


class SumOfNetworks(Parameters):
    """Networks that act together on one handle; made by `added`."""

    names: tuple[str, ...]
    parts: tuple[Any, ...]

    def build(self, dimensions: int) -> Rendered:
        """Return the networks as one; see `NetworkEnvironment`.

        Raises:
            ParameterError: A part does not fit, moves by itself, or is given by functions.
        """
        built: list[Rendered] = [part.build(dimensions) for part in self.parts]
        for name, part in zip(self.names, built, strict=True):
            reason = "moves by itself" if part.mover != STILL else "has functions" if part.network.has_functions else ""
            if reason:
                raise ParameterError(f"{name}: cannot be added: it {reason}, which no other part shares; leave it out")
        return Rendered(joined([part.network for part in built]), reduce(both, (part.geometry for part in built)))


def added(named: Sequence[tuple[str, Any]]) -> SumOfNetworks:
    """Return the sum of networks.

    Args:
        named: Name of each part for messages, and the part.
    """
    return SumOfNetworks(names=tuple(name for name, _ in named), parts=tuple(part for _, part in named))
