"""The file of a sweep: HDF5 with every value of every scene, and its results.

    /values/KEY            values of each scene: numbers in SI, or the index of a text in the attribute `texts`
    /figures/AXIS/METRIC   results; NaN where there is none
    /status /engine        see `STATUS`, `ENGINES` of `chunk`
    /remark /texts         one more than the index among the texts of the scene's chunk; 0 for none
    /done                  one flag per chunk

Chunks are files of their own until a run ends; then all of them are merged into a new file, which
replaces the old one by a rename. A reader sees merged and unmerged chunks. Room for all results
is checked before a scene runs, and before each merge: HDF5 crashes where a disk is full.

The chunks of a sweep that are not in its file yet: one file each, in the folder FILE.chunks.

A chunk is written to a new file, flushed to the disk and renamed into place: after a kill at any moment it exists
completely, or not at all.
"""

import errno
import json
import os
import shutil
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Final, NamedTuple, Self
from zipfile import BadZipFile

import h5py
import numpy as np
from numpy.typing import NDArray

from canhaptic.errors import InputError, LogFormatError, LogWriteError
from canhaptic.input_file import require_regular
from canhaptic.lab.loop.axis_loop import Array
from canhaptic.lab.studies import Row
from canhaptic.lab.studies.sweep.chunk import ENGINES, SLOTS, STATUS, ChunkResult
from canhaptic.lab.studies.sweep.vary import Column, Points
from canhaptic.logs import hdf5

Columns = dict[str, hdf5.Array]
"""Path of a column in the file of the sweep -> its part in a chunk."""

KEPT: Final = "what was finished is kept, --resume goes on"
_SUFFIX: Final = ".npz"


class ChunkFiles:
    """The folder of a sweep.

    Args:
        path: Path of the sweep's file.
        writable: Whether chunks will be written; only one process can.

    Attributes:
        there: Numbers of the chunks in the folder.

    Raises:
        LogWriteError: Another process writes it, or it cannot be made.
    """

    def __init__(self, path: Path, *, writable: bool = False) -> None:
        self._path, self._folder = path, path.with_name(f"{path.name}.chunks")
        self._lock: int | None = None
        if writable:
            self._lock = self._locked()
        found = self._folder.glob(f"*{_SUFFIX}") if self._folder.is_dir() else ()
        self.there = {int(name.stem) for name in found if name.stem.isdigit()}

    def _locked(self) -> int:
        import fcntl  # not on Windows

        try:
            self._folder.mkdir(exist_ok=True)
            descriptor = os.open(self._folder, os.O_RDONLY)
        except OSError as error:
            raise write_error(self._path, error, KEPT) from error
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            os.close(descriptor)
            raise LogWriteError(
                f"{self._path}: another sweep writes it; wait for its end, or give another --out"
            ) from error
        return descriptor

    def read(self, chunk: int, column: str) -> hdf5.Array:
        """Return a column of a chunk.

        Raises:
            LogFormatError: The file is damaged, or was merged while it was read.
        """
        path = self._file(chunk)
        try:
            with np.load(path, allow_pickle=False) as found:
                return np.asarray(found[column])
        except (OSError, ValueError, KeyError, BadZipFile) as error:
            raise LogFormatError(
                f"{path}: cannot be read ({error}); read again where the sweep still runs, else remove it and --resume"
            ) from error

    def write(self, chunk: int, columns: Columns) -> None:
        """Write a chunk.

        Raises:
            LogWriteError: The disk refuses, or the table is open for reading only; what was finished before stays.
        """
        if self._lock is None:
            raise LogWriteError(f"{self._path}: is open for reading only; open it with writable=True")
        path = self._file(chunk)
        beginning = path.with_suffix(".part")
        try:
            with beginning.open("wb") as file:
                np.savez(file, **columns)  # type: ignore[arg-type]
                file.flush()
                os.fsync(file.fileno())
            beginning.replace(path)
        except OSError as error:
            with suppress(OSError):
                beginning.unlink(missing_ok=True)
            raise write_error(self._path, error, KEPT) from error
        self.there.add(chunk)

    def clear(self) -> None:
        """Remove every chunk."""
        for chunk in self.there:
            self._file(chunk).unlink(missing_ok=True)
        self.there.clear()

    def close(self) -> None:
        """Release the folder for other processes; an empty one is removed."""
        if self._lock is not None:
            if not self.there:
                shutil.rmtree(self._folder, ignore_errors=True)
            os.close(self._lock)
            self._lock = None

    def _file(self, chunk: int) -> Path:
        return self._folder / f"{chunk:08d}{_SUFFIX}"


