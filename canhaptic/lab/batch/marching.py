"""Run a batch of loops and return its figures; neither the engine nor the size of the parts changes a figure.

`InterpretedLoops` runs the loops in Python, where numba is missing and as the reference for compiled loops.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any, Final

import numpy as np

from canhaptic.errors import EventLimitError, ParameterError
from canhaptic.kernels import Kernel, Run, list_of_zeros
from canhaptic.kernels.records import bound
from canhaptic.lab.batch import WORTH_COMPILING, Engine, cases, chosen_engine, closed_loop
from canhaptic.lab.batch.cases import NotBatchableError
from canhaptic.lab.batch.plants import Plants, Stopped, loop_replacements, never_stopped, run_event_plants
from canhaptic.lab.batch.varied import scene_with
from canhaptic.lab.figures.figures import ALL, METRICS, last_rows, metrics_of, sums_of
from canhaptic.lab.figures.meter import BRIEF, Meter
from canhaptic.lab.loop.axis_loop import Array
from canhaptic.scene.models import Scene


class InterpretedLoops:
    """Runs loops one after the other, in Python.

    Attributes:
        meters: Meter of each scene.
        references: State of each scene's continuous run.
    """

    def __init__(self, job: cases.LoopJob) -> None:
        self._kernel, self._rows, self._modes, self._cycles, instead = job
        self._begin, self._at, self._run = _functions(self._kernel, tuple(instead.items()))
        self.meters = [Meter() for _ in self._rows]
        self.references = [closed_loop.ReferenceState() for _ in self._rows]

    def run(self, some: Sequence[int], plants: Plants, stopped: Stopped) -> None:
        """Run the loops of the given scenes; `meters` then holds their sums.

        Args:
            some: Indices of the scenes.
            plants: Plants of the scenes.
            stopped: Called for each plant that cannot be advanced: (plants, index of the scene, SYNC it cannot reach).
        """
        for number, i in enumerate(some):
            row, kernel = self._rows[i], self._kernel
            place = closed_loop.CycleState(temperature=row.loop.signals.winding.ambient)
            run = Run(row.settings, kernel.state(), kernel.memory(row.settings, list_of_zeros))
            reference = reference_memory_of(self._modes, i)
            self._begin(plants, number)
            if not self._run(
                row.environment, run, row.loop, self.meters[i], self._at(plants, number), place,
                self._modes.settings[i], self.references[i], reference, self._cycles,
            ):  # fmt: skip
                stopped(plants, i, place.cycle)


@lru_cache(maxsize=64)
def _functions(kernel: Kernel, instead: tuple[tuple[object, object], ...]) -> tuple[Any, Any, Any]:
    replaced = {**dict(instead), closed_loop.step: kernel.step}
    begin, at = (replaced.get(function, function) for function in (closed_loop.begin_plant, closed_loop.plant_at))
    return begin, at, bound(closed_loop.run_loop, replaced)


def reference_memory_of(modes: cases.ContinuousModes, row: int) -> closed_loop.ReferenceMemory:
    """Return the matrices and buffers of one scene's continuous run, as lists."""
    flows, rates, starts = (values[row % len(values)].tolist() for values in modes[1:])
    return closed_loop.ReferenceMemory(
        flows, rates, starts, list(starts), [[0.0] * len(starts) for _ in range(closed_loop.TERMS)]
    )


_MOST: Final = 8192
"""Scenes that are laid out in memory at a time."""
_FORCES: Final = ("continuous", "force_squares", "force_worst")
_TRAVELS: Final = ("continuous_travel", "continuous_rest")
_COMPARED: Final = (*_TRAVELS, "position_squares", "position_worst", *_FORCES)
"""Sums that need a continuous run; `_FORCES` need its force as well, `_TRAVELS` its travel."""


def march(
    case: cases.BatchCase,
    scenes: int,
    cycles: int,
    engine: Engine,
    metrics: Sequence[str],
    stopped: dict[int, str] | None = None,
) -> dict[str, Array]:
    """Run many loops; return each metric with shape (n_scenes,), in the order of the scenes.

    Args:
        case: Common part of the loops, and the numbers in which they differ.
        scenes: Number of scenes.
        cycles: Number of SYNCs of a run, the first included.
        engine: See `run_batch`.
        metrics: Names of `ALL`.
        stopped: Filled with the reason for each scene whose plant could not be advanced; its metrics are NaN.

    Raises:
        NotBatchableError: The algorithm is not written as a kernel, or numba cannot compile the environment.
    """
    names = list(metrics)
    failed: dict[int, str] = {}
    found: dict[str, Array] = {name: np.empty(scenes) for name in sums_of(names)}
    brief = float(BRIEF.union(_COMPARED).issuperset(found))
    period = np.asarray(case.number("loop", "sample_time"), dtype=float)
    last_from = np.vectorize(lambda time: float(last_rows(cycles, time).start), otypes=[float])(period)[()]
    case = replace(case, numbers={**case.numbers, "last_from": last_from, "is_brief": brief})
    chosen = chosen_engine(engine, scenes * cycles >= WORTH_COMPILING)
    for first in range(0, scenes, _MOST):
        part = slice(first, min(first + _MOST, scenes))
        ended: dict[int, EventLimitError] = {}
        for name, values in _part(case.part(part), part.stop - first, cycles, chosen, found, ended).items():
            if name in found:
                found[name][part] = values
        for row, error in ended.items():
            failed[first + row] = str(error).splitlines()[0]
    metrics_found = metrics_of(names, found)
    for values in metrics_found.values():
        values[list(failed)] = np.nan
    if stopped is not None:
        stopped |= failed
    return metrics_found


