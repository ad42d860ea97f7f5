"""Run a sweep: send chunks of scenes to workers, and store each result when it is ready.

The result of a scene depends only on its values and its global index, so that one thread, a pool and a cluster write
the same bits; only the order in which chunks become ready differs.

Where the loop of the scenes is new, `FirstUse` lets Python run the first ones, and compiles where that saves time.
"""

import json
import math
import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import ExitStack
from dataclasses import asdict, replace
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from canhaptic.drive.clock import WallClock
from canhaptic.drive.profile.causality import IMPEDANCE
from canhaptic.errors import InputError
from canhaptic.lab.batch import (
    WORTH_COMPILING,
    WORTH_COMPILING_EVENTS,
    WORTH_COMPILING_GROUPS,
    Engine,
    chosen_engine,
    why_no_numba,
    without_numba,
)
from canhaptic.lab.batch.cases import why_not_batchable
from canhaptic.lab.batch.network_loop import network_loop
from canhaptic.lab.loop.axis_loop import cycles_of, parts_of, with_algorithm
from canhaptic.lab.studies import Row
from canhaptic.lab.studies.chunk import (
    FIGURES,
    RATE,
    ChunkResult,
    Recipe,
    is_batch_key,
    make_recipe,
    row_of,
    run_chunk,
    scene_of,
    usual_figures,
)
from canhaptic.lab.studies.runner import Count, Job, Progress, pool_of, run_jobs
from canhaptic.lab.studies.store import SweepTable, create
from canhaptic.lab.studies.vary import Column, Points, Varied, make_points, parse_vary, short
from canhaptic.quantities import figure_name
from canhaptic.scene.far_side import build_plant
from canhaptic.scene.method import plant_errors
from canhaptic.scene.models import Scene

OPTIONS: Final = {
    "controllers": "names", "metrics": "names", "duration": "seconds",
    "cycles": "int", "engine": "word", "chunk": "int", "beyond_bus": "word", "resume": "word", "force": "word",
}  # fmt: skip
"""Option of a sweep, of the command as in Python -> reader of its text."""
_BATCH_CHUNK: Final = (1000, 5000)
"""Default range of the scenes in a chunk: with fewer, making the batch costs more than running it."""
_SCALAR_CHUNK: Final = (1, 50)
_CYCLES_IN_PYTHON: Final = 100_000
"""Largest number of cycles of a default chunk in Python, which takes some seconds for them."""
_WORTH_A_POOL: Final = 1e6
"""Scenes times cycles in Python from which a pool of processes saves time: some 10 s on one core."""
_MOST_PLANTS: Final = 6
"""Largest number of values of a plant's key for which the simulation error is estimated."""
_FEWEST_CHUNKS: Final = 16
_FEWEST_TOGETHER: Final = 8
"""Fewest scenes of a batch: below, making it costs more than running the scenes one by one."""


class Asked(NamedTuple):
    """A sweep ready to be started or continued."""

    recipe: Recipe
    points: Points
    chunk: int
    identity: Row
    is_auto: bool  # whether the engine was chosen here
    is_slow: bool  # whether Python computes only because numba is not installed


