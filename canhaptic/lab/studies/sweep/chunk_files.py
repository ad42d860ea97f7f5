"""The chunks of a sweep that are not in its file yet: one file each, in the folder FILE.chunks.

A chunk is written to a new file, flushed to the disk and renamed into place: after a kill at any moment it is there as
a whole, or not at all.
"""

import errno
import os
import shutil
from contextlib import suppress
from pathlib import Path
from typing import Final
from zipfile import BadZipFile

import numpy as np

from canhaptic.errors import LogFormatError, LogWriteError
from canhaptic.logs import hdf5

Columns = dict[str, hdf5.Array]
"""Path of a column in the file of the sweep -> its part in a chunk."""

KEPT: Final = "what was finished is kept, --resume goes on"
_SUFFIX: Final = ".npz"


class ChunkFiles:
    """The folder of a sweep.

    Args:
        path: Path of the sweep's file.
        writable: Whether chunks will be written; only one process can.

    Attributes:
        there: Numbers of the chunks that are in the folder.

    Raises:
        LogWriteError: Another process writes it, or it cannot be made.
    """

    def __init__(self, path: Path, *, writable: bool = False) -> None:
        self._path, self._folder = path, path.with_name(f"{path.name}.chunks")
        self._lock: int | None = None
        if writable:
            self._lock = self._locked()
        found = self._folder.glob(f"*{_SUFFIX}") if self._folder.is_dir() else ()
        self.there = {int(name.stem) for name in found if name.stem.isdigit()}

    def _locked(self) -> int:
        import fcntl  # not on Windows

        try:
            self._folder.mkdir(exist_ok=True)
            descriptor = os.open(self._folder, os.O_RDONLY)
        except OSError as error:
            raise write_error(self._path, error, KEPT) from error
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            os.close(descriptor)
            raise LogWriteError(
                f"{self._path}: another sweep writes it; wait for its end, or give another --out"
            ) from error
        return descriptor

    def read(self, chunk: int, column: str) -> hdf5.Array:
        """Return a column of a chunk.

        Raises:
            LogFormatError: The file is damaged, or was merged while it was read.
        """
        path = self._file(chunk)
        try:
            with np.load(path, allow_pickle=False) as found:
                return np.asarray(found[column])
        except (OSError, ValueError, KeyError, BadZipFile) as error:
            raise LogFormatError(
                f"{path}: cannot be read ({error}); read again where the sweep still runs, else remove it and --resume"
            ) from error

    def write(self, chunk: int, columns: Columns) -> None:
        """Write a chunk.

        Raises:
            LogWriteError: The disk refuses, or the table is open for reading only; what was finished before stays.
        """
        if self._lock is None:
            raise LogWriteError(f"{self._path}: is open for reading only; open it with writable=True")
        path = self._file(chunk)
        beginning = path.with_suffix(".part")
        try:
            with beginning.open("wb") as file:
                np.savez(file, **columns)  # type: ignore[arg-type]
                file.flush()
                os.fsync(file.fileno())
            beginning.replace(path)
        except OSError as error:
            with suppress(OSError):
                beginning.unlink(missing_ok=True)
            raise write_error(self._path, error, KEPT) from error
        self.there.add(chunk)

    def clear(self) -> None:
        """Remove every chunk."""
        for chunk in self.there:
            self._file(chunk).unlink(missing_ok=True)
        self.there.clear()

    def close(self) -> None:
        """Let another process write; an empty folder goes."""
        if self._lock is not None:
            if not self.there:
                shutil.rmtree(self._folder, ignore_errors=True)
            os.close(self._lock)
            self._lock = None

    def _file(self, chunk: int) -> Path:
        return self._folder / f"{chunk:08d}{_SUFFIX}"


def write_error(path: Path, error: Exception, kept: str) -> LogWriteError:
    """Return why a file of a sweep cannot be written.

    Args:
        path: Path of the sweep's file.
        error: As it came.
        kept: What the failure leaves behind.
    """
    code = error.errno if isinstance(error, OSError) else None
    reason = os.strerror(code) if code else " ".join(str(error).split())
    if code in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
        return LogWriteError(f"{path}: the disk has no room for it ({reason}); make room, {kept}")
    return LogWriteError(f"{path}: cannot be written ({reason}); {kept}")
