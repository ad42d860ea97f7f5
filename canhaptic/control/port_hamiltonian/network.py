"""A port-Hamiltonian network: storages, dissipators, structure and ports, checked on construction (section III).

    xdot = (J(x) - R(x)) e + g u,    e = dH/dx,    y = g'e + S u,    effort on the user's side = -y

    network = Network(
        storages=[Spring(stiffness=800.0), Mass(mass=0.3)],       # x = (extension, momentum)
        dissipators=[Damper(viscous=2.0, states={1: 1.0})],      # a floor under the mass
        structure=[[0.0, -1.0], [1.0, 0.0]],                     # extension' = u - v, momentum' = spring
        gain=[[1.0], [0.0]],                                     # one port pulls at the spring
    )

**Storages.** A scalar storage has the extension d = x beyond `upper`, x below `lower` and 0 between them - measured
from those edges - and stores k d^2 / 2 + k3 d^4 / 4. With lower = upper = 0 it is always engaged; a wall is engaged on
one side. With k < 0 it is a double well and stores k3 (d^2 + k / k3)^2 / 4, which differs only by a constant and is 0
in the wells. A storage may also be a quadratic form of several states, or an energy that the user gives as a function.

**Dissipators.** Each element acts on one flow f = a . e + b . u with an effort phi(f), phi(f) f >= 0. e are the efforts
of the states (that of a mass is its velocity), u the velocities of the ports. The effort acts back on the same states
and ports, so that it removes the power phi(f) f and nothing else.

**Discrete gradient** of the stored energy (Gonzalez 1996): for a storage of one state the divided difference
(H(x + s) - H(x)) / s, for a quadratic form Q (x + s / 2). Each is exact, H(x + s) - H(x) = e . s; so is their sum.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Final, Literal, NamedTuple, TypeAlias

import numpy as np
from pydantic import Field, model_validator

from canhaptic.errors import ParameterError
from canhaptic.kernels import Buffer, Indices, Matrix, zeros
from canhaptic.units import Numbers, Parameters, quantity

_Row = tuple[float, ...]


class Spring(Parameters):
    """A spring on one state: H = k d^2 / 2 + k3 d^4 / 4, d the extension beyond `lower` or `upper`.

    With lower = upper it always acts; with lower = None it is a wall above `upper`, with upper = None below `lower`.
    """

    type: Literal["spring"] = "spring"
    stiffness: Annotated[float, quantity("N/m", "N*m/rad", ge=0.0, le=1e9)]
    """Linear coefficient k."""
    hardening: Annotated[float, quantity("N/m^3", "N*m/rad^3", ge=0.0, le=1e15)] = 0.0
    """Cubic coefficient k3."""
    lower: Annotated[float, quantity("m", "rad")] | None = 0.0
    """Edge below which it acts; None: never."""
    upper: Annotated[float, quantity("m", "rad")] | None = 0.0
    """Edge above which it acts; None: never."""

    @model_validator(mode="after")
    def _edges_in_order(self) -> "Spring":
        if self.lower is not None and self.upper is not None and self.lower > self.upper:
            raise ValueError(f"got lower {self.lower:g} above upper {self.upper:g}, expected lower <= upper")
        return self


class DoubleWell(Parameters):
    """A bistable element on one state: H = k3 (x^2 - w^2)^2 / 4, wells of zero energy at -w and w."""

    type: Literal["double_well"] = "double_well"
    hardening: Annotated[float, quantity("N/m^3", "N*m/rad^3", gt=0.0, le=1e15)]
    """Cubic coefficient k3."""
    well: Annotated[float, quantity("m", "rad", gt=0.0)]
    """Distance w of the wells from 0."""


class Mass(Parameters):
    """A virtual mass; its state is the momentum p, H = p^2 / 2m, its effort the velocity."""

    type: Literal["mass"] = "mass"
    mass: Annotated[float, quantity("kg", "kg*m^2", gt=0.0)]
    """Mass m."""


class QuadraticForm(Parameters):
    """Several states with H = x'Qx / 2: anisotropic springs, coupled inertias."""

    type: Literal["quadratic_form"] = "quadratic_form"
    matrix: tuple[Numbers, ...]
    """Q, SI, symmetric and positive semidefinite."""

    @model_validator(mode="after")
    def _positive(self) -> "QuadraticForm":
        symmetric_positive(self.matrix, "matrix", "a negative energy could be extracted without limit")
        return self


