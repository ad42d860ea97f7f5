"""A log that grows: opened as a regular file, and watched, since it may be deleted or truncated meanwhile."""

import errno
import os
import re
import stat
from pathlib import Path
from typing import Final

from canhaptic.errors import LogWriteError

NO_SPACE: Final = "no space"
_FULL: Final = (errno.ENOSPC, errno.EFBIG, errno.EDQUOT)
_REMEDY: Final = "the rows from then on are lost; keep other programs away from a log while it is written"


class LogSink:
    """Destination of the records of a shared area."""

    def open(self, restart: bool) -> None:
        """Prepare the file; after a restart, continue the one that a killed writer left."""

    def drain(self, heads: list[int], final: bool) -> None:
        """Write records up to `heads`; may keep an incomplete block for later unless `final`."""

    def check(self) -> None:
        """Return while the file is as it was written; raise LogWriteError."""

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


def require_same_file(path: Path, descriptor: int, size: int) -> None:
    """Require that a log is still the opened file, with its written length.

    Args:
        path: The log.
        descriptor: Descriptor of the file that was opened.
        size: Number of bytes written to it.

    Raises:
        LogWriteError: It was deleted, replaced or truncated.
    """
    opened = os.fstat(descriptor)
    try:
        is_same = os.path.samestat(opened, os.stat(path, follow_symlinks=False))
    except FileNotFoundError:
        is_same = False
    if not is_same:
        raise LogWriteError(f"{path}: was deleted or replaced while it was written; {_REMEDY}")
    if opened.st_size < size:
        raise LogWriteError(
            f"{path}: was truncated to {opened.st_size} of {size} bytes while it was written; {_REMEDY}"
        )
