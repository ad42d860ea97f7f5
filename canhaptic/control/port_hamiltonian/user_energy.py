"""Energies and structures that a user gives as functions: discrete gradient, and derivatives for Newton's method."""

from collections.abc import Callable, Sequence
from typing import Any, Final, NamedTuple, TypeAlias

import numpy as np

from canhaptic.control.port_hamiltonian.storages import UserEnergy, states_of
from canhaptic.errors import ParameterError
from canhaptic.kernels import Buffer, Matrix

StructureFunction: TypeAlias = Callable[[Sequence[float]], Sequence[Sequence[float]]]
"""J(x), skew, of the state."""

_DIFFERENCE: Final = 1e-6


class NoFunctions(NamedTuple):
    """Takes the place of `UserFunctions` where a network is its tables alone, which numba compiles."""

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
    """The user's storages of one network, each at its place in the state, and its structure; in Python only.

    Attributes:
        structure_at: J(x) as a function of the state; None where it is constant.
    """

    def __init__(self, storages: Sequence[Any], structure_at: StructureFunction | None) -> None:
        """Take the user's storages among those of a network.

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
        """Whether there are any."""
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
"""What the kernels of a network ask where `NetworkTables.by_functions`."""


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