@dataclass(frozen=True)
class UserEnergy:
    """A user-defined energy over `size` states, with its gradient; in Python only.

    The gradient is compared with differences of the energy when the network is made.
    """

    size: int
    energy: Callable[[Sequence[float]], float]
    """H(x) [J], never negative."""
    gradient: Callable[[Sequence[float]], Sequence[float]]
    """dH/dx, length `size`."""


Storage: TypeAlias = Annotated[Spring | DoubleWell | Mass | QuadraticForm, Field(discriminator="type")]
"""Storages that a scene can name."""


def symmetric_positive(matrix: tuple[_Row, ...], name: str, consequence: str) -> None:
    """Check that a matrix is square, symmetric and positive semidefinite.

    Raises:
        ValueError: The matrix is not so; the message names the place and the value.
    """
    size = len(matrix)
    if size == 0 or any(len(row) != size for row in matrix):
        raise ValueError(f"{name}: got rows of {[len(row) for row in matrix]} entries, expected a square matrix")
    array = np.array(matrix)
    scale = float(np.abs(array).max())
    skew = float(np.abs(array - array.T).max())
    if skew > 1e-12 * scale:
        raise ValueError(f"{name}: entries across the diagonal differ by {skew:g}, expected a symmetric matrix")
    least = float(np.linalg.eigvalsh(array)[0])
    if least < -1e-12 * scale:
        raise ValueError(f"{name}: least eigenvalue {least:g}, expected >= 0; {consequence}")


def states_of(storage: Storage | UserEnergy) -> int:
    """Return the number of states of a storage."""
    if isinstance(storage, UserEnergy):
        return storage.size
    return len(storage.matrix) if isinstance(storage, QuadraticForm) else 1


def edges(spring: Spring) -> tuple[float, float]:
    """Return (lower, upper); a missing edge is at infinity [m or rad]."""
    lower = -math.inf if spring.lower is None else spring.lower
    return lower, math.inf if spring.upper is None else spring.upper


class Damper(Parameters):
    """One element: phi(f) = r f + r2 |f| f + F_c f / sqrt(f^2 + f_c^2)."""

    type: Literal["damper"] = "damper"
    viscous: Annotated[float, quantity("N*s/m", "N*m*s/rad", ge=0.0, le=1e7)] = 0.0
    """Linear coefficient r."""
    squared: Annotated[float, quantity("N*s^2/m^2", "N*m*s^2/rad^2", ge=0.0, le=1e9)] = 0.0
    """Quadratic coefficient r2."""
    coulomb: Annotated[float, quantity("N", "N*m", ge=0.0)] = 0.0
    """Coulomb friction F_c."""
    corner: Annotated[float, quantity("m/s", "rad/s", gt=0.0)] = 1e-3
    """Flow f_c below which Coulomb friction fades, so that a sampled one does not chatter."""
    states: Mapping[int, float] = Field(default_factory=dict)
    """Row a of the damper's flow a . e + b . u: the coefficient of each state, by its index."""
    ports: Mapping[int, float] = Field(default_factory=dict)
    """Row b of the damper's flow a . e + b . u: the coefficient of each port, by its index."""
    beside: int | None = None
    """Index of a storage in parallel: the damper has its flow, and acts only while that storage is engaged."""

    @model_validator(mode="after")
    def _acts_on_something(self) -> "Damper":
        if (self.beside is None) != bool(self.states or self.ports):
            raise ValueError("got neither or both of beside and states/ports, expected one of the two")
        return self


