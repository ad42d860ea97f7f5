"""The functions of `stepper.py` compiled by numba, and the machine that runs them; needs the extra `fast`.

The logic is the same source: each function of the stepper is compiled unchanged. Only the six that process numbers in
bulk are replaced by loops over arrays (`mode_arrays`): for a dozen states a call into BLAS costs more than the product.
"""

from collections.abc import Callable
from functools import cache
from typing import Any, Final, cast

import numba
import numpy as np

from canhaptic.kernels.compiler import compiled
from canhaptic.sim.plant import stepper
from canhaptic.sim.plant.accuracy_parameters import LEVELS
from canhaptic.sim.plant.assembly import Mode, PlantModel
from canhaptic.sim.plant.hybrid_automaton import HybridAutomaton, matrix_of
from canhaptic.sim.plant.mode_arrays import Books, book, evaluate, flat_tables, largest_term, move, pace, stored
from canhaptic.sim.plant.propagator import Array
from canhaptic.sim.plant.stepper import COUNTS, LIMIT, MISSING, MODE, NONE, PRODUCTS, ModeTables

_BULK: Final = (move, evaluate, pace, largest_term, stored, book)


@cache
def _unrolled_holds(size: int, works: int) -> Callable[..., None]:
    """Function that takes sample times in a mode without guards; sizes of state and works are constants of its code.

    So LLVM unrolls every loop over them, and the state stays in registers: a sixth of the time. A symmetric form takes
    its lower triangle, and of the shifted state only the position differs (it holds the hand's deflection).
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

    return cast(Callable[..., None], numba.njit(holds))


@cache
def _compiled_stepper(name: str) -> Any:
    """Return a function of the stepper, compiled at its first call; the machine code is kept for the next process."""
    products = {getattr(stepper, function.__name__): function for function in _BULK}
    return compiled(getattr(stepper, name), products, keep=True)


class CompiledMachine(HybridAutomaton):
    """An automaton whose holds, and whose whole runs, are compiled."""

    def __init__(self, scene: PlantModel, max_events: int, event_bits: int) -> None:
        self._run, self._free, self._holds = map(_compiled_stepper, ("run", "run_free", "run_holds"))
        self._flat: ModeTables | None = None
        self._free_modes: dict[int, tuple[Array, Array, Array]] = {}
        super().__init__(scene, max_events, event_bits)

    def _new_books(self) -> list[Any]:
        size, works = len(self.scene.names), len(self.scene.works)
        return [Books(np.zeros(works), np.zeros(size * (1 + works)))]

    def _new_counts(self) -> Any:
        return np.zeros(COUNTS, dtype=np.int64)

    def period(self, torque: float) -> float:
        """Take one whole sample time in one step, for scenes without guards; return the position after it."""
        self.state[-2] = torque
        self.run_free(1 << LEVELS)
        return self.state.item(0)

    def run_free(self, ticks: int) -> None:
        """Move by `ticks` ignoring guards."""
        self.state, self._moved = self._free(
            self._arrays(), self.state, self._moved, tuple(self._books), self._counts, ticks
        )

    def run_holds(self, torques: Array, positions: Array) -> None:
        """Take one sample time under each torque and write the position after it.

        A mode without guards takes them in one unrolled loop.

        Args:
            torques: Shape (n_holds,) [N or N*m].
            positions: Receives the positions, shape (n_holds,) [m or rad].

        Raises:
            EventLimitError: One of them has more events than allowed.
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
            self._require_finished(left)
            self.check_limit(left)

    def _free_tables(self) -> tuple[Array, Array, Array]:
        """Return the flow over T, the row of the deflection, and the forms as lower triangles, of this mode."""
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

    def connect(self, mode: int, guard: int) -> None:
        """Compile the mode behind a guard of a mode, and put it into the tables."""
        super().connect(mode, guard)
        self._flat = None

    def _add(self, mode: Mode) -> None:
        super()._add(mode)
        self._flat = None

    def _arrays(self) -> ModeTables:
        """Return the tables as arrays, every table of one shape for all modes."""
        if self._flat is None:
            self._flat = flat_tables(self.modes, self.targets, len(self.scene.works))
            width = self._flat.guards.shape[1]
            self._values = (np.zeros(width), np.zeros(width))
        return self._flat
