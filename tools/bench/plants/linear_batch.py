"""Many linear plants at once and nothing else: the floor under a sweep, whose loops are in `lab.batch`.

The same flows as `Plant`, one NumPy operation per coefficient. Plants that differ in their values but not in their
states share one structure; its zeros are left out.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np

from canhaptic.errors import ParameterError
from canhaptic.sim.plant.plant import Plant
from canhaptic.sim.plant.propagator import Array

_CHUNK: Final = 4096
"""Plants that are moved together: their states then stay in the cache."""


class LinearBatch:
    """Plants without events, moved by whole sample times.

    Args:
        plants: Of the same states, before `begin`; they are read and not moved.

    Attributes:
        position: True positions, shape (n_plants,) [m or rad].
        motor_work: Work of the motors since the start, shape (n_plants,) [J].

    Raises:
        ParameterError: No plant, different states, or an effect that is not linear.
    """

    def __init__(self, plants: Sequence[Plant]) -> None:
        if not plants:
            raise ParameterError("batch: got no plant, expected at least one")
        names = plants[0].scene.names
        for i, plant in enumerate(plants):
            if plant.scene.names != names or not plant.is_linear:
                raise ParameterError(
                    f"batch: plant {i} got states {', '.join(plant.state_names)}, expected a linear plant with "
                    f"{', '.join(names)}; run scenes with events or other states on their own"
                )
        flows = np.array([plant.whole_flow() for plant in plants])  # (n_plants, n, n)
        self.position = np.array([plant.position for plant in plants])
        self.motor_work = np.zeros(len(plants))
        self._chunks = []
        for first in range(0, len(plants), _CHUNK):
            part = slice(first, min(first + _CHUNK, len(plants)))
            state = np.ascontiguousarray(np.array([plant.scene.initial_state() for plant in plants[part]]).T)
            self._chunks.append(_Chunk(part, flows[part], state))

    def advance(self, torques: Array) -> Array:
        """Moves every plant by one sample time and returns the positions.

        Args:
            torques: Held during it, shape (n_plants,) [N or N*m].
        """
        for chunk in self._chunks:
            held = torques[chunk.part]
            before = self.position[chunk.part]
            after = chunk.advance(held)
            self.motor_work[chunk.part] += held * (after - before)
            self.position[chunk.part] = after
        return self.position


class _Chunk:
    """Plants that fit the cache together."""

    def __init__(self, part: slice, flows: Array, state: Array) -> None:
        self.part = part
        self._state, self._moved = state, state.copy()
        self._product = np.empty(state.shape[1])
        self._torque = len(state) - 2
        self._terms = []  # (row, columns with their coefficients), rows that never change left out
        for row in range(len(state) - 2):
            columns = [c for c in range(len(state)) if np.any(flows[:, row, c])]
            self._terms.append((row, [(c, np.ascontiguousarray(flows[:, row, c])) for c in columns]))

    def advance(self, torques: Array) -> Array:
        """Returns the positions after one sample time."""
        state, moved, product = self._state, self._moved, self._product
        state[self._torque] = torques
        for row, columns in self._terms:
            total = moved[row]
            total.fill(0.0)
            for column, coefficients in columns:
                np.multiply(coefficients, state[column], out=product)
                total += product
        moved[-1] = 1.0
        self._state, self._moved = moved, state
        position: Array = moved[0]
        return position
