"""Chunks to workers, results to the file as they come: memory does not grow with the number of scenes.

The result of a scene depends only on its values and its global index, so that serial, pool and cluster write the same
bits; only the order in which chunks become ready differs.

Where chunks run: in this process, in a process pool, on a Dask cluster, on any executor of `concurrent.futures`.

A pool whose worker dies is replaced and its unfinished work is run again; Dask does that by itself.
"""

import hashlib
import json
import math
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Executor, Future, ProcessPoolExecutor
from concurrent.futures import wait as wait_for_chunks
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from importlib.metadata import version
from multiprocessing.connection import wait
from pathlib import Path
from typing import Any, Final, NamedTuple, TypeVar

import numpy as np

from canhaptic.errors import CanHapticError, InputError, WorkersLostError
from canhaptic.extras import install_hint
from canhaptic.lab.batch import why_not_batchable
from canhaptic.lab.batch.engine import WORTH_COMPILING, WORTH_COMPILING_GROUPS, Engine, chosen_engine
from canhaptic.lab.batch.group_loop import group_case
from canhaptic.lab.loop.admittance_loop import is_display
from canhaptic.lab.loop.axis_loop import cycles_of, parts_of, with_algorithm
from canhaptic.lab.studies import Row
from canhaptic.lab.studies.sweep.chunk import (
    FIGURES,
    RATE,
    ChunkResult,
    Recipe,
    is_batch_key,
    make_recipe,
    run_chunk,
    scene_of,
    usual_figures,
)
from canhaptic.lab.studies.sweep.sweep_table import Columnset, SweepTable, create
from canhaptic.lab.studies.sweep.vary import Points, Varied, make_points, parse_vary
from canhaptic.scene.method import plant_errors
from canhaptic.scene.models import Scene

T = TypeVar("T")

_CONNECT: Final = 10.0
"""Time in which a scheduler must answer [s]."""


