"""Comparison of two runs, quantity by quantity: the first row in which they differ, and by how much."""

from typing import TypedDict

import numpy as np
from numpy.typing import NDArray

from canhaptic.logs.energy_reader import EnergyLog, Quantities
from canhaptic.logs.hdf5 import Array


class Difference(TypedDict):
    """A quantity that differs."""

    name: str
    unit: str
    cycle: int  # the first in which it does
    first: float
    second: float
    largest: float  # in any cycle


class LogComparison(TypedDict):
    """Comparison of two runs."""

    identical: bool
    rows: list[int]  # of both
    missing: list[str]  # groups and quantities that only one of them has
    differences: list[Difference]


def compare(first: EnergyLog, second: EnergyLog) -> LogComparison:
    """Return how two runs differ; times of the cycles are left out, they differ in every run.

    Args:
        first: An open energy log.
        second: Another.
    """
    groups = _groups(first), _groups(second)
    names = [{f"{group}/{name}" for group, columns in side.items() for name in columns} for side in groups]
    shared = min(first.rows, second.rows)
    differences: list[Difference] = []
    for path in sorted(names[0] & names[1]):
        group, _, name = path.rpartition("/")
        left, right = (side[group].read(name, 0, shared) for side in groups)
        unequal = _unequal(left, right)
        if len(unequal):
            cycle = int(first.timing["sync_index"][unequal[0]])
            left, right = left[unequal], right[unequal]
            differences.append(
                {
                    "name": path,
                    "unit": groups[0][group].unit(name),
                    "cycle": cycle,
                    "first": left[0].item(),
                    "second": right[0].item(),
                    "largest": float(np.abs(left.astype(float) - right.astype(float)).max()),
                }
            )
    one_sided = set(groups[0]) ^ set(groups[1])
    single = {path for path in names[0] ^ names[1] if path.rpartition("/")[0] not in one_sided}
    missing = sorted(one_sided | single)
    return {
        "identical": not differences and not missing and first.rows == second.rows,
        "rows": [first.rows, second.rows],
        "missing": missing,
        "differences": sorted(differences, key=lambda difference: difference["cycle"]),
    }


def _groups(log: EnergyLog) -> dict[str, Quantities]:
    ports = {f"ports/{name}": port for name, port in log.ports.items()}
    return ports | {f"truth/{name}": truth for name, truth in log.truth.items()}


def _unequal(left: Array, right: Array) -> NDArray[np.intp]:
    """Rows whose bits differ: NaN equals NaN, and 0.0 is not -0.0."""
    if left.dtype != right.dtype:
        return np.flatnonzero(left.astype(float) != right.astype(float))
    width = f"u{left.dtype.itemsize}"
    return np.flatnonzero(np.ascontiguousarray(left).view(width) != np.ascontiguousarray(right).view(width))
