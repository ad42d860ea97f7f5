"""Store of a study: a folder with `study.json`, which describes the request, and one file for each finished chunk.

A file is written under another name, flushed to the disk and renamed, so that after a kill it exists completely or not
at all, and the study can be resumed. Disk space for all results is checked before anything runs.

The chunks of a sweep are NumPy archives of consecutive scenes (`SweepTable`):

KEY                    values of each scene: numbers in SI, or texts
AXIS/METRIC            figures; NaN where a metric does not apply
status, engine         indices in `STATUS` and `ENGINES` of `chunk`
remark                 0 for none, else 1 + index in texts
texts                  remarks of the chunk
"""

import errno
import io
import json
import os
import re
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import fields
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Self
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from canhaptic.errors import InputError, LogFormatError, LogWriteError
from canhaptic.files import read_regular
from canhaptic.lab.figures.figures import outcomes
from canhaptic.lab.loop.axis_loop import Array
from canhaptic.lab.studies import Row
from canhaptic.lab.studies.chunk import COMPLETED, ENGINES, STATUS, UNRENDERED, UNTOUCHED, ChunkResult
from canhaptic.lab.studies.vary import Column, Points, Varied
from canhaptic.quantities import figure_name

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


_SWEEP: Final = "sweep"
_BYTES: Final = 8  # of one figure
SLOTS: Final = 32
"""Largest number of different remarks in a chunk."""
MORE: Final = "more remarks than a chunk keeps; canhaptic check CONFIG --set with its values says which"