class SerialExecutor(Executor):
    """Executor that runs everything at once, in this thread.

    Args:
        instead: Function -> the function that replaces it.
    """

    def __init__(self, instead: Mapping[object, Callable[..., Any]] | None = None) -> None:
        self._instead = instead or {}

    def submit(self, fn: Callable[..., T], /, *args: object, **kwargs: object) -> Future[T]:
        """Return a completed future."""
        future: Future[T] = Future()
        try:
            run: Callable[..., T] = self._instead.get(fn, fn)
            future.set_result(run(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


class Pool:
    """Worker processes of our own; `renew` replaces them when one died.

    They are started afresh (`spawn`), so that they inherit no thread or lock of this process. They leave Ctrl-C to this
    process, and end when it does, however it ends.

    Args:
        workers: Number of processes.
    """

    def __init__(self, workers: int) -> None:
        self.workers = workers
        self.executor = self._made()

    def renew(self) -> Executor:
        """Replace the processes by new ones and return the pool."""
        self.executor.shutdown(wait=True, cancel_futures=True)
        self.executor = self._made()
        return self.executor

    def close(self) -> None:
        """End the processes once they have finished their present work."""
        self.executor.shutdown(wait=True, cancel_futures=True)

    def _made(self) -> ProcessPoolExecutor:
        context = multiprocessing.get_context("spawn")
        return ProcessPoolExecutor(self.workers, mp_context=context, initializer=_begin_worker)


def _begin_worker() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    threading.Thread(target=_follow_parent, daemon=True).start()


def _follow_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(1)


@contextmanager
def dask_executor(address: str) -> Iterator[tuple[Executor, int]]:
    """Yield (executor, number of threads of its workers) of a Dask cluster.

    Args:
        address: Address of the scheduler, such as tcp://10.0.0.5:8786.

    Raises:
        InputError: Dask is not installed, no scheduler answers, or it has no worker.
    """
    try:
        from distributed import Client
    except ImportError as error:
        raise InputError(f"--dask needs Dask; install it with: {install_hint('sweep')}") from error
    try:
        client = Client(address, timeout=_CONNECT, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        raise InputError(
            f"--dask {address}: no scheduler answers there within {_CONNECT:g} s ({error}); "
            "start one with dask scheduler"
        ) from error
    try:
        threads = sum(client.nthreads().values())
        if not threads:
            raise InputError(f"--dask {address}: the cluster has no worker; start some with dask worker {address}")
        yield client.get_executor(pure=False), threads
    finally:
        client.close()


_BATCH_CHUNK: Final = (1000, 5000)
"""Least and most scenes of a chunk unless the user says otherwise: fewer, and making the batch costs more than it."""
_SCALAR_CHUNK: Final = (1, 50)
_WORTH_A_POOL: Final = 1e6
"""Scenes times cycles that Python runs, from which a pool of processes pays: some 10 s on one core."""
_FEWEST_CHUNKS: Final = 16
_FEWEST_TOGETHER: Final = 8
"""Scenes of one kind in a sweep, below which making their batch costs more than running them."""
_LOOK: Final = 0.2
"""Time between two looks at a request to stop [s]."""
_MOST_LOSSES: Final = 3
"""Pools lost in a row without a chunk finished in between."""


class Asked(NamedTuple):
    """A sweep ready to be started or continued."""

    recipe: Recipe
    points: Points
    chunk: int
    identity: Row
    is_auto: bool  # whether the engine was chosen here


class Progress(NamedTuple):
    """Progress of a sweep."""

    done: int  # scenes whose results are in the file
    total: int
    begun: int  # scenes that an earlier run had finished
    compiles: bool = False  # whether their loop is being compiled while Python runs some


def sweep(
    scene: Scene,
    vary: Sequence[str | Varied],
    out: str | Path,
    executor: Executor | Pool | None = None,
    *,
    resume: bool = False,
    force: bool = False,
    in_flight: int = 4,
    processes: bool = False,
    progress: Callable[[Progress], None] = lambda _: None,
    stop_requested: Callable[[], bool] = lambda: False,
    **options: Any,
) -> Progress:
    """Run every scene and store the figures in a file; a stopped or killed sweep continues where it was.

    Args:
        scene: Scene with simulated drives, from a file or text.
        vary: Varied keys, as for `--vary`.
        out: The file (HDF5).
        executor: Any `concurrent.futures.Executor`, or a `Pool`; None: in this thread.
        resume: Whether to continue with an existing file; a missing one is created.
        force: Whether to replace an existing file.
        in_flight: Largest number of chunks submitted and not yet written.
        processes: Whether, where no executor is given, a long sweep that Python runs gets a process on each core, and
            a loop that is not compiled yet is compiled in a separate process while Python runs scenes.
        progress: Called regularly with the progress.
        stop_requested: Polled regularly; True ends the sweep after the submitted chunks.
        options: As for `make_sweep`.

    Raises:
        InputError: Bad input, or a file of another sweep.
        LogWriteError: The file cannot be written.
        WorkersLostError: The workers die again and again.
    """
    asked, path = make_sweep(scene, vary, **options), Path(out)
    if resume and path.exists():
        with SweepTable(path) as table:
            _check_same(table, asked)
    else:
        create(path, asked.points, asked.chunk, _columns(scene, asked), replace=force)
    with ExitStack() as stack:
        table = stack.enter_context(SweepTable(path, writable=True))
        cores = os.cpu_count() or 1
        if executor is None and processes and cores > 1 and _is_long(asked):
            pool = Pool(cores)
            executor, in_flight = pool, 2 * cores
            stack.callback(pool.close)
        run = _Run(asked, table, progress)
        if executor is None and processes and cores > 1 and asked.is_auto and asked.recipe.engine == "numba":
            from canhaptic.lab.studies.sweep.first_use import FirstUse  # numba is installed

            first = FirstUse(run.report, _begin_worker)
            stack.callback(first.close)
            executor, in_flight = SerialExecutor({run_chunk: first.run}), 1
        run.run(executor or SerialExecutor(), 1 if executor is None else in_flight, stop_requested)
        table.merge()
        return run.state


def make_sweep(
    scene: Scene,
    vary: Sequence[str | Varied],
    *,
    controllers: Sequence[str] = (),
    samples: int = 0,
    seed: int = 0,
    duration: float | None = None,
    cycles: int | None = None,
    metrics: Sequence[str] | None = None,
    engine: Engine = "auto",
    chunk: int | None = None,
    beyond_bus: bool = False,
    allow_code: bool = False,
) -> Asked:
    """Return a sweep, checked as far as possible before a scene runs.

    Args:
        scene: Scene with simulated drives, from a file or text.
        vary: Varied keys, as for `--vary`.
        controllers: Passivity algorithms to run every point under; none: the scene's own.
        samples: Points of a Latin hypercube; 0 for the grid of all values.
        seed: Seed of the hypercube.
        duration: Length of every run [s]; by default that of the scene.
        cycles: SYNCs of every scene, instead of a duration.
        metrics: Names of `FIGURES`; by default `usual_figures`, which need no continuous run of each scene.
        engine: Engine for scenes that fit a batch; "auto" is numba where it is installed and worthwhile.
        chunk: Scenes that are finished together; affects only how much a kill can lose.
        beyond_bus: Whether to accept rates that the bus could not carry, instead of refusing them.
        allow_code: Whether program files that a varied value names may run; the scene's own may if it was loaded
            that way.

    Raises:
        InputError: Anything is wrong.
    """
    points = make_points([_varied(one) for one in vary], controllers, samples, seed)
    _check(metrics, duration, cycles)
    recipe = make_recipe(
        scene,
        points,
        metrics=tuple(dict.fromkeys(metrics or usual_figures(scene))),
        engine=chosen_engine(engine, pays=False),
        duration=duration,
        cycles=cycles,
        beyond_bus=beyond_bus,
        allow_code=allow_code,
    )
    together = _together(recipe, points)
    if together < _FEWEST_TOGETHER and not scene.groups and not recipe.displays:
        reason = f"only {together} of the scenes differ in nothing but keys of a batch, expected {_FEWEST_TOGETHER}"
        recipe = replace(recipe, alone=reason)
    least, most = _SCALAR_CHUNK if recipe.alone or _is_not_batchable(scene, controllers) else _BATCH_CHUNK
    chunk = chunk or min(most, max(least, -(-len(points) // _FEWEST_CHUNKS)))
    pays = _pays(scene, len(points), recipe.cycles or cycles_of(scene, duration))
    recipe = replace(recipe, engine=chosen_engine(engine, pays))
    return Asked(recipe, points, chunk, _identity(scene, recipe, points), engine == "auto")


def _check(metrics: Sequence[str] | None, duration: float | None, cycles: int | None) -> None:
    unknown = [name for name in metrics or () if name not in FIGURES]
    if unknown:
        raise InputError(f"unknown metric {unknown[0]!r}, expected one of: {', '.join(FIGURES)}")
    if duration is not None and cycles is not None:
        raise InputError("got a duration and a number of cycles; give one")


def _pays(scene: Scene, scenes: int, cycles: int) -> bool:
    """Return whether compiling takes less time than it saves."""
    if scene.groups:
        parts = [part for part in parts_of(scene).values() if part.groups]
        return scenes * cycles >= WORTH_COMPILING_GROUPS and any(group_case(part).is_compilable for part in parts)
    return scenes * cycles >= WORTH_COMPILING


def _is_long(asked: Asked) -> bool:
    """Return whether Python runs so many cycles that starting processes is a small part of the time."""
    cycles = asked.recipe.cycles or cycles_of(scene_of(asked.recipe, ()).permitted(), asked.recipe.duration)
    return asked.recipe.engine == "python" and len(asked.points) * cycles >= _WORTH_A_POOL


class _Run:
    """A sweep on its way: which chunks are out, which are in the file."""

    def __init__(self, asked: Asked, table: SweepTable, progress: Callable[[Progress], None]) -> None:
        self._asked, self._table, self._progress = asked, table, progress
        done = table.done()
        self._waiting = np.flatnonzero(~done).tolist()[::-1]
        begun = sum(stop - start for start, stop in map(table.span, np.flatnonzero(done).tolist()))
        self._out: dict[Future[ChunkResult], int] = {}
        self._losses = 0
        self.state = Progress(begun, len(table), begun)

    def run(self, executor: Executor | Pool, in_flight: int, stop_requested: Callable[[], bool]) -> None:
        """Run what is not in the file yet."""
        self._progress(self.state)
        try:
            while (self._waiting or self._out) and not stop_requested():
                self._submit(executor, in_flight)
                ready, _ = wait_for_chunks(self._out, timeout=_LOOK, return_when=FIRST_COMPLETED)
                for future in ready:
                    self._take(future, executor)
        finally:
            for future in self._out:
                future.cancel()
        for future in [*self._out]:
            if not future.cancelled():  # what is under way is not thrown away
                self._take(future, executor)

    def report(self, scenes: int) -> None:
        """Show how many scenes of the chunk under way are done while their loop is being compiled."""
        self._progress(self.state._replace(done=self.state.done + scenes, compiles=True))

    def _submit(self, executor: Executor | Pool, in_flight: int) -> None:
        target = executor.executor if isinstance(executor, Pool) else executor
        while self._waiting and len(self._out) < in_flight:
            chunk = self._waiting.pop()
            start, stop = self._table.span(chunk)
            columns = self._table.columns(start, stop)
            try:
                self._out[target.submit(run_chunk, self._asked.recipe, start, columns)] = chunk
            except BrokenExecutor as error:
                self._waiting.append(chunk)
                self._lost(executor, error)
                return

    def _take(self, future: Future[ChunkResult], executor: Executor | Pool) -> None:
        chunk = self._out.pop(future, None)
        if chunk is None:
            return
        try:
            result = future.result()
        except BrokenExecutor as error:
            self._waiting.append(chunk)
            self._lost(executor, error)
        except CanHapticError:
            raise
        except (Exception, CancelledError) as error:
            start, stop = self._table.span(chunk)
            raise WorkersLostError(
                f"{self._table.path}: scenes {start} to {stop - 1} failed in a worker "
                f"({type(error).__name__}: {error}); workers need the same canhaptic and the drive's EDS at the same "
                "path; what was finished is kept, --resume goes on"
            ) from error
        else:
            self._table.write(chunk, result)
            start, stop = self._table.span(chunk)
            self._losses = 0
            self.state = self.state._replace(done=self.state.done + stop - start)
            self._progress(self.state)

    def _lost(self, executor: Executor | Pool, error: BrokenExecutor) -> None:
        """Begin anew with new workers after one died, unless that does not help."""
        self._waiting += self._out.values()
        self._out.clear()
        self._losses += 1
        if not isinstance(executor, Pool) or self._losses >= _MOST_LOSSES:
            raise WorkersLostError(
                f"{self._table.path}: the workers died {self._losses} times in a row without finishing a chunk "
                f"({error or type(error).__name__}); what was finished is kept: look for the cause (memory?), take "
                "fewer workers or a smaller --chunk with a new file, and --resume"
            ) from error
        executor.renew()


def _varied(one: str | Varied) -> Varied:
    return parse_vary(one) if isinstance(one, str) else one


def _together(recipe: Recipe, points: Points) -> int:
    """Return how many scenes of the whole sweep differ in nothing but keys that may differ inside a batch."""
    apart = [v for v in points.varied if not is_batch_key(recipe, v.key) or (v.key == RATE and recipe.cycles is None)]
    if points.samples and any(v.spacing != "list" for v in apart):
        return 1
    return len(points) // math.prod(len(v.values) for v in apart)


def _is_not_batchable(scene: Scene, controllers: Sequence[str]) -> bool:
    """Whether some of the scenes will have to run one by one."""
    if scene.groups or any(is_display(part) for part in parts_of(scene).values()):
        return True
    for axis in scene.axes:
        for name in controllers or (axis.passivity.name,):
            if why_not_batchable(replace(scene, axes=(with_algorithm(axis, name),))):
                return True
    return False


def _identity(scene: Scene, recipe: Recipe, points: Points) -> Row:
    """Return what two runs must have in common to share a file."""
    return {
        "configuration": scene.config_hash(),
        "varied": [
            {"key": v.key, "given": str(v), "spacing": v.spacing, "hash": _hash(v), "numbers": v.is_number}
            for v in points.varied
        ],
        "samples": points.samples,
        "seed": points.seed if points.samples else 0,
        "duration": recipe.duration,
        "cycles": recipe.cycles,
        "metrics": list(recipe.metrics),
        "beyond_bus": recipe.beyond_bus,
        "axes": list(recipe.axes),
        "canhaptic": version("canhaptic"),
    }


def _hash(varied: Varied) -> str:
    return hashlib.sha256(json.dumps(varied.values).encode()).hexdigest()


def _columns(scene: Scene, asked: Asked) -> Columnset:
    figures = tuple(f"{axis}/{metric}" for axis in asked.recipe.axes for metric in asked.recipe.metrics)
    notes = {"scene": scene.text, "source": scene.source, "overrides": json.dumps(scene.overrides)}
    notes["plant_errors"] = "\n".join(plant_errors(scene))
    return Columnset(figures, asked.identity, notes)


def _check_same(table: SweepTable, asked: Asked) -> None:
    """Refuse to go on with a file of something else.

    Raises:
        InputError: It is; names what differs.
    """
    there: Mapping[str, Any] = table.identity
    for name, value in asked.identity.items():
        if there.get(name) == value:
            continue
        found, wanted = (_words(name, entry) for entry in (there.get(name), value))
        raise InputError(
            f"{table.path}: was made with {name.replace('_', ' ')} {found}, now asked {wanted}; ask for the same, "
            "give another --out, or replace it with --force"
        )


def _words(name: str, value: Any) -> str:
    if name == "varied" and value:
        return " ".join(str(varied["given"]) for varied in value)
    return str(value)[:160]
