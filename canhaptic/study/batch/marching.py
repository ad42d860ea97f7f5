"""Runs the written forms over many scenes in chunks that fit the cache; keeps the figures of those that diverge."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any, Final, NamedTuple

import numpy as np

from canhaptic.study.batch.batch_reference import ContinuousRuns, why_not_continuous
from canhaptic.study.batch.engine import WORTH_COMPILING, ChosenEngine, Engine, chosen_engine
from canhaptic.study.batch.layout import known_values, widened
from canhaptic.study.batch.numpy_form import BLOCK, NumpyForm
from canhaptic.study.batch.program import INPUTS, BatchCase, Program, Structure, build_program
from canhaptic.study.figures import last_rows, metrics_of, sums_of
from canhaptic.study.loop import Array

CHUNK: Final = 8192
"""Scenes that are moved together: many enough that a call costs less than its numbers, few enough for the cache."""
PART: Final = 1 << 15
"""Scenes for which numbers are laid out at a time."""
_COUNTED: Final = ("diverged", "cycles", "continuous_travel", "continuous_rest", "continuous")
"""Sums that are not states: the loop over the scenes and the continuous runs know them."""
_FORCES: Final = ("continuous", "force_squares", "force_worst")
_COMPARED: Final = ("continuous_travel", "position_squares", "position_worst", *_FORCES)
"""Sums that need the continuous runs, and those that need their forces."""


class _Form(NamedTuple):
    program: Program
    run: Any
    engine: ChosenEngine


def march(case: BatchCase, scenes: int, cycles: int, engine: Engine, metrics: Sequence[str]) -> dict[str, Array]:
    """Returns metrics of many loops, each of shape (n_scenes,), in the order of the scenes and whatever the chunks.

    Args:
        case: What they have in common, and the numbers in which they differ.
        scenes: Their number.
        cycles: SYNCs, the first included.
        engine: See `run_batch`.
        metrics: Names of `METRICS`.

    Raises:
        NotBatchableError: Part of the source has no form in arrays.
    """
    names = list(metrics)
    sums = sums_of(names)
    case = replace(case, numbers={**case.numbers, "last_from": _last_from(case, cycles)})
    chosen = chosen_engine(engine, scenes * cycles >= WORTH_COMPILING)
    form = _form(case, tuple(name for name in sums if name not in _COUNTED), chosen)
    found: dict[str, Array] = {name: np.empty(scenes) for name in sums}
    size = PART if form.engine == "numba" else CHUNK
    for first in range(0, scenes, size):
        part = slice(first, min(first + size, scenes))
        count = part.stop - part.start
        numbers = {
            name: value[part] if isinstance(value, np.ndarray) else value for name, value in case.numbers.items()
        }
        continuous = _continuous(case, numbers, count, cycles, found)
        for name, values in _part(form, numbers, count, cycles, continuous).items():
            if name in found:
                found[name][part] = values
    return metrics_of(names, found)


def _last_from(case: BatchCase, cycles: int) -> Array | float:
    """Returns the SYNC with which the last part of each run begins."""
    period = np.asarray(case.numbers["loop.sample_time"], dtype=float)
    found = {value: float(last_rows(cycles, value).start) for value in np.unique(period).tolist()}
    return np.array([found[value] for value in period.tolist()]) if period.ndim else found[float(period)]


def _continuous(
    case: BatchCase, numbers: Mapping[str, Any], count: int, cycles: int, names: Iterable[str]
) -> ContinuousRuns | None:
    """Returns the continuous runs beside some scenes; None where nobody asks for them or there are none."""
    asked = {*names}
    if asked.isdisjoint(_COMPARED) or why_not_continuous(case):
        return None
    return ContinuousRuns(case, numbers, count, cycles, with_force=not asked.isdisjoint(_FORCES))


class _Fed:
    """The inputs of a part of a batch; keeps the continuous runs going although no cycle uses them."""

    def __init__(self, runs: ContinuousRuns | None, count: int, cycles: int) -> None:
        self._runs, self._count, self._left = runs, count, cycles

    def __call__(self, cycles: int) -> dict[str, Array]:
        """Returns what the next cycles are given."""
        self._left -= cycles
        if self._runs is None:
            nothing = np.full((cycles, self._count), np.nan)
            return dict.fromkeys(INPUTS, nothing)
        return dict(zip(INPUTS, self._runs.block(cycles), strict=True))

    def sums(self) -> dict[str, Array]:
        """Returns the sums of the continuous runs."""
        if self._runs is None:
            return {name: np.full(self._count, np.nan) for name in _COUNTED[2:]}
        while self._left > 0:
            self(min(BLOCK, self._left))
        return self._runs.sums()


def _part(
    form: _Form, numbers: Mapping[str, Any], count: int, cycles: int, continuous: ContinuousRuns | None
) -> dict[str, Array]:
    program, feed = form.program, _Fed(continuous, count, cycles - 1)
    if form.engine == "numba":
        states, when = form.run(numbers, count, cycles - 1, feed)
    else:
        states, when = _with_escapes(form, numbers, count, cycles - 1, feed)
    values = known_values(list(program.results.values()), numbers, states)
    sums = {name: widened(values[node], count, False) for name, node in program.results.items()}
    sums["diverged"] = np.array(when > 0, dtype=float)
    sums["cycles"] = np.where(when > 0, when + 1.0, float(cycles))
    return sums | feed.sums()


def _with_escapes(
    form: _Form, numbers: Mapping[str, Any], count: int, cycles: int, feed: _Fed
) -> tuple[dict[str, Any], Any]:
    """Returns the states at the end or when a scene diverged, and the cycle of that, 0 where it did not."""
    program = form.program
    begin = known_values(list(program.first.values()), numbers, {})
    kept: dict[str, Array] = {}
    when = np.zeros(count, dtype=np.int64)

    def escaped(out: Any, states: Mapping[str, Any], cycle: int) -> None:
        fresh = out & (when == 0)
        when[fresh] = cycle
        for name, values in states.items():
            if name not in kept:
                kept[name] = widened(values, count, program.then[name].is_truth)
            kept[name][fresh] = values[fresh] if isinstance(values, np.ndarray) else values
            if isinstance(values, np.ndarray):  # back to the start, so that nothing overflows from here on
                values[out] = widened(begin[program.first[name]], count, program.then[name].is_truth)[out]

    states = form.run(numbers, count, cycles, escaped, feed)
    if kept:
        states = {name: np.where(when > 0, kept[name], values) for name, values in states.items()}
    return states, when


def _form(case: BatchCase, sums: tuple[str, ...], engine: ChosenEngine) -> _Form:
    return _known_form(Structure(case), sums, engine)


@lru_cache(maxsize=64)
def _known_form(structure: Structure, sums: tuple[str, ...], engine: ChosenEngine) -> _Form:
    program = build_program(structure.case, sums)
    if engine == "numba":
        from canhaptic.study.batch.numba_form import NumbaForm

        return _Form(program, NumbaForm(program).run, engine)
    return _Form(program, NumpyForm(program).run, engine)
