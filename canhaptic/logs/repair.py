"""Recovery of an energy log after a kill, a full disk or a bad sector.

Reads a damaged file in a copy of this process: HDF5 follows damaged addresses, and may crash or never return.
"""

import ctypes
import faulthandler
import os
import pickle
import signal
import sys
import warnings
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from itertools import product
from pathlib import Path
from typing import Final, TypeVar

from canhaptic.errors import InputError, LogFormatError
from canhaptic.files import require_writable_place
from canhaptic.logs import log_file
from canhaptic.logs.energy_reader import DAMAGE, Columns, EnergyLog, found_columns, open_file, read_safely, usual_length
from canhaptic.logs.energy_sink import repack, unfinished
from canhaptic.logs.hdf5 import Dataset, Hdf5File

_Result = TypeVar("_Result")
_SECONDS: Final = 2
"""Limit on the CPU time of the copy of the process [s]; plus one second for each `_BYTES_A_SECOND` of the file."""
_BYTES_A_SECOND: Final = 1_000_000
_PATIENCE: Final = 30
"""Limit on the time that passes meanwhile, in multiples of it: HDF5 may sleep for a writer, and a host may be busy."""
_OUT_OF_TIME: Final = ("SIGXCPU", "SIGALRM")
_PR_SET_PDEATHSIG: Final = 1  # of Linux's prctl


def in_own_process(path: Path, work: Callable[[], _Result]) -> _Result:
    """Return the result of `work`, computed in a copy of this process where the system can fork (Linux, macOS).

    Args:
        path: The file that is read, for the error.
        work: Function whose result can be pickled; its changes in memory are lost.

    Raises:
        LogFormatError: There is no file, or the copy crashed or took more time than any log of this size needs.
        Exception: The exception of `work`.
    """
    if sys.platform == "win32":
        return work()
    seconds, parent = _SECONDS + log_file(path).stat().st_size // _BYTES_A_SECOND, os.getpid()
    reader, writer = os.pipe()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of forks with other threads: h5py guards its own lock
        child = os.fork()
    if child == 0:
        os.close(reader)
        _answer(writer, work, seconds, parent)
    os.close(writer)
    content = b""
    try:
        with os.fdopen(reader, "rb") as pipe:
            content = pipe.read()
    finally:
        if not content:
            os.kill(child, signal.SIGKILL)  # after an interrupt; of one that has crashed nothing is left to end
        _, status = os.waitpid(child, 0)
    if not content:
        code = os.waitstatus_to_exitcode(status)
        ending = signal.Signals(-code).name if code < 0 else str(code)
        what = f"crashes on it (exit status {ending})"
        what = f"does not finish reading it within {seconds} s of a processor" if ending in _OUT_OF_TIME else what
        raise LogFormatError(f"{path}: too damaged: the HDF5 library {what}")
    result, error = pickle.loads(content)
    if error is not None:
        raise error
    answer: _Result = result
    return answer


def _answer(writer: int, work: Callable[[], object], seconds: int, parent: int) -> None:
    """Send the result or the error of `work`, and end the copy without flushing files of the first process."""
    import resource

    try:
        if sys.platform == "linux":
            ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != parent:  # it died before it could be watched
            return
        for name in _OUT_OF_TIME:
            signal.signal(signal.Signals[name], signal.SIG_DFL)
        _, most = resource.getrlimit(resource.RLIMIT_CPU)
        if most == resource.RLIM_INFINITY or seconds < most:
            resource.setrlimit(resource.RLIMIT_CPU, (seconds, most))
        signal.setitimer(signal.ITIMER_REAL, _PATIENCE * seconds)
        signal.set_wakeup_fd(-1)  # the first process is sent its signals itself
        faulthandler.disable()
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        try:
            content = pickle.dumps((work(), None))
        except Exception as error:
            content = pickle.dumps((None, error))
        with os.fdopen(writer, "wb") as pipe:
            pipe.write(content)
    finally:
        os._exit(0)


_STEP: Final = 512  # rows tried at a time
_BLOCK: Final = 1 << 18  # rows read at a time


def repair(source: str | Path, target: str | Path) -> tuple[int, int]:
    """Copy every whole row, up to the first damaged or incomplete one, into a clean, packed log.

    Args:
        source: The log; it is not changed.
        target: The copy.

    Returns:
        (rows saved, rows that could not be read).

    Raises:
        LogFormatError: Nothing can be read: the file is no log, a column is missing or of another type, or HDF5
            crashes.
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
    """Require that HDF5 reads everything in a file without a crash; damage that it reports is no error here.

    Raises:
        LogFormatError: HDF5 crashes or does not finish; or there is no file.
    """
    in_own_process(source, partial(_read_all, source))


def _read_all(source: Path) -> None:
    with suppress(*DAMAGE), Hdf5File(source, "live") as file:
        file.read_tables()
    with suppress(*DAMAGE), EnergyLog.open(source) as log:  # by the same calls as a later reader
        for quantities in log.tables.values():
            for name, start in product(quantities, range(0, log.rows, _BLOCK)):
                with suppress(*DAMAGE):
                    quantities.unit(name), quantities.read(name, start, start + _BLOCK)
        log.events  # noqa: B018 - for what the library does to find them


def _repair(source: Path, target: Path) -> tuple[int, int]:
    lost = "too damaged to be saved"
    file, description = open_file(source)
    with read_safely(source, lost), file:
        rows, events = found_columns(source, file, description.ports)
        expected = usual_length(rows)
        readable, notes = _readable(rows), _readable(events)
    note = "" if description.status == "complete" else f" (was: {description.status})"
    with read_safely(source, lost):
        try:
            repack(source, target, {"status": f"repaired{note}"}, (readable, notes))
        except OSError as error:
            if error.errno is None:  # of the library that reads, not of the system that writes
                raise
            raise InputError(f"{target}: the repaired copy cannot be written ({error}); name another file") from error
    return readable, max(0, expected - readable)


def _readable(columns: Columns) -> int:
    """Return the number of rows from the start that can be read in every column."""
    rows = min(len(dataset) for dataset in columns.values())  # a damaged column may claim any length
    for dataset in columns.values():
        for start in range(0, rows, _STEP):
            stop = min(rows, start + _STEP)
            try:
                dataset.read(start, stop)
            except (OSError, RuntimeError):
                rows = _first_damaged(dataset, start, stop)
                break
    return rows


def _first_damaged(dataset: Dataset, start: int, stop: int) -> int:
    """Return the row of the first damaged chunk among rows of which some cannot be read."""
    chunk, row = dataset.chunk, start
    while row < stop:
        try:
            dataset.read(row, row + 1)
        except (OSError, RuntimeError):
            break
        row += chunk - row % chunk
    return row if row < stop else start