def _part(
    case: cases.BatchCase, count: int, cycles: int, engine: str, asked: Mapping[str, Array],
    stopped: dict[int, EventLimitError],
) -> dict[str, Array]:  # fmt: skip
    kernel = cases.kernel_of(case.common.algorithm)
    if kernel is None:
        raise NotBatchableError(f"algorithm {case.common.algorithm} is not written as a kernel")
    modes = cases.no_modes(count)
    if not {*asked}.isdisjoint(_COMPARED) and not cases.why_not_continuous(case):
        forces, travels = (not {*asked}.isdisjoint(some) for some in (_FORCES, _TRAVELS))
        modes = cases.continuous_modes(case, count, cycles, with_force=forces, with_travel=travels)
    listed = engine == "python"
    rows = list(cases.scene_rows(case, kernel, count))
    job = cases.LoopJob(kernel, rows, modes, cycles, loop_replacements(case.plants))
    if listed:
        loops: Any = InterpretedLoops(job)
    else:
        from canhaptic.lab.batch.compiled_loops import CompiledLoops

        loops = CompiledLoops(job)
    if case.linear is None:
        run_event_plants(loops, case.plants, np.broadcast_to(case.numbers["plant"], (count,)), stopped, listed=listed)
    else:
        loops.run(range(count), cases.linear_plants(case.linear, listed=listed), never_stopped)
    sums, runs = _columns(loops.meters), _columns(loops.references)
    compared = {
        **{name: sums[name] for name in _COMPARED if name in sums},
        "continuous_travel": runs["highest"] - runs["lowest"],
        "continuous_rest": runs["last_highest"] - runs["last_lowest"],
        "continuous": runs["variation"],
    }
    return sums | {name: np.where(modes.exist, values, np.nan) for name, values in compared.items()}


def _columns(found: Any) -> dict[str, Array]:
    if isinstance(found, np.ndarray):
        return {name: np.array(found[name]) for name in found.dtype.names or ()}
    return {name: np.array([getattr(one, name) for one in found]) for name in type(found[0]).__slots__}


def run_batch(
    scene: Scene,
    varied: Mapping[str, Array],
    cycles: int,
    engine: Engine = "auto",
    metrics: Sequence[str] | None = None,
    *,
    seeds: Array | None = None,
    stopped: dict[int, str] | None = None,
) -> Mapping[str, Array]:
    """Run many scenes of one axis; return each figure with shape (n_scenes,).

    Args:
        scene: Common part of the scenes; `why_not_batchable(scene)` must be "".
        varied: Key of `BATCH_KEYS` -> value of each scene, shape (n_scenes,), in SI.
        cycles: Number of SYNCs, at least 2.
        engine: "numba" needs the extra `fast`; "auto" takes it where it is installed and saves time, else "python".
        metrics: Names of `ALL`; None for `METRICS`. Those of `CONTINUOUS` also compute a continuous run for each scene,
            and are NaN where that has no closed form.
        seeds: Seed of the random numbers of each scene, shape (n_scenes,); by default the scene's seed.
        stopped: Filled with the reason for each scene whose plant could not be advanced; its figures are NaN.

    Raises:
        ParameterError: A key cannot vary inside a batch, a value is out of its range, or a metric is unknown.
        NotBatchableError: The scene cannot run in a batch.
    """
    names = list(METRICS) if metrics is None else list(metrics)
    unknown = [name for name in names if name not in ALL]
    if unknown or cycles < 2:
        raise ParameterError(f"run_batch: got metrics {unknown} and {cycles} cycles; expected {list(ALL)}, 2 or more")
    arrays = {key: np.asarray(values, dtype=float) for key, values in varied.items()}
    reason = cases.why_not_beforehand(scene)
    if reason:
        raise NotBatchableError(f"{scene.source}: {reason}; run such scenes one by one with run_scalar")
    count = cases.check_values(scene, arrays)
    found = {name: np.empty(count) for name in names}
    delays = arrays.pop("loop.delay", None)
    for delay in [None] if delays is None else sorted({*delays.tolist()}):
        rows = np.arange(count) if delays is None else np.flatnonzero(delays == delay)
        of_delay = scene if delay is None else scene_with(scene, {"loop.delay": delay})
        case = cases.batch_case(of_delay, {key: np.ascontiguousarray(values[rows]) for key, values in arrays.items()})
        if seeds is not None:
            case = replace(case, numbers={**case.numbers, "seed": seeds[rows].astype(float)})
        ended: dict[int, str] = {}
        for name, values in march(case, len(rows), cycles, engine, names, ended).items():
            found[name][rows] = values
        if stopped is not None:
            stopped |= {int(rows[row]): reason for row, reason in ended.items()}
    return found
