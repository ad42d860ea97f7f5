"""A port-Hamiltonian network: storages, dissipators, structure and ports, checked on construction (section III).

xdot = (J(x) - R(x)) e + g u,    e = dH/dx,    y = g'e + S u,    effort on the user's side = -y

network = Network(
    storages=[Spring(stiffness=800.0), Mass(mass=0.3)],       # x = (extension, momentum)
    dissipators=[Damper(viscous=2.0, states={1: 1.0})],      # a floor under the mass
    structure=[[0.0, -1.0], [1.0, 0.0]],                     # extension' = u - v, momentum' = spring
    gain=[[1.0], [0.0]],                                     # one port pulls at the spring
)

A network as plain numbers, its stored energy, and the discrete gradient of that energy (Gonzalez 1996).

For a storage of one state the discrete gradient is the divided difference (H(x + s) - H(x)) / s, for a quadratic form
Q (x + s / 2); each is exact, H(x + s) - H(x) = e . s, and so is their sum.

A scalar storage has the extension d = x beyond `upper`, x below `lower` and 0 between them - measured from those
edges - and stores k d^2 / 2 + k3 d^4 / 4. With lower = upper = 0 it is always engaged; a wall is engaged on one side.
With k < 0 it is a double well and stores k3 (d^2 + k / k3)^2 / 4, the same but for a constant: 0 in the wells.
"""

import math
from collections.abc import Callable, Sequence
from typing import Final, NamedTuple

import numpy as np

from canhaptic.control.port_hamiltonian.gauss import dot
from canhaptic.control.port_hamiltonian.storages import (
    Damper,
    DampingMatrix,
    Dissipator,
    DoubleWell,
    Functions,
    Mass,
    NoFunctions,
    QuadraticForm,
    Spring,
    Storage,
    UserEnergy,
    UserFunctions,
    edges,
    states_of,
)
from canhaptic.errors import ParameterError
from canhaptic.kernels import Buffer, Indices, Matrix


class NetworkTables(NamedTuple):
    """A network as data: n states, r ports, d dissipators."""

    stiffness: Buffer  # k, (n,)
    hardening: Buffer  # k3, (n,)
    lower: Buffer  # (n,)
    upper: Buffer  # (n,)
    coupled: bool  # whether `quadratic` is not zero
    quadratic: Matrix  # Q of x'Qx / 2, (n, n)
    moving: bool  # whether the state moves by itself: structure or dissipators on states
    structure: Matrix  # J, skew, (n, n)
    gain: Matrix  # g, (n, r)
    on_states: Matrix  # row of each dissipator over the efforts of the states, (d, n)
    on_ports: Matrix  # row of each dissipator over the port flows, (d, r)
    viscous: Buffer  # (d,)
    squared: Buffer  # (d,)
    coulomb: Buffer  # (d,)
    corner: Buffer  # flow at which Coulomb friction reaches 0.71 of its value, (d,)
    beside: Indices  # storage in parallel with a dissipator, only where that is engaged; -1: always, (d,)
    origin: Matrix  # rows of x(0) over the ports' first coordinates, (n, r)
    edged: Indices  # states whose storage can be left
    always: bool  # whether some storage or dissipator is felt everywhere
    by_functions: bool  # whether energies or the structure are also given as functions


def extension(tables: NetworkTables, index: int, value: float) -> float:
    """Return how far a state is beyond the edges of its storage; 0 where it is not engaged."""
    upper = tables.upper[index]
    if value > upper:
        return value - upper
    lower = tables.lower[index]
    return value - lower if value < lower else 0.0


def stored_energy(tables: NetworkTables, state: Buffer) -> float:
    """Return H(x) without user energies [J]."""
    total = 0.0
    stiffness, hardening = tables.stiffness, tables.hardening
    for i in range(len(stiffness)):
        d = extension(tables, i, state[i])
        if d != 0.0:
            square, k, k3 = d * d, stiffness[i], hardening[i]
            if k < 0.0:
                total += 0.25 * k3 * (square + k / k3) * (square + k / k3)
            else:
                total += square * (0.5 * k + 0.25 * k3 * square)
        elif stiffness[i] < 0.0:
            total += 0.25 * stiffness[i] * stiffness[i] / hardening[i]
    if tables.coupled:
        for i in range(len(stiffness)):
            total += 0.5 * state[i] * dot(tables.quadratic[i], state)
    return total


def gradient(tables: NetworkTables, state: Buffer, efforts: Buffer) -> None:
    """Write dH/dx at a state."""
    stiffness, hardening = tables.stiffness, tables.hardening
    for i in range(len(stiffness)):
        d = extension(tables, i, state[i])
        efforts[i] = d * (stiffness[i] + hardening[i] * d * d)
    if tables.coupled:
        for i in range(len(stiffness)):
            row = tables.quadratic[i]
            for j in range(len(stiffness)):
                efforts[i] += row[j] * state[j]


