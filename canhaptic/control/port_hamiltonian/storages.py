"""Elements of a network: storages, dissipators, and energies that a user gives as functions.

Dissipators of a network: each element acts on one flow f = a . e + b . u with an effort phi(f), phi(f) f >= 0.

e are the efforts of the states (a mass has its velocity), u the velocities of the ports. The effort acts back on the
same states and ports, so that it removes phi(f) f and nothing else, wherever it acts.

Energies and structures that a user gives as functions: discrete gradient, and derivatives for Newton's method.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Final, Literal, NamedTuple, TypeAlias

import numpy as np
from pydantic import Field, model_validator

from canhaptic.errors import ParameterError
from canhaptic.kernels import Buffer, Matrix
from canhaptic.units import Numbers, Parameters, quantity

_Row = tuple[float, ...]


class Spring(Parameters):
    """A spring on one state: H = k d^2 / 2 + k3 d^4 / 4, d the extension beyond `lower` or `upper`.

    lower = upper is a spring that always acts; lower = None is a wall above `upper`, upper = None one below `lower`.
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
"""Names that a scene can use."""


def symmetric_positive(matrix: tuple[_Row, ...], name: str, consequence: str) -> None:
    """Check that a matrix is square, symmetric and positive semidefinite.

    Raises:
        ValueError: It is not; the message names the place and the value.
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
    """a, by index of the state."""
    ports: Mapping[int, float] = Field(default_factory=dict)
    """b, by index of the port."""
    beside: int | None = None
    """Storage in parallel: the damper has that storage's flow, and acts only where the storage is engaged."""

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
    """States of its rows; either these or `ports`."""
    ports: tuple[int, ...] = ()
    """Ports of its rows; either these or `states`."""

    @model_validator(mode="after")
    def _positive(self) -> "DampingMatrix":
        symmetric_positive(self.matrix, "matrix", "a damper that gives energy is not rendered")
        if bool(self.states) == bool(self.ports) or len(self.states or self.ports) != len(self.matrix):
            raise ValueError(
                f"got {len(self.states)} states and {len(self.ports)} ports for {len(self.matrix)} rows, expected one "
                "state for each row, or one port for each row"
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
"""Names that a scene can use."""


StructureFunction: TypeAlias = Callable[[Sequence[float]], Sequence[Sequence[float]]]
"""J(x), skew, of the state."""

_DIFFERENCE: Final = 1e-6


class NoFunctions(NamedTuple):
    """Placeholder for `UserFunctions` in a network made only of tables, which numba compiles."""

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
        """No-op: the structure is constant."""


class _Placed(NamedTuple):
    first: int
    storage: UserEnergy


class UserFunctions:
    """User-defined storages of a network, each with its index in the state, and the structure function; in Python only.

    Attributes:
        structure_at: J(x) as a function of the state; None where it is constant.
    """

    def __init__(self, storages: Sequence[Any], structure_at: StructureFunction | None) -> None:
        """Take the user-defined storages of a network.

        Raises:
            ParameterError: A gradient is not that of its energy, or an energy is below 0.
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
        """Add dH/dx."""
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
        """Add mobility times half the Hessian at the middle, by differences of the gradient."""
        for (at, storage), middle in self._at:
            size, base = storage.size, storage.gradient(middle)
            for j in range(size):
                change = _DIFFERENCE * (abs(middle[j]) + _DIFFERENCE)
                moved = storage.gradient([v + (change if i == j else 0.0) for i, v in enumerate(middle)])
                column = [(b - a) / change for a, b in zip(base, moved, strict=True)]
                for row, slopes in zip(mobility, jacobian, strict=True):
                    slopes[at + j] += 0.5 * sum(row[at + i] * column[i] for i in range(size))

    def add_change(self, direction: Buffer, changes: Buffer) -> None:
        """Add half the Hessian at the middle times a direction, by one difference of the gradient."""
        for (at, storage), middle in self._at:
            way = list(direction[at : at + storage.size])
            length = sum(abs(d) for d in way)
            if length > 0.0:
                share = _DIFFERENCE * (sum(abs(v) for v in middle) + _DIFFERENCE) / length
                moved = storage.gradient([v + share * d for v, d in zip(middle, way, strict=True)])
                for i, (a, b) in enumerate(zip(storage.gradient(middle), moved, strict=True)):
                    changes[at + i] += 0.5 * float(b - a) / share


Functions: TypeAlias = NoFunctions | UserFunctions
"""Functions that the kernels of a network call where `NetworkTables.by_functions`."""


def check_gradient(storage: UserEnergy) -> None:
    """Compare a gradient with differences of its energy near 0.

    Raises:
        ParameterError: They differ by more than differences can, or the energy is negative or not finite.
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