def sweep(
    scene: Scene,
    vary: Sequence[str | Varied],
    out: str | Path,
    executor: Executor | None = None,
    *,
    resume: bool = False,
    force: bool = False,
    in_flight: int = 4,
    processes: bool = False,
    progress: Callable[[Progress], None] = lambda _: None,
    note: Callable[[str], None] = lambda _: None,
    stop_requested: Callable[[], bool] = lambda: False,
    **options: Any,
) -> Progress:
    """Run every scene and store the figures in a folder; a stopped or killed sweep can be resumed.

    Args:
        scene: Scene with simulated drives, from a file or text.
        vary: Varied keys, as for `--vary`.
        out: Folder of the results.
        executor: A `concurrent.futures.Executor`, or a `Pool`; None: in this thread.
        resume: Whether to continue in an existing folder; a missing folder is created.
        force: Whether to replace the results of an existing folder.
        in_flight: Largest number of chunks submitted to an executor and not yet stored; ignored for a `Pool`.
        processes: Whether processes may be started if no executor is given, one on each core for a long sweep in
            Python.
        progress: Called regularly with the progress.
        note: Called before the first scene with a line on what makes the sweep slow, if there is such a thing.
        stop_requested: Polled regularly; True ends the sweep after the submitted chunks.
        options: As for `make_sweep`.

    Raises:
        InputError: Bad input, or a folder of another sweep.
        LogWriteError: The folder cannot be written.
        WorkersLostError: The workers die again and again.
    """
    asked, path = make_sweep(scene, vary, **options), Path(out)
    if asked.is_slow:
        note(without_numba())
    if not (resume and path.exists()):
        create(path, asked.chunk, asked.identity, _notes(scene, asked), replace=force)
    cores, run = os.cpu_count() or 1, run_chunk
    with ExitStack() as stack:
        table = stack.enter_context(SweepTable(path, writable=True))
        _check_same(table, asked)
        count = Count(len(table), table.finished(), progress)
        if executor is None and processes and cores > 1 and _is_long(asked):
            executor = stack.enter_context(pool_of(cores))
        elif executor is None and asked.is_auto and asked.recipe.engine == "numba":
            run = FirstUse(count).run
        jobs = [_job(table, chunk, asked.recipe, run) for chunk in np.flatnonzero(~table.done()).tolist()]
        run_jobs(jobs, executor, stop_requested, path, count, in_flight)
        return count.state


def _job(table: SweepTable, chunk: int, recipe: Recipe, run: Callable[..., ChunkResult]) -> Job:
    start, stop = table.span(chunk)
    return Job(
        f"scenes {start} to {stop - 1}", stop - start, run,
        lambda: (recipe, start, table.points.columns(start, stop)), partial(table.store, chunk),
    )  # fmt: skip


