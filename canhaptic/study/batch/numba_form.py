"""A program written out as a loop over scenes that numba compiles; needs the extra `fast`.

All numbers of a chunk lie in one array, a row for each state or value, `WIDTH` scenes wide. The width is a constant of
the source: the compiler then sees that rows do not overlap, and turns the inner loop into vector instructions. Nothing
is contracted or reordered: the same operations on the same numbers as in NumPy.
"""

import math
from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import Any

import numba
import numpy as np

from canhaptic.study.batch.layout import Layout, known_values, widened
from canhaptic.study.batch.numba_source import WIDTH, NumbaSource
from canhaptic.study.batch.numpy_form import BLOCK, Feed
from canhaptic.study.batch.program import Program
from canhaptic.study.loop import Array


class NumbaForm:
    """A program as a compiled function.

    Attributes:
        source: Of the function.
    """

    def __init__(self, program: Program) -> None:
        self.program = program
        self.layout = Layout(program)
        layout = self.layout
        self._rings = [name for name in layout.states if program.then[name].is_rows]
        self._lane_states = [n for n in layout.states if layout.state_differs(n) and n not in self._rings]
        self._one_states = [name for name in layout.states if not layout.state_differs(name)]
        given = [node for node in layout.fixed if node.op != "const"]
        self._lane_values = [node for node in given if node in layout.lanes]
        self._one_values = [node for node in given if node not in layout.lanes]
        written = NumbaSource(
            layout, self._lane_states, self._one_states, self._lane_values, self._one_values, self._rings
        )
        self.source = written.text
        self._work = max(1, written.work) * WIDTH
        self._kernel = compiled(self.source, len(self._rings))

    def run(self, numbers: Mapping[str, Any], count: int, cycles: int, feed: Feed) -> tuple[dict[str, Any], Any]:
        """Returns the states of some scenes after their cycles, or when they diverged, and the cycle of that.

        Args:
            numbers: By parameter, one or of shape (count,).
            count: Scenes.
            cycles: After the first SYNC.
            feed: Gives the inputs of the next cycles.

        Returns:
            State -> value; and for each scene the cycle in which it diverged, 0 where it did not.
        """
        program, layout = self.program, self.layout
        fixed = known_values([*layout.fixed, *program.first.values()], numbers, {})
        chunks = -(-count // WIDTH)
        block = _block([*(fixed[program.first[name]] for name in self._lane_states), 0.0], count)
        values = _block([fixed[node] for node in self._lane_values], count)
        begin = block[:, :-1].copy().reshape(chunks, -1)
        frozen, when = begin.copy(), np.zeros(chunks * WIDTH, dtype=np.int64)
        ones = np.array([float(fixed[program.first[name]]) for name in self._one_states])
        given = np.array([float(fixed[node]) for node in self._one_values])
        lists = [self._list(fixed[program.first[name]], chunks) for name in self._rings]
        flat = block.reshape(chunks, -1), values.reshape(chunks, -1)
        done, work = 0, np.empty(self._work)
        while done < cycles:
            some = min(BLOCK, cycles - done) if program.inputs else cycles
            inputs = self._inputs(feed, some, chunks)
            self._kernel(some, done, *flat, begin, frozen, when, ones, given, inputs, work, *lists)
            done += some
        return self._states(block, frozen, when, ones, count), when[:count]

    def _inputs(self, feed: Feed, cycles: int, chunks: int) -> Array:
        """Returns the inputs of some cycles, shape (chunks, inputs, cycles, WIDTH)."""
        nodes = self.program.inputs
        found = feed(cycles) if nodes else {}
        padded = np.zeros((len(nodes), cycles if nodes else 0, chunks * WIDTH))
        for i, node in enumerate(nodes):
            padded[i, :, : found[node.value].shape[1]] = found[node.value]
        return np.ascontiguousarray(padded.reshape(*padded.shape[:2], chunks, WIDTH).transpose(2, 0, 1, 3))

    def _list(self, rows: Any, chunks: int) -> Array:
        """Returns the rows of a list, shape (chunks, rows, WIDTH)."""
        padded = np.empty((len(rows), chunks * WIDTH))
        padded[:] = rows[:, -1:]
        padded[:, : rows.shape[1]] = rows
        return np.ascontiguousarray(padded.reshape(len(rows), chunks, WIDTH).swapaxes(0, 1))

    def _states(self, block: Array, frozen: Array, when: Any, ones: Array, count: int) -> dict[str, Any]:
        chunks = len(block)
        kept = frozen.reshape(chunks, -1, WIDTH)
        states: dict[str, Any] = {}
        for i, name in enumerate(self._lane_states):
            row = np.where(when > 0, kept[:, i].ravel(), block[:, i].ravel())[:count]
            states[name] = widened(row, count, self.program.then[name].is_truth)
        return states | dict(zip(self._one_states, ones.tolist(), strict=True))


def _block(rows: list[Any], count: int) -> Array:
    """Returns numbers or arrays of shape (count,) as chunks, shape (chunks, rows, WIDTH), the last scene repeated."""
    chunks = -(-count // WIDTH)
    block = np.empty((chunks, len(rows), WIDTH))
    for i, values in enumerate(rows):
        row = np.full(chunks * WIDTH, values if np.ndim(values) == 0 else values[-1], dtype=float)
        row[:count] = values
        block[:, i] = row.reshape(chunks, WIDTH)
    return block


@lru_cache(maxsize=64)
def compiled(source: str, lists: int) -> Callable[..., None]:
    """Returns the function of a source, compiled for its only types."""
    names: dict[str, Any] = {name: getattr(math, name) for name in ("sqrt", "exp", "sin", "cos", "tan", "asin", "inf")}
    names |= {
        "floor": np.floor,
        "copied": numba.njit(_copied, inline="always"),
        "place": numba.njit(_place, inline="always"),
    }
    exec(compile(source, "<batch>", "exec"), names)
    types = [
        "int64",
        "int64",
        *["float64[:, ::1]"] * 4,
        "int64[::1]",
        *["float64[::1]"] * 2,
        "float64[:, :, :, ::1]",
        "float64[::1]",
    ]
    types += ["float64[:, :, ::1]"] * lists
    function: Callable[..., None] = numba.njit(f"void({', '.join(types)})", error_model="numpy")(names["cycles"])
    return function


def _copied(size: float, sign: float) -> float:
    return size if sign >= 0.0 else -size


def _place(index: float, rows: int) -> int:
    """Returns the row of an index, inside of the list also for a scene whose numbers are none any more."""
    if index >= rows:
        return rows - 1
    return int(index) if index >= 0.0 else 0