class DampingMatrix(Parameters):
    """A viscous matrix on states or on ports: R or S of the model."""

    type: Literal["damping_matrix"] = "damping_matrix"
    matrix: tuple[Numbers, ...]
    """SI, symmetric and positive semidefinite."""
    states: tuple[int, ...] = ()
    """States to which its rows belong; give either these or `ports`."""
    ports: tuple[int, ...] = ()
    """Ports to which its rows belong; give either these or `states`."""

    @model_validator(mode="after")
    def _positive(self) -> "DampingMatrix":
        symmetric_positive(self.matrix, "matrix", "a damper that gives energy is not rendered")
        if bool(self.states) == bool(self.ports) or len(self.states or self.ports) != len(self.matrix):
            raise ValueError(
                f"got {len(self.states)} states and {len(self.ports)} ports for {len(self.matrix)} rows, expected "
                "either `states`, one for each row, or `ports`, one for each row"
            )
        if len(set(self.states)) < len(self.states) or len(set(self.ports)) < len(self.ports):
            raise ValueError(f"got states {self.states} and ports {self.ports}, expected each of them once")
        return self

    def elements(self) -> list[Damper]:
        """Return the matrix as one damper for each eigenvector."""
        values, vectors = np.linalg.eigh(np.array(self.matrix))
        where = self.states or self.ports
        found = []
        for value, vector in zip(values, vectors.T, strict=True):
            if value > 0.0:
                row = {index: float(v) for index, v in zip(where, vector, strict=True)}
                found.append(
                    Damper(viscous=float(value), states=row) if self.states else Damper(viscous=float(value), ports=row)
                )
        return found


Dissipator: TypeAlias = Annotated[Damper | DampingMatrix, Field(discriminator="type")]
"""Dissipators that a scene can name."""


StructureFunction: TypeAlias = Callable[[Sequence[float]], Sequence[Sequence[float]]]
"""Function of the state that returns J(x), skew."""

_DIFFERENCE: Final = 1e-6


class NoFunctions(NamedTuple):
    """Placeholder for `UserFunctions` in a network without user-defined functions, which numba can compile."""

    unused: int = 0  # numba passes no empty tuple

    def energy(self, state: Buffer) -> float:
        """Return 0."""
        return 0.0

    def add_gradient(self, state: Buffer, efforts: Buffer) -> None:
        """Add nothing."""

    def add_discrete_gradient(self, state: Buffer, step: Buffer, efforts: Buffer) -> None:
        """Add nothing."""

    def add_slopes(self, mobility: Matrix, jacobian: Matrix) -> None:
        """Add nothing."""

    def add_change(self, direction: Buffer, changes: Buffer) -> None:
        """Add nothing."""

    def fill_structure(self, state: Buffer, structure: Matrix) -> None:
        """Leave the structure as it is: it is constant."""


class _Placed(NamedTuple):
    first: int
    storage: UserEnergy


class UserFunctions:
    """User-defined storages of a network, each with its index in the state, and the structure function; in Python only.

    Attributes:
        structure_at: J(x) as a function of the state; None if it is constant.
    """

    def __init__(self, storages: Sequence[Any], structure_at: StructureFunction | None) -> None:
        """Check and store the user-defined storages of a network.

        Raises:
            ParameterError: A gradient does not match its energy, or an energy is below 0.
        """
        self.structure_at, first = structure_at, 0
        self._placed: list[_Placed] = []
        self._at: list[tuple[_Placed, list[float]]] = []
        for storage in storages:
            if isinstance(storage, UserEnergy):
                check_gradient(storage)
                self._placed.append(_Placed(first, storage))
            first += states_of(storage)

    @property
    def exist(self) -> bool:
        """Whether there are user-defined functions."""
        return bool(self._placed) or self.structure_at is not None

    def fill_structure(self, state: Buffer, structure: Matrix) -> None:
        """Write the skew part of J at the state, so that no function can create energy."""
        if self.structure_at is None:
            return
        found = self.structure_at(state)
        for i in range(len(structure)):
            for j in range(i + 1):
                value = 0.5 * (float(found[i][j]) - float(found[j][i]))
                structure[i][j], structure[j][i] = value, -value

    def energy(self, state: Buffer) -> float:
        """Return the energy stored [J]."""
        return sum(float(s.energy(list(state[at : at + s.size]))) for at, s in self._placed)

    def add_gradient(self, state: Buffer, efforts: Buffer) -> None:
        """Add dH/dx at the state to the efforts."""
        for at, storage in self._placed:
            for i, value in enumerate(storage.gradient(list(state[at : at + storage.size]))):
                efforts[at + i] += float(value)

    def add_discrete_gradient(self, state: Buffer, step: Buffer, efforts: Buffer) -> None:
        """Add g + (H(x + s) - H(x) - g . s) s / |s|^2 with g = dH/dx at x + s / 2 (Gonzalez 1996)."""
        self._at = []
        for placed in self._placed:
            at, storage = placed
            x, s = state[at : at + storage.size], step[at : at + storage.size]
            middle = [a + 0.5 * b for a, b in zip(x, s, strict=True)]
            found = [float(v) for v in storage.gradient(middle)]
            square = sum(b * b for b in s)
            if square > 0.0:
                after = storage.energy([a + b for a, b in zip(x, s, strict=True)])
                missing = float(after - storage.energy(list(x))) - sum(g * b for g, b in zip(found, s, strict=True))
                found = [g + missing * b / square for g, b in zip(found, s, strict=True)]
            self._at.append((placed, middle))
            for i, value in enumerate(found):
                efforts[at + i] += value

    def add_slopes(self, mobility: Matrix, jacobian: Matrix) -> None:
        """Add to a Jacobian the mobility times half the Hessian at mid-step, by finite differences of the gradient."""
        for (at, storage), middle in self._at:
            size, base = storage.size, storage.gradient(middle)
            for j in range(size):
                change = _DIFFERENCE * (abs(middle[j]) + _DIFFERENCE)
                moved = storage.gradient([v + (change if i == j else 0.0) for i, v in enumerate(middle)])
                column = [(b - a) / change for a, b in zip(base, moved, strict=True)]
                for row, slopes in zip(mobility, jacobian, strict=True):
                    slopes[at + j] += 0.5 * sum(row[at + i] * column[i] for i in range(size))

    def add_change(self, direction: Buffer, changes: Buffer) -> None:
        """Add to `changes` half the Hessian at mid-step times a direction, by one finite difference of the gradient."""
        for (at, storage), middle in self._at:
            way = list(direction[at : at + storage.size])
            length = sum(abs(d) for d in way)
            if length > 0.0:
                share = _DIFFERENCE * (sum(abs(v) for v in middle) + _DIFFERENCE) / length
                moved = storage.gradient([v + share * d for v, d in zip(middle, way, strict=True)])
                for i, (a, b) in enumerate(zip(storage.gradient(middle), moved, strict=True)):
                    changes[at + i] += 0.5 * float(b - a) / share


