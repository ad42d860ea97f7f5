"""Loops of a batch run by Python, one after the other: where numba is missing, and as reference for compiled ones."""

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any

from canhaptic.kernels import Kernel, Run, list_of_zeros
from canhaptic.kernels.binding import bound
from canhaptic.lab.batch.batch_reference import ContinuousModes
from canhaptic.lab.batch.closed_loop import MOVED, Interruption, begin_plant, plant_at, run_loop, step
from canhaptic.lab.batch.event_plants import Interrupted, Plants
from canhaptic.lab.batch.meter import Meter
from canhaptic.lab.batch.reference_kernel import TERMS, ReferenceMemory, ReferenceState
from canhaptic.lab.batch.rows import SceneRow


class InterpretedLoops:
    """One loop after the other.

    Args:
        kernel: Kernel of the algorithm.
        rows: Rows of the scenes.
        modes: Modes of the continuous environments.
        cycles: SYNCs.
        instead: Replacements of functions of the loop.

    Attributes:
        meters: Meter of every scene.
        references: Memory of its continuous run.
    """

    def __init__(
        self,
        kernel: Kernel,
        rows: Sequence[SceneRow],
        modes: ContinuousModes,
        cycles: int,
        instead: Mapping[object, object],
    ) -> None:
        self._kernel, self._rows, self._modes, self._cycles = kernel, rows, modes, cycles
        self._begin, self._at, self._run = _functions(kernel, tuple(instead.items()))
        self.meters = [Meter() for _ in rows]
        self.references = [ReferenceState() for _ in rows]

    def run(self, some: Sequence[int], plants: Plants, interrupted: Interrupted) -> None:
        """Run some of the scenes.

        Args:
            some: Numbers of the scenes.
            plants: Plants of the scenes.
            interrupted: (plants, number of a scene, its state, reason) -> plants to continue with; None ends that
                scene.
        """
        for number, i in enumerate(some):
            row, kernel = self._rows[i], self._kernel
            place = Interruption(temperature=row.loop.signals.winding.ambient)
            run = Run(row.settings, kernel.state(), kernel.memory(row.settings, list_of_zeros))
            reference = reference_memory_of(self._modes, i)
            self._begin(plants, number)
            while True:
                outcome = self._run(
                    row.environment, run, row.loop, self.meters[i], self._at(plants, number), place,
                    self._modes.settings[i], self.references[i], reference, self._cycles,
                )  # fmt: skip
                if outcome == MOVED:
                    break
                went_on = interrupted(plants, i, place, outcome)
                if went_on is None:
                    break
                plants = went_on


@lru_cache(maxsize=64)
def _functions(kernel: Kernel, instead: tuple[tuple[object, object], ...]) -> tuple[Any, Any, Any]:
    replaced = {**dict(instead), step: kernel.step}
    begin, at = (replaced.get(function, function) for function in (begin_plant, plant_at))
    return begin, at, bound(run_loop, replaced)


def reference_memory_of(modes: ContinuousModes, row: int) -> ReferenceMemory:
    """Return the matrices and buffers of one scene as lists."""
    flows, rates, starts = (values[row % len(values)].tolist() for values in modes[1:])
    return ReferenceMemory(flows, rates, starts, list(starts), [[0.0] * len(starts) for _ in range(TERMS)])
