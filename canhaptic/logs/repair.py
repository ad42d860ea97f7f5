"""Saves what can be read of an energy log that a kill, a full disk or a bad sector left behind."""

from pathlib import Path
from typing import Final

from canhaptic.errors import InputError
from canhaptic.host.output_file import require_writable_place
from canhaptic.logs.column_check import found_columns
from canhaptic.logs.energy_reader import open_file
from canhaptic.logs.hdf5 import Dataset
from canhaptic.logs.packing import repack

_STEP: Final = 512  # rows tried at a time


def repair(source: str | Path, target: str | Path) -> tuple[int, int]:
    """Copies every whole row up to the first that is damaged or that a column lacks into a clean, packed log.

    Args:
        source: The log; it is not changed.
        target: The copy.

    Returns:
        (rows saved, rows that could not be read).

    Raises:
        LogFormatError: Nothing can be read: the file is no log, or a column of it is missing or of another type.
        InputError: Source and target are the same file, or the copy cannot be written.
    """
    source, target = Path(source), Path(target)
    if target.exists() and source.samefile(target):
        raise InputError(f"{target}: the repaired copy needs another name than the log itself")
    require_writable_place(target)
    file, description = open_file(source)
    with file:
        rows, events = found_columns(source, file, description.ports)
        longest = max(len(dataset) for dataset in rows.values())
        readable, notes = (min(_readable(dataset) for dataset in found.values()) for found in (rows, events))
    note = "" if description.status == "complete" else f" (was: {description.status})"
    try:
        repack(source, target, {"status": f"repaired{note}"}, (readable, notes))
    except OSError as error:
        raise InputError(f"{target}: the repaired copy cannot be written ({error}); name another file") from error
    return readable, longest - readable


def _readable(dataset: Dataset) -> int:
    """Returns how many elements at the start can be read."""
    length = len(dataset)
    for start in range(0, length, _STEP):
        try:
            dataset.read(start, min(length, start + _STEP))
        except (OSError, RuntimeError):
            return start
    return length
