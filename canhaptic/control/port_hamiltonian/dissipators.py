"""Dissipators of a network: each element acts on one flow f = a . e + b . u with an effort phi(f), phi(f) f >= 0.

e are the efforts of the states (a mass has its velocity), u the velocities of the ports. The effort acts back on the
same states and ports, so that it takes out phi(f) f and nothing else, wherever it sits.
"""

from collections.abc import Mapping
from typing import Annotated, Literal, TypeAlias

import numpy as np
from pydantic import Field, model_validator

from canhaptic.control.port_hamiltonian.storages import symmetric_positive
from canhaptic.units import Numbers, Parameters, quantity


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
"""What a scene can name."""
