"""The functions of `stepper.py` compiled by numba, and the machine that runs them; needs the extra `fast`.

The logic is the same source: each function of the stepper is compiled as it stands. Only the six that touch numbers in
bulk are written again here, as loops over arrays (for a dozen states a call into BLAS costs more than the product).
Matrices are stored by columns, so that the inner loop runs over rows and needs no sum to be reordered.
"""

import math
from collections.abc import Callable
from functools import cache
from types import FunctionType
from typing import Any, Final, NamedTuple, cast

import numba
import numpy as np

from canhaptic.sim.plant import stepper
from canhaptic.sim.plant.assembly import PlantModel
from canhaptic.sim.plant.hybrid_automaton import HybridAutomaton, matrix_of, reset_matrix
from canhaptic.sim.plant.mode_matrices import Mode
from canhaptic.sim.plant.propagator import LEVELS, Array
from canhaptic.sim.plant.stepper import COUNTS, LIMIT, MISSING, MODE, NONE, PRODUCTS, ModeTables

_LOGIC: Final = (
    "first_broken",
    "least",
    "may_dip",
    "leave",
    "settle",
    "judge",
    "run_free",
    "run",
    "free_holds",
    "run_holds",
)
"""Functions of the stepper, each after those that it calls."""


@cache
def _unrolled_holds(size: int, works: int) -> Callable[..., None]:
    """Returns `free_holds` for a state of `size` and some works, whose numbers are constants of the compiled code.

    So LLVM unrolls every loop over them, and the state stays in registers: a sixth of the time. A symmetric form takes
    its lower triangle, and of the shifted state only the position differs (the hand's deflection stands there).
    """

    def holds(
        flow: Array, deflection: Array, forms: Array, state: Array, totals: Array, torques: Array, positions: Array
    ) -> None:
        now, after, sums = np.empty(size), np.empty(size), np.zeros(works)
        now[:] = state
        for k in range(len(torques)):
            now[size - 2] = torques[k]
            after[:] = 0.0
            for column in range(size):
                factor = now[column]
                for row in range(size):
                    after[row] += flow[column, row] * factor
            shifted = 0.0
            for column in range(size):
                shifted += deflection[column] * now[column]
            now[0] = shifted
            for work in range(works):
                total = 0.0
                for row in range(size):
                    partial = 0.0
                    for column in range(row + 1):
                        partial += forms[work, row, column] * now[column]
                    total += partial * now[row]
                sums[work] += total
            now[:] = after
            positions[k] = now[0]
        state[:] = now
        totals += sums

    return cast(Callable[..., None], numba.njit(fastmath={"contract"})(holds))


class _FlatBooks(NamedTuple):
    """Totals and the room for one product."""

    totals: Array  # shape (works,) [J]
    rows: Array  # [y, Q y for each work], shape (n * (1 + works),)


def move(columns: Array, state: Array, moved: Array) -> None:
    """Writes the product with the state; `columns` has shape (n, n_rows)."""
    moved[:] = 0.0
    for column in range(columns.shape[0]):
        factor = state[column]
        for row in range(columns.shape[1]):
            moved[row] += columns[column, row] * factor


def evaluate(guards: Array, state: Array, values: Array) -> Array:
    """Writes and returns all rows of the guards times the state."""
    for row in range(guards.shape[0]):
        total = 0.0
        for column in range(guards.shape[1]):
            total += guards[row, column] * state[column]
        values[row] = total
    return values


def pace(values: Array, first: int) -> float:
    """Returns the length of the scaled rates of the state, the values from `first` on."""
    total = 0.0
    for row in range(first, len(values)):
        total += values[row] * values[row]
    return math.sqrt(total)


def largest_term(guards: Array, guard: int, state: Array) -> float:
    """Returns the largest term in the sum that is the value of a guard."""
    largest = 0.0
    for column in range(guards.shape[1]):
        largest = max(largest, abs(guards[guard, column] * state[column]))
    return largest


def stored(storage: Array, state: Array) -> float:
    """Returns the kinetic and elastic energy [J]."""
    total = 0.0
    for row in range(storage.shape[0]):
        for column in range(storage.shape[1]):
            total += state[row] * storage[row, column] * state[column]
    return total


def book(columns: Array, state: Array, books: Any) -> None:
    """Adds the work of a step that begins at `state` to the totals; `columns` has shape (n, n * (1 + works))."""
    [only] = books
    move(columns, state, only.rows)
    size = len(state)
    for work in range(len(only.totals)):
        total = 0.0
        first = size * (1 + work)
        for i in range(size):
            total += only.rows[first + i] * only.rows[i]
        only.totals[work] += total


_BULK: Final = (move, evaluate, pace, largest_term, stored, book)


@cache
def _compiled_stepper() -> dict[str, Callable[..., Any]]:
    """Returns the functions of the stepper by name, compiled at their first call."""
    names = dict(vars(stepper))
    for function in _BULK:
        names[function.__name__] = numba.njit(_rebound(function, names), fastmath={"contract"})
    for name in _LOGIC:
        names[name] = numba.njit(_rebound(getattr(stepper, name), names))
    return names


