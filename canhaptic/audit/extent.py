"""Selection of the rows of a log: a span of time, or each contact."""

import numpy as np

from canhaptic.control.balance import Branch
from canhaptic.errors import InputError
from canhaptic.logs.energy_reader import EnergyLog
from canhaptic.logs.hdf5 import Array


def rows_between(log: EnergyLog, start: float | None, stop: float | None) -> slice:
    """Return the rows from time `start` [s] on and before `stop` [s]; None: from the beginning, to the end.

    Raises:
        InputError: No cycle lies between them.
    """
    if start is None and stop is None:
        return slice(0, log.rows)
    time = log.time
    first = 0 if start is None else int(np.searchsorted(time, start))
    last = log.rows if stop is None else int(np.searchsorted(time, stop))
    if first >= last:
        end = f"{time[-1]:.6g}" if len(time) else "0"
        raise InputError(f"{log.path}: no cycle from {start} s to {stop} s; the log ends at {end} s")
    return slice(first, last)


def rows_to_draw(log: EnergyLog, start: float | None, stop: float | None) -> slice:
    """The same rows, of a log that holds any.

    Raises:
        InputError: It holds no cycle, or none between them.
    """
    if log.rows == 0:
        raise InputError(f"{log.path}: the log holds no cycle, there is nothing to draw")
    return rows_between(log, start, stop)


def contacts(branch: Array) -> list[tuple[int, int]]:
    """Return (first, last) row of every stretch in which a hold was booked by another branch than `free`.

    A contact continues across a hold whose sample was lost.
    """
    booked = np.where(branch != Branch.HELD.value, np.arange(len(branch)), 0)
    touching = np.isin(branch[np.maximum.accumulate(booked)], (Branch.FREE.value, Branch.HELD.value), invert=True)
    edges = np.flatnonzero(np.diff(touching, prepend=False, append=False))
    return [(int(start), int(end) - 1) for start, end in zip(edges[::2], edges[1::2], strict=True)]
