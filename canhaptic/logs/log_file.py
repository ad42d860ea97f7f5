"""Validation of the path of a log."""

from pathlib import Path
from typing import Final

from canhaptic.errors import LogFormatError
from canhaptic.input_file import require_regular

CONVERTIBLE: Final = frozenset({".blf", ".trc", ".asc"})
"""Suffixes of bus logs that python-can reads and writes."""


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
