"""Files that should be logs."""

from os.path import isdir, isfile
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
    if not isfile(path):  # False for what no path can be, too
        raise LogFormatError(f"{path}: {'is a folder' if isdir(path) else 'no such file'}, expected a log of a run")
    if path.stat().st_size == 0:
        raise LogFormatError(f"{path}: the file is empty, expected a log of a run")
    return path
