"""Energies that a user gives as functions: their Gonzalez discrete gradient, and what Newton's method needs of them."""

from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np

from canhaptic.control.port_hamiltonian.storages import UserEnergy, states_of
from canhaptic.errors import ParameterError

_DIFFERENCE: Final = 1e-6


class _Placed(NamedTuple):
    first: int
    storage: UserEnergy


class UserEnergies:
    """The user's storages of one network, each at its place in the state."""

    def __init__(self, placed: Sequence[_Placed]) -> None:
        self._placed = tuple(placed)
        self._at: list[tuple[_Placed, list[float]]] = []

    @classmethod
    def of(cls, storages: Sequence[Any]) -> "UserEnergies | None":
        """Returns those among the storages of a network, checked; None where there are none.

        Raises:
            ParameterError: A gradient is not that of its energy, or an energy is below 0.
        """
        placed, first = [], 0
        for storage in storages:
            if isinstance(storage, UserEnergy):
                check_gradient(storage)
                placed.append(_Placed(first, storage))
            first += states_of(storage)
        return cls(placed) if placed else None

    def energy(self, state: Sequence[float]) -> float:
        """Returns the energy stored [J]."""
        return sum(float(s.energy(list(state[at : at + s.size]))) for at, s in self._placed)

    def add_gradient(self, state: Sequence[float], efforts: list[float]) -> None:
        """Adds dH/dx."""
        for at, storage in self._placed:
            for i, value in enumerate(storage.gradient(list(state[at : at + storage.size]))):
                efforts[at + i] += float(value)

    def add_discrete_gradient(self, state: Sequence[float], step: Sequence[float], efforts: list[float]) -> None:
        """Adds g + (H(x + s) - H(x) - g . s) s / |s|^2 with g = dH/dx at x + s / 2 (Gonzalez 1996)."""
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

    def add_slopes(self, mobility: Sequence[Sequence[float]], jacobian: list[list[float]]) -> None:
        """Adds mobility times half the Hessian at the middle, by differences of the gradient."""
        for (at, storage), middle in self._at:
            size, base = storage.size, storage.gradient(middle)
            for j in range(size):
                change = _DIFFERENCE * (abs(middle[j]) + _DIFFERENCE)
                moved = storage.gradient([v + (change if i == j else 0.0) for i, v in enumerate(middle)])
                column = [(b - a) / change for a, b in zip(base, moved, strict=True)]
                for row, slopes in zip(mobility, jacobian, strict=True):
                    slopes[at + j] += 0.5 * sum(row[at + i] * column[i] for i in range(size))

    def add_change(self, direction: Sequence[float], changes: list[float]) -> None:
        """Adds half the Hessian at the middle times a direction, by one difference of the gradient."""
        for (at, storage), middle in self._at:
            way = list(direction[at : at + storage.size])
            length = sum(abs(d) for d in way)
            if length > 0.0:
                share = _DIFFERENCE * (sum(abs(v) for v in middle) + _DIFFERENCE) / length
                moved = storage.gradient([v + share * d for v, d in zip(middle, way, strict=True)])
                for i, (a, b) in enumerate(zip(storage.gradient(middle), moved, strict=True)):
                    changes[at + i] += 0.5 * float(b - a) / share


def check_gradient(storage: UserEnergy) -> None:
    """Compares a gradient with differences of its energy near 0.

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
