"""Files of logs: an existing one to read, and one that grows and is watched, since it may be deleted meanwhile."""

import errno
import os
import re
import stat
from pathlib import Path
from typing import Final

from canhaptic.errors import LogFormatError, LogWriteError
from canhaptic.input_file import require_regular

CONVERTIBLE: Final = frozenset({".blf", ".trc", ".asc"})
"""Suffixes of bus logs that python-can reads and writes."""
NO_SPACE: Final = "no space"
_FULL: Final = (errno.ENOSPC, errno.EFBIG, errno.EDQUOT)
_REMEDY: Final = "the rows from then on are lost; keep other programs away from a log while it is written"


def log_file(path: str | Path) -> Path:
    """Path of an existing, non-empty file.

    Raises:
        LogFormatError: It does not exist, is no regular file, or is empty.
    """
    path = Path(path)
    try:
        found = require_regular(path)
    except OSError as error:
        raise LogFormatError(f"{path}: {error.strerror}, expected a log of a run") from error
    if found.st_size == 0:
        raise LogFormatError(f"{path}: the file is empty, expected a log of a run")
    return path


class LogSink:
    """Destination of the records of a shared area.

    Args:
        path: The file.
    """

    _descriptor = -1  # of the file, where it grows
    _size = 0  # bytes written to it

    def __init__(self, path: Path) -> None:
        self._path = path

    def open(self, restart: bool) -> None:
        """Prepare the file; after a restart, continue the one that a killed writer left."""

    def drain(self, heads: list[int], final: bool) -> None:
        """Write records up to `heads`; may keep an incomplete block for later unless `final`."""

    def check(self) -> None:
        """Require that a growing file is still the opened one, with its written length.

        Raises:
            LogWriteError: It was deleted, replaced or truncated.
        """
        if self._descriptor < 0:
            return
        path, opened = self._path, os.fstat(self._descriptor)
        try:
            is_same = os.path.samestat(opened, os.stat(path, follow_symlinks=False))
        except FileNotFoundError:
            is_same = False
        if not is_same:
            raise LogWriteError(f"{path}: was deleted or replaced while it was written; {_REMEDY}")
        if opened.st_size < self._size:
            raise LogWriteError(
                f"{path}: was truncated to {opened.st_size} of {self._size} bytes while it was written; {_REMEDY}"
            )

    def finish(self, status: str) -> None:
        """Complete and close the file."""

    def fail(self, cause: str) -> None:
        """Note in the file, if it has room, why it ends before the run."""


def open_regular(path: Path, flags: int) -> int:
    """Return a descriptor of a regular file; neither a symbolic link nor a pipe is opened.

    Raises:
        LogWriteError: It is something else.
        OSError: It cannot be opened.
    """
    descriptor = os.open(path, flags | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC, 0o666)
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise LogWriteError(f"{path}: is not a regular file; name another file")
    return descriptor


def cause_of(error: Exception) -> str:
    """Return briefly why a file could not be written; HDF5 gives the system's error number only in its text."""
    found = re.search(r"\[Errno (\d+)\]|errno = (\d+)", str(error))
    number = int(found[1] or found[2]) if found else 0
    return NO_SPACE if number in _FULL else os.strerror(number) if number else str(error)
