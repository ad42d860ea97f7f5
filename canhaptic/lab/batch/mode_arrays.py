"""Modes of a plant as arrays of one shape, and the stepper's matrix products as plain loops over them.

The loops take lists or arrays and add in a fixed order, so that Python and machine code give the same bits. The plant
of a run (`Plant`) uses NumPy's products, which add in another order: it differs by rounding, less than 1e-9 of the
travel where the motion is not chaotic. Matrices are stored by columns, so that the inner loop runs over rows and no sum
is reordered.
"""

from collections.abc import Sequence
from math import sqrt
from typing import Any, NamedTuple

import numpy as np

from canhaptic.kernels import Buffer
from canhaptic.sim.plant import LEVELS
from canhaptic.sim.plant.assembly import Mode
from canhaptic.sim.plant.hybrid_automaton import matrix_of, reset_matrix
from canhaptic.sim.plant.stepper import NONE, ModeTables

Matrix = Sequence[Sequence[float]]


class Books(NamedTuple):
    """Accumulated works, and a buffer for one product."""

    totals: Any  # shape (works,) [J]
    rows: Any  # [y, Q y for each work], shape (n * (1 + works),)


def move(columns: Matrix, state: Buffer, moved: Buffer) -> None:
    """Write the matrix, given by its columns, times the state into `moved`; `columns` has shape (n, n_rows)."""
    for row in range(len(moved)):
        moved[row] = 0.0
    for column in range(len(columns)):
        factors, factor = columns[column], state[column]
        for row in range(len(moved)):
            moved[row] += factors[row] * factor


def evaluate(guards: Matrix, state: Buffer, values: Buffer) -> Buffer:
    """Write the matrix, given by its rows, times the state into `values`, and return it."""
    size = len(state)
    for row in range(len(guards)):
        factors, total = guards[row], 0.0
        for column in range(size):
            total += factors[column] * state[column]
        values[row] = total
    return values


def pace(values: Buffer, first: int) -> float:
    """Return the Euclidean norm of the values from index `first` on: the scaled rates of the state."""
    total = 0.0
    for row in range(first, len(values)):
        total += values[row] * values[row]
    return sqrt(total)


def largest_term(guards: Matrix, guard: int, state: Buffer) -> float:
    """Return the largest |term| of the sum that is the value of a guard."""
    largest = 0.0
    for column in range(len(state)):
        largest = max(largest, abs(guards[guard][column] * state[column]))
    return largest


def stored(storage: Matrix, state: Buffer) -> float:
    """Return the kinetic and elastic energy [J]."""
    total = 0.0
    for row in range(len(storage)):
        for column in range(len(storage)):
            total += state[row] * storage[row][column] * state[column]
    return total


def flat_tables(modes: Sequence[Mode], targets: Sequence[Sequence[int]], works: int) -> ModeTables:
    """Return the modes as arrays of one shape; a mode with fewer guards than others is padded with zeros.

    Args:
        modes: Modes of the plant.
        targets: For each mode and guard, the mode that the guard leads to.
        works: Number of accumulated works.
    """
    size, count = len(modes[0].storage), max(len(mode.exits) for mode in modes)
    guards = np.zeros((len(modes), 2 * count + size, size))
    slack = np.zeros((len(modes), LEVELS + 1, count))
    chord, spread = np.zeros((2, len(modes), LEVELS + 1, count, size))
    bend = np.zeros((len(modes), count, size))
    target, loss = np.full((len(modes), count), NONE), np.zeros((len(modes), count), dtype=np.int64)
    jumps, resets = np.zeros((len(modes), count), dtype=bool), np.zeros((len(modes), count, size, size))
    for i, mode in enumerate(modes):
        guards[i, : len(mode.guards)] = mode.guards
        exits, rates = mode.bounds.bend.shape
        slack[i, :, :exits], bend[i, :exits, :rates] = mode.bounds.slack, mode.bounds.bend
        chord[i, :, :exits, :rates], spread[i, :, :exits, :rates] = mode.bounds.chord, mode.bounds.spread
        for j, leaving in enumerate(mode.exits):
            target[i, j], loss[i, j], jumps[i, j] = targets[i][j], leaving.work, bool(leaving.resets)
            resets[i, j] = reset_matrix(leaving, size).T
    flows = np.array([[matrix_of(flow).T for flow in mode.flows] for mode in modes])
    forms = np.array([[_columns(matrix_of(work), size, works) for work in mode.works] for mode in modes])
    return ModeTables(
        flows, forms, guards, np.array([len(mode.exits) for mode in modes]),
        slack, chord, bend, spread, target, jumps, resets, loss, np.array([mode.storage for mode in modes]),
    )  # fmt: skip


def _columns(stacked: Any, size: int, works: int) -> Any:
    """Return the columns of [y, Q y for each work], from the matrix of `Mode.works` for one level."""
    forms = stacked[: works * (size + works)].reshape(works, size + works, size)[:, :size]
    return np.concatenate([stacked[works * (size + works) :], *forms]).T
