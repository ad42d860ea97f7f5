"""The first use of a loop that is not compiled yet: Python runs scenes while a separate process compiles it."""

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
"""Scenes that Python runs before it is known how long one takes."""
_SLICE: Final = 0.5
"""Time after which the end of compiling is looked for [s]."""
_COMPILING: Final = 10.0
"""Time that compiling takes, about [s]: where Python would take longer for the rest of a chunk, it runs the first
scenes and leaves the processor, whose caches they share, to the compiler."""


class FirstUse:
    """Runs chunks; a loop met for the first time is compiled in a separate process meanwhile.

    Both engines give the same bits, so that it does not matter which scenes Python ran.

    Args:
        report: Called with the finished scenes of a chunk while its loop is being compiled.
        begin: Called in the compiling process.
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
        """Run scenes in Python until their loop is compiled; where that ends sooner, wait for it after the first."""
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
        """End the compiling process: the remaining work takes less time than compiling."""
        if self._compiling is not None:
            self._compiling.terminate()
            self._compiling.join()


def _compile(begin: Callable[[], None], recipe: Recipe, start: int, columns: Mapping[str, Column]) -> None:
    """Run two SYNCs of every scene, which compiles their loops; a failure here appears again in the sweep itself."""
    begin()
    with suppress(Exception):
        run_chunk(replace(recipe, cycles=2, duration=None), start, columns)


def joined(parts: list[ChunkResult]) -> ChunkResult:
    """Return consecutive results as one."""
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