Functions: TypeAlias = NoFunctions | UserFunctions
"""Functions that the kernels of a network call if `NetworkTables.by_functions` is set."""


def check_gradient(storage: UserEnergy) -> None:
    """Compare a gradient with finite differences of its energy near 0.

    Raises:
        ParameterError: They differ by more than the error of the finite differences, or the energy is negative or not
            finite.
    """
    chance = np.random.default_rng(0)
    for scale in (1e-3, 1e-1):
        x = chance.normal(size=storage.size) * scale
        energy = float(storage.energy(x.tolist()))
        if not energy >= 0.0:
            raise ParameterError(f"user energy: got {energy:g} J at {x.tolist()}, expected >= 0; add a constant to it")
        found = np.array(storage.gradient(x.tolist()), dtype=float)
        if found.shape != (storage.size,):
            raise ParameterError(f"user energy: gradient has shape {found.shape}, expected ({storage.size},)")
        step = 1e-4 * scale
        expected = np.array(
            [
                (storage.energy((x + step * e).tolist()) - storage.energy((x - step * e).tolist())) / (2.0 * step)
                for e in np.eye(storage.size)
            ]
        )
        error, size = float(np.abs(found - expected).max()), float(np.abs(expected).max())
        if not error <= 1e-4 * size + 1e-9 + 1e-10 * energy / step:
            raise ParameterError(
                f"user energy: gradient {found.tolist()} at {x.tolist()}, differences of the energy give "
                f"{expected.tolist()}; give the gradient of that energy, or energy is created"
            )


