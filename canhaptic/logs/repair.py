"""Saves what can be read of an energy log that a kill, a full disk or a bad sector left behind."""

from pathlib import Path
from typing import Final

from canhaptic.errors import InputError
from canhaptic.logs.energy_reader import EnergyLog
from canhaptic.logs.hdf5 import Dataset, Hdf5File
from canhaptic.logs.packing import least, repack

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
        InputError: Source and target are the same file, or the copy cannot be written.
    """
    source, target = Path(source), Path(target)
    if target.exists() and source.samefile(target):
        raise InputError(f"{target}: the repaired copy needs another name than the log itself")
    with EnergyLog.open(source) as log:
        status, rows = log.status, log.rows
    with Hdf5File(source, "live") as file:
        readable, events = least(file, _readable)
    note = "" if status == "complete" else f" (was: {status})"
    try:
        repack(source, target, {"status": f"repaired{note}"}, (readable, events))
    except OSError as error:
        raise InputError(f"{target}: the repaired copy cannot be written ({error}); name another file") from error
    return readable, rows - readable


def _readable(dataset: Dataset) -> int:
    """Returns how many elements at the start can be read."""
    length = len(dataset)
    for start in range(0, length, _STEP):
        try:
            dataset.read(start, min(length, start + _STEP))
        except (OSError, RuntimeError):
            return start
    return length
