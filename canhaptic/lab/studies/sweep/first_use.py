"""First use of a loop: Python runs scenes while a separate process compiles the loop."""

import multiprocessing
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace
from multiprocessing.process import BaseProcess
from typing import Final

import numpy as np

from canhaptic.drive.clock import WallClock
from canhaptic.kernels.compiler import if_kept
from canhaptic.lab.studies.sweep.chunk import SLOTS, ChunkResult, Recipe, run_chunk
from canhaptic.lab.studies.sweep.vary import Column

_FIRST: Final = 4
"""Scenes that Python runs to measure the time of one."""
_SLICE: Final = 0.5
"""Time between two checks whether compiling has ended [s]."""
_COMPILING: Final = 10.0
"""Approximate time of compiling [s]. If Python would take longer for the rest of a chunk, it runs only the first scenes
and then waits, which leaves the processor and its caches to the compiler."""


class FirstUse:
    """Runs chunks, and compiles a new loop in a separate process in the meantime.

    Both engines give the same bits, so that the figures do not depend on which scenes Python ran.

    Args:
        report: Called with the number of finished scenes of a chunk while its loop is being compiled.
        begin: Called first in the compiling process.
    """

    def __init__(self, report: Callable[[int], None], begin: Callable[[], None]) -> None:
        self._report, self._begin = report, begin
        self._compiling: BaseProcess | None = None

    def run(self, recipe: Recipe, start: int, columns: Mapping[str, Column]) -> ChunkResult:
        """Return the figures of a chunk; see `run_chunk`."""
        found = if_kept(run_chunk, recipe, start, columns)
        if found is not None:
            return found
        if self._compiling is None or not self._compiling.is_alive():
            context = multiprocessing.get_context("spawn")
            self._compiling = context.Process(target=_compile, args=(self._begin, recipe, start, columns), daemon=True)
            self._compiling.start()
        return self._meanwhile(self._compiling, recipe, start, columns)

    def _meanwhile(
        self, compiling: BaseProcess, recipe: Recipe, start: int, columns: Mapping[str, Column]
    ) -> ChunkResult:
        """Run scenes in Python until their loop is compiled; if compiling ends sooner, wait for it after the first."""
        clock, count, done, size, each = WallClock(), len(next(iter(columns.values()))), 0, _FIRST, 0.0
        parts: list[ChunkResult] = []
        while done < count:
            if each * (count - done) > _COMPILING and compiling.is_alive():
                compiling.join(_SLICE)
                self._report(done)
                continue
            compiles = compiling.is_alive()
            size = min(size if compiles else count, count - done)
            began = clock.now()
            rows = {key: values[done : done + size] for key, values in columns.items()}
            chosen = replace(recipe, engine="python") if compiles else recipe
            parts.append(run_chunk(chosen, start + done, rows))
            each, done = (clock.now() - began) * 1e-9 / size, done + size
            size = max(1, int(min(4.0 * size, _SLICE / max(each, 1e-9))))
            self._report(done)
        return joined(parts)

    def close(self) -> None:
        """Terminate the compiling process, whose result is no longer needed."""
        if self._compiling is not None:
            self._compiling.terminate()
            self._compiling.join()


def _compile(begin: Callable[[], None], recipe: Recipe, start: int, columns: Mapping[str, Column]) -> None:
    """Compile the loops of a chunk by running two SYNCs of every scene; errors are ignored, the sweep repeats them."""
    begin()
    with suppress(Exception):
        run_chunk(replace(recipe, cycles=2, duration=None), start, columns)


def joined(parts: list[ChunkResult]) -> ChunkResult:
    """Concatenate the results of consecutive parts of a chunk."""
    texts = list(dict.fromkeys(text for part in parts for text in part.texts))
    slots = [[0, *(min(texts.index(text) + 1, SLOTS) for text in part.texts)] for part in parts]
    remarks = [np.array(of, dtype=np.uint8)[part.remark] for of, part in zip(slots, parts, strict=True)]
    return ChunkResult(
        {name: np.concatenate([part.figures[name] for part in parts]) for name in parts[0].figures},
        np.concatenate([part.status for part in parts]),
        np.concatenate([part.engine for part in parts]),
        np.concatenate(remarks),
        tuple(texts[:SLOTS]),
        next((part.of_plant for part in parts if part.of_plant), ""),
    )