class NetworkTables(NamedTuple):
    """A network as numbers: n states, r ports, d dissipators."""

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
    """A port-Hamiltonian network; immutable.

    Attributes:
        tables: The network as numbers; a structure that depends on the state is filled in at every sample.
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
            storages: Storages; their states, in this order, are x.
            dissipators: Dissipators; their indices count states and ports from 0.
            gain: g, one row for each state, one column for each port.
            structure: J, skew, or a function of the state that returns it; None for zero.
            origin: Matrix that gives x(0) from the ports' coordinates at the first sample, shaped as `gain`. None:
                `gain` for states that only the ports move (a wall keeps its place), 0 for all others (at rest,
                unstrained).

        Raises:
            ParameterError: Dimensions do not fit, J is not skew, an index is out of range, or a gradient does not match
                its energy.
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

    @property
    def has_functions(self) -> bool:
        """Whether energies or the structure are given as functions."""
        return self.tables.by_functions

    def _constant(self, structure: _Rows | Callable[[Sequence[float]], _Rows] | None) -> _Rows:
        """Return J, or its value at the state 0 if it is a function, after checking that it is skew."""
        n = self.states
        if callable(structure):
            chance = np.random.default_rng(0)
            for _ in range(8):
                _check_skew(structure([float(v) for v in chance.normal(size=n)]), n)
            structure = structure([0.0] * n)
        constant: _Rows = zeros(n, n) if structure is None else structure
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
        quadratic, at = zeros(n, n), 0
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
        """Return the rows a and b of a damper's flow, which in parallel to a storage is the flow of the storage."""
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
    """Return whether some storage or dissipator can be felt at every position."""
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
        ParameterError: The shape differs, or an entry is no finite number.
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
        ParameterError: The structure is not a skew matrix of that size.
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


def dot(row: Buffer, vector: Buffer) -> float:
    """Return the product of a row and a vector of the same length, summed from the first entry on."""
    total = 0.0
    for i in range(len(row)):
        total += row[i] * vector[i]
    return total


def solve_linear(matrix: Matrix, right: Buffer) -> bool:
    """Solve in place by elimination with row pivots; return False where the matrix is singular."""
    n = len(right)
    for column in range(n):
        pivot = column  # the row, from the diagonal down, with the largest entry
        for index in range(column + 1, n):
            if abs(matrix[index][column]) > abs(matrix[pivot][column]):
                pivot = index
        if not abs(matrix[pivot][column]) > 0.0:
            return False
        if pivot != column:
            for k in range(column, n):
                matrix[pivot][k], matrix[column][k] = matrix[column][k], matrix[pivot][k]
            right[pivot], right[column] = right[column], right[pivot]
        _eliminate(matrix, right, column)
    for back in range(n):
        index = n - 1 - back
        row, total = matrix[index], right[index]
        for k in range(index + 1, n):
            total -= row[k] * right[k]
        right[index] = total / row[index]
    return True


def _eliminate(matrix: Matrix, right: Buffer, column: int) -> None:
    """Eliminate a column from all rows below its diagonal."""
    n, above = len(right), matrix[column]
    for index in range(column + 1, n):
        row = matrix[index]
        if row[column] != 0.0:
            factor = row[column] / above[column]
            for k in range(column + 1, n):
                row[k] -= factor * above[k]
            right[index] -= factor * right[column]


def joined(networks: Sequence[Network]) -> Network:
    """Return one network that joins several networks without functions. Its states and ports are theirs, in order."""
    every = [network.tables for network in networks]
    found = object.__new__(Network)
    found.states, found.ports = sum(of.states for of in networks), sum(of.ports for of in networks)
    found.functions, found._varies = NoFunctions(), False
    firsts = [sum(of.states for of in networks[:n]) for n in range(len(networks))]
    listed = ("stiffness", "hardening", "lower", "upper", "viscous", "squared", "coulomb", "corner")
    over_states, over_ports = [of.states for of in networks], [of.ports for of in networks]
    blocks = dict.fromkeys(("quadratic", "structure", "on_states"), over_states)
    blocks |= dict.fromkeys(("gain", "on_ports", "origin"), over_ports)
    values: dict[str, Any] = {name: [v for of in every for v in getattr(of, name)] for name in listed}
    for name, columns in blocks.items():
        values[name] = _block_diagonal([getattr(of, name) for of in every], columns)
    values["beside"] = [n + first if n >= 0 else n for of, first in zip(every, firsts, strict=True) for n in of.beside]
    values["edged"] = [n + first for of, first in zip(every, firsts, strict=True) for n in of.edged]
    values |= {name: any(getattr(of, name) for of in every) for name in ("coupled", "moving", "always", "by_functions")}
    found.tables = NetworkTables(**values)
    return found


def _block_diagonal(blocks: Sequence[Matrix], columns: Sequence[int]) -> Matrix:
    """Return the rows of all blocks, each with zeros before and behind it."""
    whole = sum(columns)
    return [
        [0.0] * sum(columns[:n]) + list(row) + [0.0] * (whole - sum(columns[: n + 1]))
        for n, block in enumerate(blocks)
        for row in block
    ]