def make_sweep(
    scene: Scene,
    vary: Sequence[str | Varied],
    *,
    controllers: Sequence[str] = (),
    duration: float | None = None,
    cycles: int | None = None,
    metrics: Sequence[str] | None = None,
    engine: Engine = "auto",
    chunk: int | None = None,
    **options: bool,
) -> Asked:
    """Prepare a sweep, and check it as far as possible before a scene runs.

    Args:
        scene: Scene with simulated drives, from a file or text.
        vary: Varied keys, as for `--vary`.
        controllers: Passivity algorithms to run every point under; none: the scene's own.
        duration: Length of every run [s]; by default the scene's.
        cycles: Number of SYNCs of every scene, instead of a duration.
        metrics: Names of `FIGURES`; by default `usual_figures`, which need no continuous run of each scene.
        engine: Engine for scenes that fit a batch; "auto" is numba where it is installed and saves time.
        chunk: Scenes that are stored together; it affects only how much work a kill can lose.
        options: `beyond_bus`: whether to accept rates that the bus could not carry, instead of refusing them.
            `allow_code`: whether program files that varied values name may run; those of the scene itself may run if
            the scene was loaded with that permission.

    Raises:
        InputError: A key, a value or an option is wrong.
    """
    points = make_points([parse_vary(one) if isinstance(one, str) else one for one in vary], controllers)
    metrics = [figure_name(name) for name in metrics or ()]
    if unknown := [name for name in metrics if name not in FIGURES]:
        raise InputError(f"unknown metric {unknown[0]!r}, expected one of: {', '.join(FIGURES)}")
    if duration is not None and cycles is not None:
        raise InputError("got a duration and a number of cycles; give one")
    recipe = make_recipe(
        scene, points, metrics=tuple(dict.fromkeys(metrics or usual_figures(scene))),
        engine=chosen_engine(engine, pays=False), duration=duration, cycles=cycles, **options,
    )  # fmt: skip
    together = _together(recipe, points)
    if together < _FEWEST_TOGETHER and not _is_not_batchable(scene, controllers):
        recipe = replace(recipe, is_alone=True)
    least, most = _SCALAR_CHUNK if recipe.is_alone or _is_not_batchable(scene, controllers) else _BATCH_CHUNK
    each = recipe.cycles or cycles_of(scene, duration)
    pays = _pays(scene, len(points), each)
    recipe = replace(recipe, engine=chosen_engine(engine, pays))
    if recipe.engine == "python":
        most = min(most, max(1, _CYCLES_IN_PYTHON // each))
    chunk = chunk or min(most, max(least, -(-len(points) // _FEWEST_CHUNKS)))
    is_slow = engine == "auto" and pays and bool(why_no_numba())
    return Asked(recipe, points, chunk, _identity(scene, recipe, points), engine == "auto", is_slow)


def _pays(scene: Scene, scenes: int, cycles: int) -> bool:
    """Return whether compiling saves more time than it takes."""
    return any(scenes * cycles >= _worth_compiling(part) for part in parts_of(scene).values())


def _worth_compiling(alone: Scene) -> float:
    """Return from how many cycles compiling the loop of a port pays; infinite for one that Python always runs."""
    [port] = alone.ports
    if port.causality is not IMPEDANCE:
        return math.inf
    if port.section:
        return math.inf if network_loop(alone).why_not else WORTH_COMPILING_GROUPS
    plants = (build_plant(of.simulation, alone.bus.sample_time_ns) for of in port.axes if of.simulation)
    has_events = not alone.unread and any(not plant.is_linear for plant in plants)
    return WORTH_COMPILING_EVENTS if has_events else WORTH_COMPILING


def _is_long(asked: Asked) -> bool:
    """Return whether Python has to run so many cycles that a pool of processes saves time."""
    cycles = asked.recipe.cycles or cycles_of(scene_of(asked.recipe, ()).permitted(), asked.recipe.duration)
    return asked.recipe.engine == "python" and len(asked.points) * cycles >= _WORTH_A_POOL


def _together(recipe: Recipe, points: Points) -> int:
    """Return how many scenes of the sweep differ only in keys that may vary inside a batch."""
    apart = [v for v in points.varied if not is_batch_key(recipe, v.key) or (v.key == RATE and recipe.cycles is None)]
    return len(points) // math.prod(len(v.values) for v in apart)


def _is_not_batchable(scene: Scene, controllers: Sequence[str]) -> bool:
    """Return whether some scenes must run one by one."""
    under = ((port, name) for port in scene.ports for name in controllers or (port.passivity.name,))
    return any(why_not_batchable(scene.with_port(with_algorithm(*one)).alone(one[0])) for one in under)


def _identity(scene: Scene, recipe: Recipe, points: Points) -> Row:
    """Return the facts that must be equal for two runs to share a folder."""
    return {
        "configuration": scene.config_hash(),
        "varied": [{**asdict(v), "values": list(v.values), "given": str(v)} for v in points.varied],
        "duration": recipe.duration,
        "cycles": recipe.cycles,
        "metrics": list(recipe.metrics),
        "beyond_bus": recipe.beyond_bus,
        "axes": list(recipe.axes),
        "canhaptic": version("canhaptic"),
    }


def _notes(scene: Scene, asked: Asked) -> dict[str, str]:
    """Return texts about a sweep: scene, overrides, and estimated errors of plants that are not simulated exactly.

    Errors are estimated for the first scene, the last, and one of each kind of plant; the last line counts the others.
    """
    lines, looked_at = [], _looked_at(asked.points)
    for index in looked_at:
        row = row_of(asked.points.columns(index, index + 1), 0)
        built, words = scene_of(asked.recipe, row).scene, ", ".join(f"{key}={short(value)}" for key, value in row)
        lines += [f"with {words}: {line}" for line in (plant_errors(built) if built else ())]
    if lines and (others := len(asked.points) - len(looked_at)):
        lines.append(f"of {others} other scenes ERROR NOT KNOWN")
    notes = {"scene": scene.text, "source": scene.source, "overrides": json.dumps(scene.overrides)}
    return notes | {"plant_errors": "\n".join(lines)}


def _looked_at(points: Points) -> list[int]:
    """Return the scenes whose error is estimated: first, last, and the first with each listed value of a plant key."""
    found = {0, len(points) - 1}
    for varied in points.varied:
        if varied.spacing == "list" and varied.key.startswith("simulation."):
            numbers = points.numbers(varied.key)
            found |= {int(np.argmax(numbers == value)) for value in range(min(len(varied.values), _MOST_PLANTS))}
    return sorted(found)


def _check_same(table: SweepTable, asked: Asked) -> None:
    """Refuse to resume a folder of another sweep.

    Raises:
        InputError: A fact of the sweep differs; the message names it.
    """
    for name, wanted in asked.identity.items():
        found = table.identity.get(name)
        if found != wanted:
            raise InputError(
                f"{table.folder}: was made with {name.replace('_', ' ')} {_words(found)}, now {_words(wanted)}; "
                "repeat the earlier options, give another --out, or replace the folder with --force"
            )


def _words(value: object) -> str:
    if isinstance(value, list) and value and isinstance(value[0], dict):
        return " ".join(str(one["given"]) for one in value)
    return str(value)[:160]


_FIRST: Final = 2
"""Scenes that Python runs to measure the time of one."""
_SLICE: Final = 0.5
"""Time that Python spends on further scenes before it is asked again whether compiling pays [s]."""
_COMPILING: Final = 5.0
"""Approximate time of compiling [s]; the code is kept, so that the next sweep of the kind has it too."""


class FirstUse:
    """Runs chunks; while their loop is not compiled, Python runs some of the scenes.

    A loop is compiled as soon as Python would take longer for the scenes that are left, by the time of the last ones,
    than compiling takes, or has already taken longer. Both engines give the same bits, so that the figures do not
    depend on which scenes Python ran.

    Args:
        count: Finished scenes of the sweep.
    """

    def __init__(self, count: Count) -> None:
        self._count = count
        self._each = 0.0  # time of a scene in Python, by the last ones [s]
        self._spent = 0.0  # time of all scenes in Python [s]

    def run(self, recipe: Recipe, start: int, columns: Mapping[str, Column]) -> ChunkResult:
        """Return the figures of a chunk; see `run_chunk`."""
        from canhaptic.kernels.compiler import if_kept  # numba is installed

        found = if_kept(run_chunk, recipe, start, columns)
        if found is not None:
            return found
        clock, scenes, done, parts = WallClock(), len(next(iter(columns.values()))), 0, list[ChunkResult]()
        size = _FIRST
        while done < scenes:
            compiles = self._pays(done)
            size = scenes - done if compiles else min(size, scenes - done)
            self._count.within(done, compiles=compiles)
            rows = {key: values[done : done + size] for key, values in columns.items()}
            began = clock.now()
            parts.append(run_chunk(recipe if compiles else replace(recipe, engine="python"), start + done, rows))
            took, done = (clock.now() - began) * 1e-9, done + size
            if not compiles:
                self._each, self._spent = took / size, self._spent + took
                size = max(1, int(min(4.0 * size, _SLICE / max(self._each, 1e-9))))
        return joined(parts)

    def _pays(self, done: int) -> bool:
        left = self._count.state.total - self._count.state.done - done
        return self._spent > _COMPILING or self._each * left > _COMPILING


def joined(parts: list[ChunkResult]) -> ChunkResult:
    """Concatenate the results of consecutive parts of a chunk."""
    return ChunkResult(
        {name: np.concatenate([part.figures[name] for part in parts]) for name in parts[0].figures},
        np.concatenate([part.status for part in parts]),
        np.concatenate([part.engine for part in parts]),
        np.concatenate([part.remark for part in parts]),
        next((part.of_plant for part in parts if part.of_plant), ""),
    )
