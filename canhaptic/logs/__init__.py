"""Energy log and bus log: written in the cycle, read afterwards."""

from pathlib import Path

from canhaptic.errors import LogFormatError, LogMissingError
from canhaptic.files import require_regular


def log_file(path: str | Path) -> Path:
    """Return the path of an existing, non-empty log.

    Raises:
        LogFormatError: The file does not exist, is not regular, or is empty.
    """
    path = Path(path)
    try:
        found = require_regular(path)
    except OSError as error:
        kind = LogMissingError if isinstance(error, FileNotFoundError) else LogFormatError
        raise kind(f"{path}: {error.strerror}, expected a log of a run") from error
    if found.st_size == 0:
        raise LogFormatError(f"{path}: the file is empty, expected a log of a run")
    return path