class SweepTable(Store):
    """The folder of a sweep: its scenes, and the figures computed so far.

    Args:
        path: Folder made by `create`.
        writable: Whether chunks will be written; only one process can write.

    Attributes:
        points: Scenes of the sweep.
        identity: Facts that a resumed sweep must match.
        chunk: Scenes per chunk.
        keys: Keys that vary, in the order given.
        axes: Names of the axes, in the order of the scene.
        metrics: Names of the figures, the same for every axis.

    Raises:
        LogFormatError: The folder holds no sweep, or one of a newer version.
        LogWriteError: Another process writes it.
    """

    def __init__(self, path: Path, *, writable: bool = False) -> None:
        super().__init__(path, _SWEEP, writable=writable)
        self.identity: Row = self.document["identity"]
        self.chunk = int(self.document["chunk"])
        if self.identity.get("samples"):
            raise LogFormatError(f"{path}: is a Latin hypercube of an earlier release, expected a grid; sweep again")
        self.points = _points(self.identity)
        self.keys = [one.key for one in self.points.varied]
        self.axes: list[str] = self.identity["axes"]
        self._stored = {
            figure_name(name): name for name in self.identity["metrics"]
        }  # those of earlier releases differ
        self.metrics = list(self._stored)

    def __len__(self) -> int:
        return len(self.points)

    def note(self, name: str) -> str:
        """Return a note on the sweep by name; "" if there is none."""
        return str(self.document["notes"].get(name, ""))

    def done(self) -> NDArray[np.bool_]:
        """Return which chunks exist, shape (n_chunks,)."""
        flags = np.zeros(-(-len(self) // self.chunk), dtype=bool)
        flags[[int(name.partition(".")[0]) for name in self.chunks]] = True
        return flags

    def span(self, chunk: int) -> tuple[int, int]:
        """Return the indices [start, stop) of the scenes of a chunk."""
        return chunk * self.chunk, min(len(self), (chunk + 1) * self.chunk)

    def finished(self) -> int:
        """Return the number of scenes in chunks that exist."""
        return sum(stop - start for start, stop in map(self.span, np.flatnonzero(self.done()).tolist()))

    def values(self, key: str) -> Column:
        """Return the values of a key: numbers in SI of shape (n,), or a list of texts."""
        return self.points.columns(0, len(self))[key]

    def figure(self, axis: str, metric: str) -> Array:
        """Return a figure of every scene, shape (n,); NaN where it does not apply or is not computed yet."""
        metric = figure_name(metric)
        return self._column(f"{axis}/{self._stored.get(metric, metric)}", np.full(len(self), np.nan))

    def status(self, axis: str = "") -> NDArray[np.uint8]:
        """Return the status of every scene, for one axis or for all, as indices in `STATUS`, shape (n,)."""

        def outcome(name: str) -> Any:
            return outcomes(lambda metric: self.figure(name, metric) if metric in self.metrics else np.nan)

        status = self._column("status", np.zeros(len(self), dtype=np.uint8))
        found = np.stack([outcome(name) for name in ([axis] if axis else self.axes)])
        # completed scenes in which no axis was touched and rendered say nothing about passivity
        marks = np.where((found == 0).any(axis=0), 0, found.max(axis=0))
        return np.where(status == COMPLETED, np.array([COMPLETED, UNTOUCHED, UNRENDERED], np.uint8)[marks], status)

    def engine(self) -> NDArray[np.uint8]:
        """Return the engine of every scene as indices in `ENGINES`, shape (n,)."""
        return self._column("engine", np.zeros(len(self), dtype=np.uint8))

    def remark(self, scene: int) -> str:
        """Return the remark on a scene: why it was refused or ran alone, or which properties came from the plant."""
        texts, numbers = self._read(scene // self.chunk, "texts", "remark")
        number = int(numbers[scene % self.chunk])
        return str(texts[number - 1]) if number else ""

    def remarks(self) -> Iterator[tuple[str, str, str, int]]:
        """Yield (status, engine, remark, number of scenes), chunk by chunk, with equal scenes counted together."""
        ended, engines = self.status(), self.engine()
        for chunk in np.flatnonzero(self.done()).tolist():
            (texts, numbers), rows = self._read(chunk, "texts", "remark"), slice(*self.span(chunk))
            kinds, counts = np.unique(np.stack([ended[rows], engines[rows], numbers]), axis=1, return_counts=True)
            for (status, engine, number), count in zip(kinds.T.tolist(), counts.tolist(), strict=True):
                yield STATUS[status], ENGINES[engine], str(texts[number - 1]) if number else "", count

    def store(self, chunk: int, result: ChunkResult) -> None:
        """Store a chunk; it is on the disk on return.

        Raises:
            LogWriteError: The chunk cannot be written; finished chunks are kept.
        """
        columns: dict[str, Any] = {**self.points.columns(*self.span(chunk)), **result.figures}
        texts, numbers = numbered(result.remark.tolist())
        columns |= {"status": result.status, "engine": result.engine, "remark": np.array(numbers, dtype=np.uint8)}
        content = io.BytesIO()
        np.savez(content, **columns, texts=np.array(texts, dtype=np.str_))
        self.write(_name(chunk), content.getvalue())

    def _column(self, name: str, found: NDArray[Any]) -> NDArray[Any]:
        """Fill a column with the rows of the finished chunks, and return it."""
        for chunk in np.flatnonzero(self.done()).tolist():
            (found[slice(*self.span(chunk))],) = self._read(chunk, name)
        return found

    def _read(self, chunk: int, *names: str) -> list[NDArray[Any]]:
        """Return arrays of a chunk.

        Raises:
            LogFormatError: The chunk is damaged or missing.
        """
        path = self.folder / _name(chunk)
        try:
            with np.load(path, allow_pickle=False) as found:
                return [np.asarray(found[name]) for name in names]
        except (OSError, ValueError, KeyError, BadZipFile) as error:
            raise LogFormatError(f"{path}: cannot be read ({error}); remove it and --resume") from error


def numbered(remarks: Sequence[str]) -> tuple[list[str], list[int]]:
    """Return the different remarks of a chunk, and the number of each scene's: 0 for none, else 1 + its index.

    At most `SLOTS` are kept; the others share the last number.
    """
    texts = list(dict.fromkeys(filter(None, remarks)))
    if len(texts) > SLOTS:
        texts[SLOTS - 1 :] = [MORE]
    numbers = {text: number for number, text in enumerate(["", *texts])}
    return texts, [numbers.get(remark, SLOTS) for remark in remarks]


def create(path: Path, chunk: int, identity: Row, notes: dict[str, str], *, replace: bool) -> None:
    """Create the folder of a sweep, without results; it appears completely or not at all.

    Args:
        path: Folder.
        chunk: Scenes per chunk.
        identity: Facts that a resumed sweep must match.
        notes: Texts about the sweep.
        replace: Whether to replace an existing sweep.

    Raises:
        InputError: The folder exists already.
        LogWriteError: The folder is missing or read-only, the disk is too small for all results, or another process
            writes it.
    """
    columns = len(identity["axes"]) * len(identity["metrics"]) + len(identity["varied"])
    room = len(_points(identity)) * (_BYTES * columns + 3)
    document = {"identity": identity, "chunk": chunk, "notes": notes}
    create_store(path, _SWEEP, document, room=room, replace=replace)


def _points(identity: Row) -> Points:
    keys = [field.name for field in fields(Varied)]
    varied = ({key: one[key] for key in keys} | {"values": tuple(one["values"])} for one in identity["varied"])
    return Points(tuple(Varied(**one) for one in varied))


def _name(chunk: int) -> str:
    return f"{chunk:08d}.npz"
