"""Files that should be logs."""

from pathlib import Path
from typing import Final

from canhaptic.errors import LogFormatError

CONVERTIBLE: Final = frozenset({".blf", ".trc", ".asc"})
"""Suffixes of bus logs that python-can reads and writes."""


def log_file(path: str | Path) -> Path:
    """Returns the path of a file that is there and holds something.

    Raises:
        LogFormatError: It is not there, is a folder, or is empty.
    """
    path = Path(path)
    if not path.is_file():
        raise LogFormatError(f"{path}: {'is a folder, expected a log' if path.is_dir() else 'no such file'}")
    if path.stat().st_size == 0:
        raise LogFormatError(f"{path}: the file is empty")
    return path
