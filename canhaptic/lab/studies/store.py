"""Store of a study: a folder with `study.json`, which describes the request, and one file for each finished chunk.

A file is written under another name, flushed to the disk and renamed, so that after a kill it exists completely or not
at all, and the study can be resumed. Disk space for all results is checked before anything runs.
"""

import errno
import json
import os
import re
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Final, Self

from canhaptic.errors import InputError, LogFormatError, LogWriteError
from canhaptic.files import read_regular
from canhaptic.lab.studies import Row

_LARGEST: Final = 1_000_000_000  # [B] of one file
_NAME: Final = "study.json"
_CHUNK: Final = re.compile(r"\d{8}\.npz|[0-9a-f]{32}\.json")
_VERSION: Final = 2
_KEPT: Final = {"sweep": "finished work is kept; continue with --resume"}
_GOES_ON: Final = "finished work is kept; continue with the same command"
_ROOM_OF_LAYOUT: Final = 1 << 20
"""Disk space reserved for names and remarks [bytes]."""


class Store:
    """The open folder of a study: its request, and its finished chunks.

    Args:
        folder: Folder made by `create_store`.
        kind: Kind of the study, "sweep" or "arena".
        writable: Whether chunks will be written; only one process can write.

    Attributes:
        document: The request, as plain values.
        chunks: Names of the finished chunks.

    Raises:
        LogFormatError: The folder is no store, or holds another kind of study or a newer version.
        LogWriteError: Another process writes it.
    """

    def __init__(self, folder: Path, kind: str, *, writable: bool = False) -> None:
        self.folder, self._kept = folder, _KEPT.get(kind, _GOES_ON)
        self.document = _document(folder, kind)
        self._lock = _locked(folder) if writable else None
        self.chunks = {name.name for name in folder.iterdir() if _CHUNK.fullmatch(name.name)}

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Release the folder for other processes."""
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None

    def write(self, chunk: str, content: bytes) -> None:
        """Write a chunk; it is on the disk on return.

        Raises:
            LogWriteError: The chunk cannot be written, or the store is read-only; finished chunks are kept.
        """
        if self._lock is None:
            raise LogWriteError(f"{self.folder}: is open for reading only; open it with writable=True")
        _write(self.folder, chunk, content, self._kept)
        self.chunks.add(chunk)


def create_store(folder: Path, kind: str, document: Row, *, room: int = 0, replace: bool = False) -> None:
    """Create an empty store; it appears completely or not at all.

    Args:
        folder: Folder to create; its parent must exist.
        kind: Kind of the study.
        document: The request, as plain values.
        room: Size of all results [bytes].
        replace: Whether to replace an existing store.

    Raises:
        InputError: The store exists already.
        LogWriteError: The folder cannot be created, the disk is too small for all results, or another process writes
            it.
    """
    if folder.is_file():
        raise InputError(f"{folder}: is a file, expected a folder of results; give another --out")
    if (folder / _NAME).exists() and not replace:
        raise InputError(f"{folder} already exists; --resume continues it, --force replaces it")
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise _write_error(folder, error, "nothing has been run") from error
    lock = _locked(folder)
    try:
        content = json.dumps({"format": f"canhaptic {kind}", "format_version": _VERSION, **document}, indent=1)
        for earlier in [path for path in folder.iterdir() if _CHUNK.fullmatch(path.name)]:
            earlier.unlink()  # of a study that is replaced, or whose document is gone
        _write(folder, _NAME, content.encode(), "nothing has been run", room=room)
    finally:
        os.close(lock)
        with suppress(OSError):
            folder.rmdir()  # where nothing came into it


def _document(folder: Path, kind: str) -> Row:
    try:
        found: Row = json.loads(read_regular(folder / _NAME, _LARGEST))
        version = found.get("format_version", 0)
    except (OSError, ValueError, AttributeError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise LogFormatError(
            f"{folder}: cannot be read as a {kind} ({reason}); give a folder made by canhaptic {kind}"
        ) from error
    if found.get("format") != f"canhaptic {kind}" or version > _VERSION:
        there = found.get("format", "no study of canhaptic")
        raise LogFormatError(f"{folder}: is {there!r} version {version}, expected 'canhaptic {kind}' up to {_VERSION}")
    return found


def _locked(folder: Path) -> int:
    import fcntl  # not on Windows

    descriptor = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        os.close(descriptor)
        raise LogWriteError(f"{folder}: another study writes it; wait for its end, or give another --out") from error
    return descriptor


def _write(folder: Path, name: str, content: bytes, kept: str, room: int = 0) -> None:
    path, beginning = folder / name, folder / f"{name}.part"
    try:
        with beginning.open("wb") as file:
            if room:  # asks the disk for all of it, before anything runs
                os.posix_fallocate(file.fileno(), 0, room + _ROOM_OF_LAYOUT)
                file.truncate(0)
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        beginning.replace(path)
    except OSError as error:
        with suppress(OSError):
            beginning.unlink(missing_ok=True)
        raise _write_error(folder, error, kept) from error


def _write_error(path: Path, error: OSError, kept: str) -> LogWriteError:
    reason = os.strerror(error.errno) if error.errno else str(error)
    if error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
        return LogWriteError(f"{path}: the disk has no room for it ({reason}); make room, {kept}")
    return LogWriteError(f"{path}: cannot be written ({reason}); {kept}")