def discrete_gradient(tables: NetworkTables, state: Buffer, step: Buffer, efforts: Buffer, slopes: Buffer) -> None:
    """Write the discrete gradient between x and x + s, and its derivative by s for the scalar storages.

    Args:
        tables: The network.
        state: x, (n,).
        step: s, (n,).
        efforts: Receives e, (n,).
        slopes: Receives de_i / ds_i of the scalar storages, (n,).
    """
    stiffness, hardening = tables.stiffness, tables.hardening
    lower, upper = tables.lower, tables.upper
    for i in range(len(stiffness)):
        k, k3, s, x = stiffness[i], hardening[i], step[i], state[i]
        a, b = extension(tables, i, x), extension(tables, i, x + s)
        if lower[i] == upper[i] or a * b > 0.0:  # both ends on the same side: without cancellation
            both, squares = a + b, a * a + b * b
            efforts[i] = both * (0.5 * k + 0.25 * k3 * squares)
            slopes[i] = 0.5 * k + 0.25 * k3 * (squares + 2.0 * b * both)
        elif s != 0.0 and (a != 0.0 or b != 0.0):
            a2, b2 = a * a, b * b
            effort = (b2 * (0.5 * k + 0.25 * k3 * b2) - a2 * (0.5 * k + 0.25 * k3 * a2)) / s
            efforts[i] = effort
            slopes[i] = (b * (k + k3 * b2) - effort) / s
        else:
            efforts[i] = slopes[i] = 0.0
    if tables.coupled:
        for i in range(len(stiffness)):
            row = tables.quadratic[i]
            for j in range(len(stiffness)):
                efforts[i] += row[j] * (state[j] + 0.5 * step[j])


_Rows = Sequence[Sequence[float]]

_ROUNDING: Final = 1e-12


class Network:
    """An immutable network.

    Attributes:
        tables: The network as data; a structure that depends on the state is filled in at every sample.
        states: Number of states.
        ports: Number of ports.
        functions: Energies and structure given as functions.
    """

    def __init__(
        self,
        storages: Sequence[Storage | UserEnergy],
        dissipators: Sequence[Dissipator] = (),
        *,
        gain: _Rows,
        structure: _Rows | Callable[[Sequence[float]], _Rows] | None = None,
        origin: _Rows | None = None,
    ) -> None:
        """Make and check a network.

        Args:
            storages: Their states in this order are x.
            dissipators: Indices count states and ports from 0.
            gain: g, one row for each state, one column for each port.
            structure: J, skew, or a function of the state that returns it; None for zero.
            origin: x(0) over the ports' coordinates at the first sample, shaped as `gain`. None: states that only the
                ports move begin where `gain` puts them (a wall is where it is), all others at 0 (at rest, unstrained).

        Raises:
            ParameterError: Dimensions that do not fit, J not skew, an index out of range, a gradient that is not that
                of its energy.
        """
        self.states = n = sum(states_of(storage) for storage in storages)
        if n == 0:
            raise ParameterError("network: got no storages, expected at least one; free space needs no network")
        self.ports = len(gain[0]) if len(gain) else 0
        check_rows("gain", gain, n, self.ports)
        if self.ports == 0:
            raise ParameterError(
                "network: gain has no columns, expected one for each port; without ports no hand can touch it"
            )
        self.functions: Functions = NoFunctions()
        given = UserFunctions(storages, structure if callable(structure) else None)
        if given.exist:
            self.functions = given
        self._varies = given.structure_at is not None
        dampers = [d for each in dissipators for d in (each.elements() if isinstance(each, DampingMatrix) else [each])]
        if origin is not None:
            check_rows("origin", origin, n, self.ports)
        tables = self._tabled(list(storages), dampers, self._constant(structure), gain)
        self.tables = tables._replace(
            origin=[list(row) for row in (self._natural_origin(tables) if origin is None else origin)],
            edged=[i for i in range(n) if tables.lower[i] != tables.upper[i]],
            always=any(isinstance(storage, UserEnergy) for storage in storages) or _never_left(tables),
            by_functions=given.exist,
        )

    def _constant(self, structure: _Rows | Callable[[Sequence[float]], _Rows] | None) -> _Rows:
        """Return J, or its value at the state 0 where it is a function, after checking that it is skew."""
        n = self.states
        if callable(structure):
            chance = np.random.default_rng(0)
            for _ in range(8):
                _check_skew(structure([float(v) for v in chance.normal(size=n)]), n)
            structure = structure([0.0] * n)
        constant: _Rows = _zeros(n, n) if structure is None else structure
        _check_skew(constant, n)
        return constant

    def _natural_origin(self, tables: NetworkTables) -> _Rows:
        still = [0.0] * self.ports
        return [
            still
            if self._varies or any(tables.structure[i]) or any(row[i] != 0.0 for row in tables.on_states)
            else tables.gain[i]
            for i in range(self.states)
        ]

    def _tabled(
        self, storages: list[Storage | UserEnergy], dampers: list[Damper], structure: _Rows, gain: _Rows
    ) -> NetworkTables:
        n = self.states
        stiffness, hardening, lower, upper = [0.0] * n, [0.0] * n, [0.0] * n, [0.0] * n
        quadratic, at = _zeros(n, n), 0
        for storage in storages:
            if isinstance(storage, Spring):
                stiffness[at], hardening[at] = storage.stiffness, storage.hardening
                lower[at], upper[at] = edges(storage)
            elif isinstance(storage, DoubleWell):
                stiffness[at], hardening[at] = -storage.hardening * storage.well**2, storage.hardening
            elif isinstance(storage, Mass):
                stiffness[at] = 1.0 / storage.mass
            elif isinstance(storage, QuadraticForm):
                for i, row in enumerate(storage.matrix):
                    quadratic[at + i][at : at + len(row)] = row
            at += states_of(storage)
        skew = [[float(v) for v in row] for row in structure]
        rows = [self._rows_of(damper, skew, gain) for damper in dampers]
        return NetworkTables(
            stiffness, hardening, lower, upper,
            coupled=any(v != 0.0 for row in quadratic for v in row),
            quadratic=quadratic,
            moving=self._varies
            or any(v != 0.0 for row in skew for v in row)
            or any(v != 0.0 for on_states, _ in rows for v in on_states),
            structure=skew,
            gain=[[float(v) for v in row] for row in gain],
            on_states=[on_states for on_states, _ in rows],
            on_ports=[on_ports for _, on_ports in rows],
            viscous=[damper.viscous for damper in dampers],
            squared=[damper.squared for damper in dampers],
            coulomb=[damper.coulomb for damper in dampers],
            corner=[damper.corner for damper in dampers],
            beside=[-1 if damper.beside is None else damper.beside for damper in dampers],
            origin=[], edged=[], always=False, by_functions=False,
        )  # fmt: skip

    def _rows_of(self, damper: Damper, structure: _Rows, gain: _Rows) -> tuple[list[float], list[float]]:
        """Return the rows a and b of a damper; in parallel to a storage the rows of its flow."""
        where = damper.beside
        if where is not None:
            if not 0 <= where < self.states:
                raise ParameterError(f"dissipator: got beside {where}, expected a state from 0 to {self.states - 1}")
            if self._varies:
                raise ParameterError(
                    "dissipator: got beside with a structure that depends on the state, expected states and ports; "
                    "the flow of the storage is not known beforehand"
                )
            return list(structure[where]), list(gain[where])
        on_states, on_ports = [0.0] * self.states, [0.0] * self.ports
        for kind, entries, row in (("state", damper.states, on_states), ("port", damper.ports, on_ports)):
            for index, value in entries.items():
                if not 0 <= index < len(row) or not math.isfinite(value):
                    raise ParameterError(
                        f"dissipator: got {kind} {index} with {value!r}, expected a {kind} from 0 to {len(row) - 1} "
                        "with a finite number"
                    )
                row[index] = float(value)
        return on_states, on_ports


