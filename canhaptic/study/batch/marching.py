"""Runs many loops of one kind, in parts whose rows fit the memory; parts and engine change no figure."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np

from canhaptic.study.batch.batch_case import BatchCase, NotBatchableError
from canhaptic.study.batch.batch_reference import ContinuousRuns, why_not_continuous
from canhaptic.study.batch.engine import WORTH_COMPILING, Engine, chosen_engine
from canhaptic.study.batch.interpreted_loops import run_interpreted
from canhaptic.study.batch.rows import kernel_of, plant_arrays, scene_rows
from canhaptic.study.figures import last_rows, metrics_of, sums_of
from canhaptic.study.loop import Array

_ROWS: Final = 4e6
"""Scenes times cycles for which continuous runs are kept at a time."""
_MOST, _LEAST = 8192, 64
_OF_REFERENCE: Final = ("continuous_travel", "continuous_rest", "continuous")
_FORCES: Final = ("continuous", "force_squares", "force_worst")
_COMPARED: Final = ("continuous_travel", "position_squares", "position_worst", *_FORCES)
"""Sums that need the continuous runs, and those that need their forces."""


def march(case: BatchCase, scenes: int, cycles: int, engine: Engine, metrics: Sequence[str]) -> dict[str, Array]:
    """Returns metrics of many loops, each of shape (n_scenes,), in the order of the scenes.

    Args:
        case: What they have in common, and the numbers in which they differ.
        scenes: Their number.
        cycles: SYNCs, the first included.
        engine: See `run_batch`.
        metrics: Names of `ALL`.

    Raises:
        NotBatchableError: The algorithm is no kernel, or numba cannot compile the environment.
    """
    names = list(metrics)
    found: dict[str, Array] = {name: np.empty(scenes) for name in sums_of(names)}
    case = replace(case, numbers={**case.numbers, "last_from": _last_from(case, cycles)})
    chosen = chosen_engine(engine, scenes * cycles >= WORTH_COMPILING)
    compared = not {*found}.isdisjoint(_COMPARED)
    size = int(min(_MOST, max(_LEAST, _ROWS / cycles))) if compared else _MOST
    for first in range(0, scenes, size):
        part = slice(first, min(first + size, scenes))
        numbers = {name: v[part] if isinstance(v, np.ndarray) else v for name, v in case.numbers.items()}
        for name, values in _part(case, numbers, part.stop - first, cycles, chosen, found).items():
            if name in found:
                found[name][part] = values
    return metrics_of(names, found)


def _last_from(case: BatchCase, cycles: int) -> Array | float:
    """Returns the SYNC with which the last part of each run begins."""
    period = np.asarray(case.numbers["loop.sample_time"], dtype=float)
    found = {value: float(last_rows(cycles, value).start) for value in np.unique(period).tolist()}
    return np.array([found[value] for value in period.tolist()]) if period.ndim else found[float(period)]


def _part(
    case: BatchCase, numbers: Mapping[str, Any], count: int, cycles: int, engine: str, asked: Mapping[str, Array]
) -> dict[str, Array]:
    kernel = kernel_of(case)
    if kernel is None:
        raise NotBatchableError(f"algorithm {case.algorithm} is not written as a kernel")
    rows, (flows, starts) = list(scene_rows(case, kernel, numbers, count)), plant_arrays(case, numbers, count)
    reference = _Reference(case, numbers, count, cycles, asked, starts)
    given = rows, flows, starts, reference.positions, reference.torques, cycles
    if engine == "numba":
        from canhaptic.study.batch.compiled_loops import run_compiled

        meters = run_compiled(kernel, *given)
        sums = {name: np.array(meters[name]) for name in meters.dtype.names or ()}
    else:
        found = run_interpreted(kernel, *given)
        sums = {name: np.array([getattr(meter, name) for meter in found]) for name in type(found[0]).__slots__}
    reference.judge(sums)
    return sums


class _Reference:
    """The continuous runs of some scenes.

    Attributes:
        positions: At every SYNC, shape (count, cycles); of no columns where nothing is compared.
        torques: Mean over the hold that ended there, of the same shape.
    """

    def __init__(
        self, case: BatchCase, numbers: Mapping[str, Any], count: int, cycles: int, asked: Mapping[str, Array],
        starts: Array,
    ) -> None:  # fmt: skip
        self._count, self._runs = count, None
        names = {*asked}
        compares = not names.isdisjoint(_COMPARED)
        self.positions = self.torques = np.full((count, cycles if compares else 0), np.nan)
        if not compares or why_not_continuous(case):
            return
        self._runs = ContinuousRuns(case, numbers, count, cycles, with_force=not names.isdisjoint(_FORCES))
        position, torque = self._runs.block(cycles - 1)
        begin = np.broadcast_to(starts[:, 0], (count,)) + 0.0 * position[0]  # none without a reference
        self.positions = np.ascontiguousarray(np.concatenate([begin[None], position]).T)
        if torque.size:
            self.torques = np.ascontiguousarray(np.concatenate([0.0 * torque[:1], torque]).T)

    def judge(self, sums: dict[str, Array]) -> None:
        """Adds the sums of the continuous runs; NaN, as is what is compared with them, where a scene has none."""
        if self._runs is not None:
            sums |= self._runs.sums()
        else:
            sums |= {name: np.full(self._count, np.nan) for name in _OF_REFERENCE}
        for name in _COMPARED:
            sums[name] = np.where(np.isnan(sums["continuous_travel"]), np.nan, sums[name])
