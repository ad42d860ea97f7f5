"""Shares, extremes and medians of the completed scenes of a sweep, block by block: memory does not grow with them."""

import math
from collections.abc import Callable, Iterator
from typing import Final

import numpy as np
from numpy.typing import NDArray

from canhaptic.lab.loop.axis_loop import Array
from canhaptic.lab.studies.sweep.chunk import COMPLETED
from canhaptic.lab.studies.sweep.points import CONTROLLER
from canhaptic.lab.studies.sweep.sweep_table import SweepTable

_BLOCK: Final = 65_536
"""Rows looked at together."""
_DIGIT: Final = 16
"""Bits of a number that one look at the column settles."""
_SIGN: Final = np.uint64(1 << 63)


class Selected:
    """The completed scenes of one axis under one algorithm.

    Args:
        table: The file.
        axis: Name of the axis.
        controller: Number of the algorithm among the texts of its key; None for all scenes.
    """

    def __init__(self, table: SweepTable, axis: str, controller: int | None = None) -> None:
        self.table, self._axis, self._controller = table, axis, controller

    def count(self) -> int:
        """Return how many scenes there are."""
        return sum(int(rows.sum()) for _, _, rows in self._blocks())

    def share(self, metric: str, holds: Callable[[Array], NDArray[np.bool_]], *, finite: bool = False) -> float | None:
        """Return the share of the scenes whose figure passes; None without any.

        Args:
            metric: Name of a figure.
            holds: Truth of each of some figures.
            finite: Whether only finite figures count at all.
        """
        true = count = 0
        for values in self._columns(metric, finite=finite):
            true, count = true + int(holds(values).sum()), count + len(values)
        return true / count if count else None

    def least(self, metric: str) -> float | None:
        """Return the least finite figure; None without any."""
        return min((float(values.min()) for values in self._columns(metric, finite=True) if len(values)), default=None)

    def median(self, metric: str) -> float | None:
        """Return the median of the finite figures, of an even number the mean of both in the middle."""
        count = sum(len(values) for values in self._columns(metric, finite=True))
        if not count:
            return None
        low, high = (self._ranked(metric, rank) for rank in ((count - 1) // 2, count // 2))
        return low if low == high else math.fsum((0.5 * low, 0.5 * high))

    def _ranked(self, metric: str, rank: int) -> float:
        """Return the finite figure that `rank` others come before: its bits from the first to the last, in turns."""
        known = np.uint64(0)
        for settled in range(0, 64, _DIGIT):
            left = np.uint64(64 - settled - _DIGIT)
            counts = np.zeros(1 << _DIGIT, dtype=np.int64)
            for values in self._columns(metric, finite=True):
                ordered = _ordered(values)
                if settled:
                    ordered = ordered[ordered >> np.uint64(64 - settled) == known]
                digit = (ordered >> left) & np.uint64((1 << _DIGIT) - 1)
                counts += np.bincount(digit.astype(np.int64), minlength=1 << _DIGIT)
            before = np.cumsum(counts)
            chosen = int(np.searchsorted(before, rank, side="right"))
            rank -= int(before[chosen] - counts[chosen])
            known = (known << np.uint64(_DIGIT)) | np.uint64(chosen)
        bits = known ^ _SIGN if known & _SIGN else ~known
        return float(np.array([bits], dtype=np.uint64).view(np.float64)[0])

    def _columns(self, metric: str, *, finite: bool = False) -> Iterator[Array]:
        for start, stop, rows in self._blocks():
            values = self.table.figure(self._axis, metric, start, stop)[rows]
            yield values[np.isfinite(values)] if finite else values

    def _blocks(self) -> Iterator[tuple[int, int, NDArray[np.bool_]]]:
        for start in range(0, len(self.table), _BLOCK):
            stop = min(len(self.table), start + _BLOCK)
            rows = np.asarray(self.table.status(start, stop) == COMPLETED)
            if self._controller is not None:
                rows &= self.table.numbers(CONTROLLER, start, stop) == self._controller
            yield start, stop, rows


def _ordered(values: Array) -> NDArray[np.uint64]:
    """Return whole numbers in the order of the values: the bits of a float, those of negative ones inverted."""
    bits = np.ascontiguousarray(values).view(np.uint64)
    return np.where(bits & _SIGN, ~bits, bits | _SIGN)