def write_error(path: Path, error: Exception, kept: str) -> LogWriteError:
    """Return the error for a sweep file that cannot be written.

    Args:
        path: Path of the sweep's file.
        error: Error of the operating system or of HDF5.
        kept: What remains after the failure, in words.
    """
    code = error.errno if isinstance(error, OSError) else None
    reason = os.strerror(code) if code else " ".join(str(error).split())
    if code in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
        return LogWriteError(f"{path}: the disk has no room for it ({reason}); make room, {kept}")
    return LogWriteError(f"{path}: cannot be written ({reason}); {kept}")


_FORMAT: Final = "canhaptic sweep"
_VERSION: Final = 1
_TEXT_BYTES: Final = 320
_NOTHING_RUN: Final = "nothing has been run"
_ROOM_OF_LAYOUT: Final = 1 << 20
"""Least room for names, attributes and remarks [bytes]."""
_BLOCK: Final = 65_536
"""Rows written at once when a file is made."""


class Columnset(NamedTuple):
    """Contents of a new file in addition to its values."""

    figures: tuple[str, ...]  # "AXIS/METRIC"
    identity: Row  # what a resumed sweep must agree with
    notes: dict[str, str]  # further attributes, texts


class SweepTable:
    """An open file of a sweep.

    Args:
        path: Path of a file made by `create`.
        writable: Whether chunks will be written; only one process can.

    Raises:
        LogFormatError: It is none, or of a newer version.
        LogWriteError: Another process writes it.
    """

    def __init__(self, path: Path, *, writable: bool = False) -> None:
        self.path = path
        self._file = _opened(path)
        self._chunks = ChunkFiles(path, writable=writable)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the file."""
        self._chunks.close()
        self._file.close()

    def __len__(self) -> int:
        return int(self._file["status"].shape[0])

    @property
    def chunk(self) -> int:
        """Scenes per chunk."""
        return int(self._file.attrs["chunk"])

    @property
    def identity(self) -> Row:
        """Identity of the sweep."""
        found: Row = json.loads(self._file.attrs["identity"])
        return found

    def note(self, name: str) -> str:
        """Return a text attribute; "" when there is none."""
        return str(self._file.attrs.get(name, ""))

    @property
    def keys(self) -> list[str]:
        """Keys that vary, in the order given."""
        return [str(varied["key"]) for varied in self.identity["varied"]]

    @property
    def axes(self) -> list[str]:
        """Names of the axes, in the order of the scene."""
        return [str(name) for name in self.identity["axes"]]

    @property
    def metrics(self) -> list[str]:
        """Names of the figures, the same for every axis."""
        return [str(name) for name in self.identity["metrics"]]

    def done(self) -> NDArray[np.bool_]:
        """Return which chunks exist, shape (n_chunks,)."""
        flags = np.asarray(self._file["done"]).astype(bool)
        flags[sorted(self._chunks.there)] = True
        return flags

    def span(self, chunk: int) -> tuple[int, int]:
        """Return the index of the first scene of a chunk, and one beyond the last."""
        return chunk * self.chunk, min(len(self), (chunk + 1) * self.chunk)

    def values(self, key: str, start: int = 0, stop: int | None = None) -> Column:
        """Return the values of a key: numbers in SI of shape (n,), or a list of texts."""
        dataset = self._file[f"values/{_name(key)}"]
        found = np.asarray(dataset[start:stop])
        texts = dataset.attrs.get("texts")
        if texts is None:
            return found
        known = json.loads(texts)
        return [known[i] for i in found.tolist()]

    def texts(self, key: str) -> list[str]:
        """Return the possible texts of a key; `numbers` are indices into them."""
        return [str(text) for text in json.loads(self._file[f"values/{_name(key)}"].attrs["texts"])]

    def numbers(self, key: str, start: int = 0, stop: int | None = None) -> hdf5.Array:
        """Return the index of every scene's text for a key with text values, shape (n,)."""
        return np.asarray(self._file[f"values/{_name(key)}"][start:stop])

    def columns(self, start: int, stop: int) -> dict[str, Column]:
        """Return the values of some scenes by key."""
        return {key: self.values(key, start, stop) for key in self.keys}

    def figure(self, axis: str, metric: str, start: int = 0, stop: int | None = None) -> Array:
        """Return a figure of every scene, NaN where there is none, shape (n,)."""
        return self._column(f"figures/{_name(axis)}/{metric}", start, stop)

    def status(self, start: int = 0, stop: int | None = None) -> NDArray[np.uint8]:
        """Return the status of every scene, an index in `STATUS`, shape (n,)."""
        return self._column("status", start, stop)

    def engine(self, start: int = 0, stop: int | None = None) -> NDArray[np.uint8]:
        """Return the engine of every scene, an index in `ENGINES`, shape (n,)."""
        return self._column("engine", start, stop)

    def remark(self, scene: int) -> str:
        """Return why a scene was refused or ran alone, or which values its algorithm took from the plant."""
        number = int(self._column("remark", scene, scene + 1)[0])
        return self._texts(scene // self.chunk)[number - 1] if number else ""

    def remarks(self) -> Iterator[tuple[str, str, str, int]]:
        """Yield (status, engine, remark, number of scenes) of each chunk in turn, equal ones counted together."""
        for chunk in np.flatnonzero(self.done()).tolist():
            start, stop = self.span(chunk)
            rows = np.stack([self.status(start, stop), self.engine(start, stop), self._column("remark", start, stop)])
            texts = self._texts(chunk)
            kinds, counts = np.unique(rows, axis=1, return_counts=True)
            for (status, engine, number), count in zip(kinds.T.tolist(), counts.tolist(), strict=True):
                yield STATUS[status], ENGINES[engine], texts[number - 1] if number else "", count

    def write(self, chunk: int, result: ChunkResult) -> None:
        """Store a chunk; it is on the disk on return.

        Raises:
            LogWriteError: The disk refuses; what was finished before stays.
        """
        columns: dict[str, hdf5.Array] = {_path_of(name): values for name, values in result.figures.items()}
        columns |= {"status": result.status, "engine": result.engine, "remark": result.remark}
        texts = np.zeros(SLOTS, dtype=f"S{_TEXT_BYTES}")
        texts[: len(result.texts)] = [_cut(text) for text in result.texts]
        self._chunks.write(chunk, columns | {"texts": texts, "done": np.ones(1, dtype=np.uint8)})

    def merge(self) -> None:
        """Bring every chunk into the file.

        Raises:
            LogWriteError: The disk refuses; the chunks stay.
        """
        if not self._chunks.there:
            return
        names: list[str] = []
        self._file.visititems(lambda name, item: names.append(name) if isinstance(item, h5py.Dataset) else None)
        size = sum(self._file[name].size * self._file[name].dtype.itemsize for name in names)
        with _Beginning(self.path, size, KEPT) as beginning, _made(beginning) as file:
            _copy_attributes(self._file, file)
            for name in names:
                _copy_attributes(self._file[name], file.create_dataset(name, data=self._column(name)))
        self._file.close()
        self._file = _opened(self.path)
        self._chunks.clear()

    def _column(self, path: str, start: int = 0, stop: int | None = None) -> hdf5.Array:
        """Return a column, with what is not merged yet."""
        found = np.asarray(self._file[path][start:stop])
        places = {"texts": SLOTS, "done": 1}.get(path, self.chunk)  # of a chunk
        if path.startswith("values/") or not self._chunks.there:
            return found
        for chunk in range(start // places, -(-(start + len(found)) // places)):
            if chunk in self._chunks.there:
                first = chunk * places
                low, high = max(start, first), min(start + len(found), first + places)
                found[low - start : high - start] = self._chunks.read(chunk, path)[low - first : high - first]
        return found

    def _texts(self, chunk: int) -> list[str]:
        raw = self._column("texts", chunk * SLOTS, (chunk + 1) * SLOTS)
        return [bytes(text).decode("utf-8", "replace") for text in raw]


class _Beginning:
    """A file made next to another, which it replaces once it is whole and on the disk; deleted otherwise.

    Args:
        path: Path of the other file.
        size: Size of its columns [bytes].
        kept: What a failure leaves behind, for messages.
    """

    def __init__(self, path: Path, size: int, kept: str) -> None:
        self._path, self._size, self._kept = path, size, kept
        self._beginning = path.with_name(f".{path.name}.{os.getpid()}")

    def __enter__(self) -> Path:
        try:
            _reserve(self._beginning, self._size)
        except OSError as error:
            self._beginning.unlink(missing_ok=True)
            raise write_error(self._path, error, self._kept) from error
        return self._beginning

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if error is None:
                _flush(self._beginning)
                self._beginning.replace(self._path)
        except OSError as failed:
            raise write_error(self._path, failed, self._kept) from failed
        finally:
            self._beginning.unlink(missing_ok=True)
        if isinstance(error, OSError | RuntimeError) and not isinstance(error, LogWriteError):
            raise write_error(self._path, error, self._kept) from error


def create(path: Path, points: Points, chunk: int, columns: Columnset, *, replace: bool = False) -> None:
    """Create the file of a sweep with every value in it and no result; it appears completely or not at all.

    Raises:
        InputError: It exists.
        LogWriteError: The folder is missing or read-only, the disk is too small for all results, or another process
            writes it.
    """
    if path.exists() and not replace:
        raise InputError(f"{path} already exists; --resume continues it, --force replaces it")
    size = len(points) * (8 * (len(columns.figures) + len(points.varied)) + 3)
    with _Beginning(path, size, _NOTHING_RUN) as beginning, _made(beginning) as file:
        _lay_out(file, points, chunk, columns)
        earlier = ChunkFiles(path, writable=True)  # of a sweep that is replaced, or whose file is gone
        earlier.clear()
        earlier.close()


def _reserve(path: Path, size: int) -> None:
    """Ask the disk for the room of the whole file, before HDF5 would learn that there is none."""
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_TRUNC, 0o666)
    try:
        os.posix_fallocate(descriptor, 0, size + _ROOM_OF_LAYOUT)
    finally:
        os.close(descriptor)


def _flush(path: Path) -> None:
    descriptor = os.open(path, os.O_RDWR)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _made(path: Path) -> h5py.File:
    return h5py.File(path, "w", libver=("earliest", "v110"), locking=False)


def _copy_attributes(source: h5py.Group, target: h5py.Group) -> None:
    for name in sorted(source.attrs):
        target.attrs[name] = source.attrs[name]


def _lay_out(file: h5py.File, points: Points, chunk: int, columns: Columnset) -> None:
    """Make all columns: the values, and empty ones for the results, which take no room yet."""
    count, chunks = len(points), -(-len(points) // chunk)
    file.attrs["format"], file.attrs["format_version"], file.attrs["chunk"] = _FORMAT, _VERSION, chunk
    file.attrs["identity"] = json.dumps(columns.identity, sort_keys=True)
    for name, text in columns.notes.items():
        file.attrs[name] = text
    for figure in columns.figures:
        file.create_dataset(_path_of(figure), (count,), dtype="<f8", fillvalue=np.nan)
    for name in ("status", "engine", "remark"):
        file.create_dataset(name, (count,), dtype="u1")
    file["status"].attrs["names"], file["engine"].attrs["names"] = json.dumps(STATUS), json.dumps(ENGINES)
    file.create_dataset("texts", (chunks * SLOTS,), dtype=f"S{_TEXT_BYTES}")
    file.create_dataset("done", (chunks,), dtype="u1")
    for varied in points.varied:
        dtype = "<f8" if varied.is_number else "<i4"
        dataset = file.create_dataset(f"values/{_name(varied.key)}", (count,), dtype=dtype)
        if not varied.is_number:
            dataset.attrs["texts"] = json.dumps([varied.yaml(value) for value in varied.values])
    _write_values(file, points)


def _write_values(file: h5py.File, points: Points) -> None:
    for start in range(0, len(points), _BLOCK):
        stop = min(len(points), start + _BLOCK)
        for (key, column), varied in zip(points.columns(start, stop).items(), points.varied, strict=True):
            numbers = {value: number for number, value in enumerate(varied.values)}
            values = column if isinstance(column, np.ndarray) else [numbers[value] for value in column]
            file[f"values/{_name(key)}"][start:stop] = np.asarray(values)


def _opened(path: Path) -> h5py.File:
    try:
        require_regular(path)
        file = h5py.File(path, "r", locking=False)
    except (OSError, RuntimeError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise LogFormatError(
            f"{path}: cannot be read as a sweep ({reason}); give a file made by canhaptic sweep"
        ) from error
    version = file.attrs.get("format_version", 0)
    if file.attrs.get("format") != _FORMAT or version > _VERSION:
        found = file.attrs.get("format", "no canhaptic sweep")
        file.close()
        raise LogFormatError(f"{path}: is {found!r} version {version}, expected {_FORMAT!r} up to {_VERSION}")
    return file


def _name(key: str) -> str:
    """Return a name without the separator of HDF5."""
    return key.replace("/", "\u2215")


def _path_of(figure: str) -> str:
    axis, _, metric = figure.rpartition("/")
    return f"figures/{_name(axis)}/{metric}"


def _cut(text: str) -> bytes:
    """Return a text that fits its slot, whole letters only."""
    return text.encode()[:_TEXT_BYTES].decode("utf-8", "ignore").encode()
