"""Stored values that no run writes: signs of a damaged log or a faulty logger.

They are numbers that are not finite, and running counts that fall.
"""

from typing import Final, TypedDict

import numpy as np

from canhaptic.logs.energy_reader import EnergyLog

_BLOCK: Final = 65_536  # rows held in memory at a time
_COUNTS: Final = frozenset({"uncommanded"})
"""Columns that count from the beginning of a run; a recomputation does not have them."""


class ImpossibleValue(TypedDict):
    """A column with such values."""

    dataset: str
    what: str
    rows: int  # how many
    cycle: int  # the first


def impossible_values(log: EnergyLog) -> list[ImpossibleValue]:
    """Return each column with such values.

    Raises:
        LogFormatError: A column cannot be read.
    """
    groups = {f"ports/{name}": port for name, port in log.ports.items()}
    groups |= {f"truth/{name}": truth for name, truth in log.truth.items()}
    found: list[ImpossibleValue] = []
    for group, quantities in groups.items():
        for name in quantities:
            rows, first, before = 0, -1, 0
            for start in range(0, log.rows, _BLOCK):
                values = quantities.read(name, start, start + _BLOCK)
                if name in _COUNTS:
                    values = values.astype(np.int64)
                    bad = np.flatnonzero(np.diff(values, prepend=before) < 0)
                    before = int(values[-1])
                elif values.dtype.kind == "f":
                    bad = np.flatnonzero(~np.isfinite(values))
                else:
                    break
                first = start + int(bad[0]) if first < 0 and len(bad) else first
                rows += len(bad)
            if rows:
                cycle = int(log.timing.read("sync_index", first, first + 1)[0])
                what = "a count that falls" if name in _COUNTS else "no finite number"
                found.append({"dataset": f"{group}/{name}", "what": what, "rows": rows, "cycle": cycle})
    return found