def _never_left(tables: NetworkTables) -> bool:
    """Return True where some storage or dissipator of the tables can be felt at every position."""
    if tables.coupled:
        return True
    acts_always = [low == high for low, high in zip(tables.lower, tables.upper, strict=True)]
    for k, k3, acts, row in zip(tables.stiffness, tables.hardening, acts_always, tables.gain, strict=True):
        if acts and (k != 0.0 or k3 != 0.0) and any(row):
            return True
    return any(
        (beside < 0 or acts_always[beside]) and any(row)
        for beside, row in zip(tables.beside, tables.on_ports, strict=True)
    )


def check_rows(name: str, rows: _Rows, count: int, length: int) -> None:
    """Check the shape of a matrix and that it is finite.

    Raises:
        ParameterError: It has another shape, or an entry that is no finite number.
    """
    if len(rows) != count or any(len(row) != length for row in rows):
        seen = f"{len(rows)} rows of {sorted({len(row) for row in rows})} entries"
        raise ParameterError(f"network: {name}: got {seen}, expected {count} rows of {length}")
    for i, row in enumerate(rows):
        for j, value in enumerate(row):
            if not math.isfinite(value):
                raise ParameterError(f"network: {name}[{i}][{j}]: got {value!r}, expected a finite number")


def _check_skew(structure: _Rows, states: int) -> None:
    """Check that a structure creates no energy.

    Raises:
        ParameterError: It is not a skew matrix of that size.
    """
    check_rows("structure", structure, states, states)
    largest = max((abs(v) for row in structure for v in row), default=0.0)
    for i in range(states):
        for j in range(i + 1):
            error = abs(structure[i][j] + structure[j][i])
            if error > _ROUNDING * largest:
                raise ParameterError(
                    f"network: structure[{i}][{j}] = {structure[i][j]:g} and structure[{j}][{i}] = "
                    f"{structure[j][i]:g}, expected J = -J'; anything else creates energy: put losses in dissipators"
                )


def _zeros(rows: int, columns: int) -> list[list[float]]:
    return [[0.0] * columns for _ in range(rows)]


__all__ = ["Damper", "DampingMatrix", "DoubleWell", "Mass", "Network", "QuadraticForm", "Spring", "UserEnergy"]
