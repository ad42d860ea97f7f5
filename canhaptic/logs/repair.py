"""Recovery of an energy log after a kill, a full disk or a bad sector."""

from contextlib import suppress
from functools import partial
from itertools import product
from pathlib import Path
from typing import Final

from canhaptic.errors import InputError, LogFormatError
from canhaptic.host.output_file import require_writable_place
from canhaptic.logs.column_check import FoundColumns, found_columns, usual_length
from canhaptic.logs.energy_reader import DAMAGE, EnergyLog, open_file
from canhaptic.logs.hdf5 import Hdf5File
from canhaptic.logs.own_process import in_own_process
from canhaptic.logs.packing import repack, unfinished

_STEP: Final = 512  # rows tried at a time
_BLOCK: Final = 1 << 18  # rows read at a time


def repair(source: str | Path, target: str | Path) -> tuple[int, int]:
    """Copy every whole row up to the first that is damaged or that a column lacks into a clean, packed log.

    Args:
        source: The log; it is not changed.
        target: The copy.

    Returns:
        (rows saved, rows that could not be read).

    Raises:
        LogFormatError: Nothing can be read: the file is no log, a column of it is missing or of another type, or HDF5
            crashes on it.
        InputError: Source and target are the same file, or the copy cannot be written.
    """
    source, target = Path(source), Path(target)
    if target.exists() and source.samefile(target):
        raise InputError(f"{target}: the repaired copy needs another name than the log itself")
    require_writable_place(target)
    try:
        return in_own_process(source, partial(_repair, source, target))
    finally:
        unfinished(target)


def require_readable(source: Path) -> None:
    """Require that HDF5 survives everything in a file; damage that it reports is left to the reader.

    Raises:
        LogFormatError: It crashes, or does not come to an end; or there is no file.
    """
    in_own_process(source, partial(_read_all, source))


def _read_all(source: Path) -> None:
    with suppress(*DAMAGE), Hdf5File(source, "live") as file:
        file.read_tables()
    with suppress(*DAMAGE), EnergyLog.open(source) as log:  # by the same ways as who reads it later
        for quantities in (log.timing, *log.ports.values(), *log.truth.values()):
            for name, start in product(quantities, range(0, log.rows, _BLOCK)):
                with suppress(*DAMAGE):
                    quantities.unit(name), quantities.read(name, start, start + _BLOCK)
        log.events  # noqa: B018 - for what the library does to find them


def _repair(source: Path, target: Path) -> tuple[int, int]:
    file, description = open_file(source)
    try:
        with file:
            rows, events = found_columns(source, file, description.ports)
            expected = usual_length(rows)
            readable, notes = _readable(rows), _readable(events)
    except LogFormatError:
        raise
    except DAMAGE as error:
        raise LogFormatError(f"{source}: too damaged to be saved ({error})") from error
    note = "" if description.status == "complete" else f" (was: {description.status})"
    try:
        repack(source, target, {"status": f"repaired{note}"}, (readable, notes))
    except OSError as error:
        if error.errno is None:  # of the library that reads, not of the system that writes
            raise _lost(source, error) from error
        raise InputError(f"{target}: the repaired copy cannot be written ({error}); name another file") from error
    except DAMAGE as error:
        raise _lost(source, error) from error
    return readable, max(0, expected - readable)


def _lost(source: Path, error: Exception) -> LogFormatError:
    return LogFormatError(f"{source}: too damaged to be saved ({error})")


def _readable(columns: FoundColumns) -> int:
    """Return how many rows at the start every column has and can be read."""
    rows = min(len(dataset) for dataset in columns.values())  # a damaged column may claim any length
    for dataset in columns.values():
        for start in range(0, rows, _STEP):
            try:
                dataset.read(start, min(rows, start + _STEP))
            except (OSError, RuntimeError):
                rows = start
                break
    return rows
