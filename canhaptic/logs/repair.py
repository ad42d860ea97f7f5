"""Saves what can be read of an energy log that a kill, a full disk or a bad sector left behind."""

from pathlib import Path
from typing import Final

from canhaptic.errors import InputError
from canhaptic.logs.energy_reader import EnergyLog
from canhaptic.logs.hdf5 import Dataset, Hdf5File
from canhaptic.logs.packing import columns_of_rows, repack

_STEP: Final = 512  # rows tried at a time


def repair(source: str | Path, target: str | Path) -> tuple[int, int]:
    """Copies every whole row up to the first that is damaged into a clean, packed log.

    Args:
        source: The log; it is not changed.
        target: The copy.

    Returns:
        (rows saved, rows that could not be read).

    Raises:
        LogFormatError: Nothing can be read.
        InputError: Source and target are the same file.
    """
    source, target = Path(source), Path(target)
    if target.exists() and source.samefile(target):
        raise InputError(f"{target}: the repaired copy needs another name than the log itself")
    with EnergyLog.open(source) as log:
        status, rows = log.status, log.rows
    with Hdf5File(source, "live") as file:
        readable = min((_readable(dataset, rows) for dataset in columns_of_rows(file)), default=0)
    note = "" if status == "complete" else f" (was: {status})"
    repack(source, target, {"status": f"repaired{note}"}, readable)
    return readable, rows - readable


def _readable(dataset: Dataset, rows: int) -> int:
    """Returns how many elements at the start can be read."""
    for start in range(0, rows, _STEP):
        try:
            dataset.read(start, min(rows, start + _STEP))
        except (OSError, RuntimeError):
            return start
    return rows
