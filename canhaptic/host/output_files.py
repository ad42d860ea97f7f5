"""Writing of output files: a file must be regular or new, and it is replaced as a whole or not at all.

Symbolic links are not followed.
"""

import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from canhaptic.errors import InputError
from canhaptic.files import kind_of


def why_not_written(path: Path) -> str:
    """Return why a path cannot be written; "" if it is free or a regular file."""
    try:
        mode = path.lstat().st_mode
    except FileNotFoundError:
        return ""
    except OSError as error:
        return f"{path}: {error.strerror}; choose a folder that exists and may be written"
    kind = kind_of(mode)
    return f"{path}: is {kind}, expected a regular file or none; name another file" if kind else ""


def require_writable_place(path: Path) -> None:
    """Refuse a path that is neither free nor a regular file.

    Raises:
        InputError: The path is a folder, a link, a device or the like.
    """
    if reason := why_not_written(path):
        raise InputError(reason)


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a new, empty file in the folder of `path`; it replaces `path` if the block ends well.

    Raises:
        InputError: `path` is neither free nor a regular file.
        OSError: The new file cannot be created.
    """
    require_writable_place(path)
    temporary = path.with_name(f".{path.stem}.{secrets.token_hex(8)}{path.suffix}")
    os.close(os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666))
    try:
        yield temporary
        os.replace(temporary, path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise
