"""Storages of a network. Each has one state or several and an energy that is never negative."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated, Literal, TypeAlias

import numpy as np
from pydantic import Field, model_validator

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
    """An energy of one's own over `size` states, with its gradient; in Python only.

    The gradient is compared with differences of the energy when the network is made.
    """

    size: int
    energy: Callable[[Sequence[float]], float]
    """H(x) [J], never negative."""
    gradient: Callable[[Sequence[float]], Sequence[float]]
    """dH/dx, length `size`."""


Storage: TypeAlias = Annotated[Spring | DoubleWell | Mass | QuadraticForm, Field(discriminator="type")]
"""What a scene can name."""


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
    """Return how many states a storage has."""
    if isinstance(storage, UserEnergy):
        return storage.size
    return len(storage.matrix) if isinstance(storage, QuadraticForm) else 1


def edges(spring: Spring) -> tuple[float, float]:
    """Return (lower, upper) with an absent edge at infinity [m or rad]."""
    lower = -math.inf if spring.lower is None else spring.lower
    return lower, math.inf if spring.upper is None else spring.upper
