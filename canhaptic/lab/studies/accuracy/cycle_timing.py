"""Wall times that a busy machine spoils as little as possible: interleaved repeats, their least, their spread.

A fixed workload runs with them, so that a table made on one machine can be read on another by its ratios.
"""

from collections.abc import Callable, Mapping
from typing import Final, NamedTuple

import numpy as np

from canhaptic.drive.clock import WallClock

_LEAST_REPEATS: Final = 2
_MOST_REPEATS: Final = 15
_LONG: Final = 1_000_000_000  # [ns]; what takes longer is timed once
_PRODUCTS: Final = 20_000
WORKLOAD: Final = f"{_PRODUCTS} products of a 6 x 6 matrix with a vector, called from Python"


class WallTime(NamedTuple):
    """Wall-clock time of one candidate."""

    least: float  # [s]
    spread: float  # median over least, less one
    repeats: int


def interleaved(
    candidates: Mapping[str, Callable[[], object]],
    budget: float,
    stop: Callable[[], bool],
    progress: Callable[[float], None],
) -> dict[str, WallTime]:
    """Return the wall time of each candidate, run in turn A B C A B C; what is quick is repeated more often.

    Args:
        candidates: By name.
        budget: Shared alike among them [s]; beyond its share a candidate is run twice, a long one once.
        stop: Asked before each run whether to give up; what was measured is returned.
        progress: Called with the part that is done.
    """
    clock = WallClock()
    share = round(budget * 1e9 / max(1, len(candidates)))
    done = 0
    times: dict[str, list[int]] = {name: [] for name in candidates}
    for repeat in range(_MOST_REPEATS):
        for name, candidate in candidates.items():
            taken = times[name]
            enough = repeat >= _LEAST_REPEATS and sum(taken) > share
            if stop() or enough or (taken and min(taken) > _LONG):
                continue
            start = clock.now()
            candidate()
            taken.append(clock.now() - start)
            done += 1
            progress(min(1.0, done / (_LEAST_REPEATS * len(candidates))))
    progress(1.0)
    return {name: _wall_time(of_one) for name, of_one in times.items() if of_one}


def _wall_time(times: list[int]) -> WallTime:
    least = min(times)
    return WallTime(least * 1e-9, float(np.median(times)) / max(least, 1) - 1.0, len(times))


def workload() -> None:
    """Do the fixed work that every time is a multiple of."""
    matrix, state = np.eye(6) * 0.999, np.ones(6)
    product = matrix.dot
    for _ in range(_PRODUCTS):
        state = product(state)