def _rebound(function: Any, names: dict[str, Any]) -> FunctionType:
    """Returns the same code with other global names."""
    return FunctionType(function.__code__, names, function.__name__, function.__defaults__)


class CompiledMachine(HybridAutomaton):
    """A machine whose holds, and whose whole runs, are compiled."""

    def __init__(self, scene: PlantModel, max_events: int, event_bits: int) -> None:
        functions = _compiled_stepper()
        self._run, self._free, self._holds = functions["run"], functions["run_free"], functions["run_holds"]
        self._flat: ModeTables | None = None
        self._free_modes: dict[int, tuple[Array, Array, Array]] = {}
        super().__init__(scene, max_events, event_bits)

    def _new_books(self) -> list[Any]:
        size, works = len(self.scene.names), len(self.scene.works)
        return [_FlatBooks(np.zeros(works), np.zeros(size * (1 + works)))]

    def _new_counts(self) -> Any:
        return np.zeros(COUNTS, dtype=np.int64)

    def period(self, torque: float) -> float:
        """Takes one whole sample time in one step, for scenes without guards; returns the position after it."""
        self.state[-2] = torque
        self.run_free(1 << LEVELS)
        return self.state.item(0)

    def run_free(self, ticks: int) -> None:
        """Moves by `ticks` ignoring guards."""
        self.state, self._moved = self._free(
            self._arrays(), self.state, self._moved, tuple(self._books), self._counts, ticks
        )

    def run_holds(self, torques: Array, positions: Array) -> None:
        """Takes one sample time under each torque and writes the position after it.

        A mode without guards takes them in one unrolled loop.

        Args:
            torques: Shape (n_holds,) [N or N*m].
            positions: Written, shape (n_holds,) [m or rad].

        Raises:
            EventLimitError: One of them has more events than are allowed.
        """
        if not self.mode.exits:
            size, works = len(self.state), len(self.scene.works)
            _unrolled_holds(size, works)(*self._free_tables(), self.state, self.totals, torques, positions)
            self._counts[PRODUCTS] += len(torques)
            return
        done = 0
        while done < len(torques):
            self.state, self._moved, begun, left = self._step_holds(torques[done:], positions[done:])
            done += begun
            self._most = int(self._counts[LIMIT]) - 1
            if self._counts[MISSING] != NONE:
                self._enter_missing()
                left = self._run_on(left)
                positions[done - 1] = self.state[0]
            self.check_limit(left)

    def _free_tables(self) -> tuple[Array, Array, Array]:
        """Returns the flow over T, the row of the deflection, and the forms as lower triangles, of this mode."""
        mode = int(self._counts[MODE])
        if mode not in self._free_modes:
            size, works = len(self.state), len(self.scene.works)
            stacked = matrix_of(self.mode.works[0])
            shift = stacked[works * (size + works) :]
            blocks = stacked[: works * (size + works)].reshape(works, size + works, size)[:, :size]
            forms = blocks @ (2.0 * np.eye(size) - shift)
            lower = np.tril(forms) + np.tril(forms, -1)
            self._free_modes[mode] = (matrix_of(self.mode.flows[0]).T.copy(), shift[0].copy(), lower)
        return self._free_modes[mode]

    def _step(self, ticks: int) -> tuple[Array, Array, int]:
        tables = self._arrays()
        result: tuple[Array, Array, int] = self._run(
            tables, self._settings, self.state, self._moved, tuple(self._books), self._counts, self._values, ticks
        )
        return result

    def _step_holds(self, torques: Array, positions: Array) -> tuple[Array, Array, int, int]:
        tables = self._arrays()
        result: tuple[Array, Array, int, int] = self._holds(
            tables, self._settings, self.state, self._moved, tuple(self._books), self._counts, self._values,
            torques, positions,
        )  # fmt: skip
        return result

    def _connect(self, mode: int, guard: int, target: int) -> None:
        super()._connect(mode, guard, target)
        self._flat = None

    def _add(self, mode: Mode) -> None:
        super()._add(mode)
        self._flat = None

    def _arrays(self) -> ModeTables:
        """Returns the tables as arrays, every table of one shape for all modes."""
        if self._flat is None:
            self._flat = _flat_tables(self._modes, self._tables.targets, len(self.scene.works))
            width = self._flat.guards.shape[1]
            self._values = (np.zeros(width), np.zeros(width))
        return self._flat


def _flat_tables(modes: list[Mode], targets: list[list[int]], works: int) -> ModeTables:
    """Returns the tables of the modes as arrays; guards that a mode does not have are zero.

    Args:
        modes: As compiled.
        targets: By mode and guard, the mode it leads to.
        works: Number of works.
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
        flows, forms, np.array([mode.base for mode in modes]), guards, np.array([len(mode.exits) for mode in modes]),
        slack, chord, bend, spread, target, jumps, resets, loss, np.array([mode.storage for mode in modes]),
    )  # fmt: skip


def _columns(stacked: Array, size: int, works: int) -> Array:
    """Returns [y, Q y for each work] by columns, out of the matrix of `Mode.works` for one level."""
    forms = stacked[: works * (size + works)].reshape(works, size + works, size)[:, :size]
    return np.concatenate([stacked[works * (size + works) :], *forms]).T
