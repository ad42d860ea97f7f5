"""Input files of a command: regular ones alone, since a pipe or a device has no end, and of a bounded size."""

import errno
import os
import stat
from pathlib import Path
from typing import Final

_KINDS: Final = (
    (stat.S_ISLNK, "a symbolic link"),
    (stat.S_ISDIR, "a folder"),
    (stat.S_ISFIFO, "a pipe"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
)


def kind_of(mode: int) -> str:
    """Kind of a file that is not regular; empty for a regular file."""
    if stat.S_ISREG(mode):
        return ""
    return next((name for is_kind, name in _KINDS if is_kind(mode)), "no file")


def require_regular(path: str | Path) -> os.stat_result:
    """Status of a regular file, reached directly or through a symbolic link.

    Raises:
        OSError: It does not exist or is not regular; `strerror` says which.
    """
    try:
        found = os.stat(path)
    except FileNotFoundError as error:
        raise FileNotFoundError(error.errno, "no such file", str(path)) from error
    except ValueError as error:  # a text that no path can be
        raise OSError(errno.EINVAL, str(error), str(path)) from error
    if kind := kind_of(found.st_mode):
        raise OSError(errno.EINVAL, f"is {kind}", str(path))
    return found


def read_regular(path: str | Path, most: int) -> bytes:
    """Return the content of a regular file.

    Args:
        path: Path of the file.
        most: Largest accepted size [bytes].

    Raises:
        OSError: It is no regular file, holds more, or cannot be read; `strerror` says which.
    """
    require_regular(path)
    with open(path, "rb") as file:
        content = file.read(most + 1)
    if len(content) > most:
        raise OSError(errno.EFBIG, f"larger than {most} bytes", str(path))
    return content
