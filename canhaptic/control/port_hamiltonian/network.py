"""A port-Hamiltonian network: storages, dissipators, structure and ports, checked when it is made (section III).

xdot = (J(x) - R(x)) e + g u,    e = dH/dx,    y = g'e + S u,    effort on the user's side = -y

network = Network(
    storages=[Spring(stiffness=800.0), Mass(mass=0.3)],       # x = (extension, momentum)
    dissipators=[Damper(viscous=2.0, states={1: 1.0})],      # a floor under the mass
    structure=[[0.0, -1.0], [1.0, 0.0]],                     # extension' = u - v, momentum' = spring
    gain=[[1.0], [0.0]],                                     # one port pulls at the spring
)
"""

import math
from collections.abc import Callable, Sequence
from typing import Final

import numpy as np

from canhaptic.control.port_hamiltonian.discrete_gradient import NetworkTables
from canhaptic.control.port_hamiltonian.dissipators import Damper, DampingMatrix, Dissipator
from canhaptic.control.port_hamiltonian.storages import (
    DoubleWell,
    Mass,
    QuadraticForm,
    Spring,
    Storage,
    UserEnergy,
    edges,
    states_of,
)
from canhaptic.control.port_hamiltonian.user_energy import Functions, NoFunctions, UserFunctions
from canhaptic.errors import ParameterError

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
        """Return J, or that of a function at the state 0, after checking that it is skew."""
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
        """Return the rows a and b of a damper; in parallel to a storage they are those of its flow."""
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
