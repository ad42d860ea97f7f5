"""Stored values that are no finite number: no run writes them, so the log was damaged or what was logged went wrong."""

from typing import Any, Final

import numpy as np

from canhaptic.logs.energy_reader import EnergyLog

_BLOCK: Final = 65_536  # rows held in memory at a time


def not_finite(log: EnergyLog) -> list[dict[str, Any]]:
    """Returns `{dataset, rows, cycle}` of each column with NaN or infinity: how many rows, and the first cycle.

    Raises:
        LogFormatError: A column cannot be read.
    """
    groups = {f"ports/{name}": port for name, port in log.ports.items()}
    groups |= {f"truth/{name}": truth for name, truth in log.truth.items()}
    found = []
    for group, quantities in groups.items():
        for name in quantities:
            rows, first = 0, -1
            for start in range(0, log.rows, _BLOCK):
                values = quantities.read(name, start, start + _BLOCK)
                if values.dtype.kind != "f":
                    break
                bad = np.flatnonzero(~np.isfinite(values))
                first = start + int(bad[0]) if first < 0 and len(bad) else first
                rows += len(bad)
            if rows:
                cycle = int(log.timing.read("sync_index", first, first + 1)[0])
                found.append({"dataset": f"{group}/{name}", "rows": rows, "cycle": cycle})
    return found
