"""The functions of `stepper.py` compiled by numba, and the machine that runs them; needs the extra `fast`.

The logic is the same source: each function of the stepper is compiled unchanged. Only the six that process numbers in
bulk are replaced by loops over arrays (`mode_arrays`): for a dozen states a call into BLAS costs more than the product.
"""

from functools import cache
from typing import Any, Final

import numpy as np

from canhaptic.kernels.compiler import compiled
from canhaptic.sim.plant import stepper
from canhaptic.sim.plant.accuracy_parameters import LEVELS
from canhaptic.sim.plant.assembly import Mode, PlantModel
from canhaptic.sim.plant.hybrid_automaton import HybridAutomaton
from canhaptic.sim.plant.mode_arrays import Books, book, evaluate, flat_tables, largest_term, move, pace, stored
from canhaptic.sim.plant.propagator import Array
from canhaptic.sim.plant.stepper import COUNTS, ModeTables

_BULK: Final = (move, evaluate, pace, largest_term, stored, book)


@cache
def _compiled_stepper(name: str) -> Any:
    """Return a function of the stepper, compiled at its first call; the machine code is kept for the next process."""
    products = {getattr(stepper, function.__name__): function for function in _BULK}
    return compiled(getattr(stepper, name), products, keep=True)


class CompiledMachine(HybridAutomaton):
    """An automaton whose holds are compiled."""

    def __init__(self, scene: PlantModel, max_events: int, event_bits: int) -> None:
        self._run, self._free = map(_compiled_stepper, ("run", "run_free"))
        self._flat: ModeTables | None = None
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

    def _step(self, ticks: int) -> tuple[Array, Array, int]:
        tables = self._arrays()
        result: tuple[Array, Array, int] = self._run(
            tables, self._settings, self.state, self._moved, tuple(self._books), self._counts, self._values, ticks
        )
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
