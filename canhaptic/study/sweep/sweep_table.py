"""The file of a sweep: HDF5 with a layout that is fixed before the first scene runs.

    /values/KEY            what each scene had: numbers in SI, or the index of a text in the attribute `texts`
    /figures/AXIS/METRIC   what it gave; NaN where there is nothing
    /status /engine        see `STATUS`, `ENGINES` of `chunk`
    /remark /texts         one more than the index among the texts of the scene's chunk; 0 for none
    /done                  one flag per chunk

Every byte is laid out, filled and on the disk before a scene runs, so that a disk that is too small says so at once.
HDF5 itself writes only the layout (it crashes where a disk is full), and that is not written again: the rows of a
chunk go to their places, are flushed to the disk, and only then the chunk's flag is set. A kill at any moment leaves a
valid file in which each chunk is either there or not.
"""

import errno
import json
import os
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import Any, Final, NamedTuple, Self

import h5py
import numpy as np
from numpy.typing import NDArray

from canhaptic.errors import InputError, LogFormatError, LogWriteError
from canhaptic.study.loop import Array
from canhaptic.study.sweep.chunk import ENGINES, SLOTS, STATUS, ChunkResult
from canhaptic.study.sweep.points import Column, Points

_FORMAT: Final = "canhaptic sweep"
_VERSION: Final = 1
_TEXT_BYTES: Final = 320
_KEPT: Final = "what was finished is kept, --resume goes on"
_NOTHING_RUN: Final = "nothing has been run"
_ROOM_OF_LAYOUT: Final = 1 << 20
"""Least room for names, attributes and remarks [bytes]."""
_BLOCK: Final = 65_536
"""Rows written at once when a file is made."""


class Columnset(NamedTuple):
    """What a new file holds in addition to its values."""

    figures: tuple[str, ...]  # "AXIS/METRIC"
    identity: dict[str, Any]  # what a resumed sweep must agree with
    notes: dict[str, str]  # further attributes, texts


class SweepTable:
    """An open file of a sweep.

    Args:
        path: Of a file made by `create`.
        writable: Whether chunks will be written; only one process can.

    Raises:
        LogFormatError: It is none, or of a newer version.
        LogWriteError: Another process writes it.
    """

    def __init__(self, path: Path, *, writable: bool = False) -> None:
        self.path = path
        self._file = _opened(path)
        self._writer = _Writer(path, self._file) if writable else None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Closes the file."""
        if self._writer is not None:
            self._writer.close()
        self._file.close()

    def __len__(self) -> int:
        return int(self._file["status"].shape[0])

    @property
    def chunk(self) -> int:
        """Scenes per chunk."""
        return int(self._file.attrs["chunk"])

    @property
    def identity(self) -> dict[str, Any]:
        """What the sweep is."""
        found: dict[str, Any] = json.loads(self._file.attrs["identity"])
        return found

    def note(self, name: str) -> str:
        """Returns a text attribute; "" when there is none."""
        return str(self._file.attrs.get(name, ""))

    @property
    def keys(self) -> list[str]:
        """What varies, in the order given."""
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
        """Returns which chunks are there, shape (n_chunks,)."""
        return np.asarray(self._file["done"]).astype(bool)

    def span(self, chunk: int) -> tuple[int, int]:
        """Returns first scene and one beyond the last of a chunk."""
        return chunk * self.chunk, min(len(self), (chunk + 1) * self.chunk)

    def values(self, key: str, start: int = 0, stop: int | None = None) -> Column:
        """Returns the values of a key: numbers in SI of shape (n,), or a list of texts."""
        dataset = self._file[f"values/{_name(key)}"]
        found = np.asarray(dataset[start:stop])
        texts = dataset.attrs.get("texts")
        if texts is None:
            return found
        known = json.loads(texts)
        return [known[i] for i in found.tolist()]

    def texts(self, key: str) -> list[str]:
        """Returns the texts that a key may be; `numbers` are indices in them."""
        return [str(text) for text in json.loads(self._file[f"values/{_name(key)}"].attrs["texts"])]

    def numbers(self, key: str, start: int = 0, stop: int | None = None) -> NDArray[Any]:
        """Returns the index of every scene's text of a key whose values are texts, shape (n,)."""
        return np.asarray(self._file[f"values/{_name(key)}"][start:stop])

    def columns(self, start: int, stop: int) -> dict[str, Column]:
        """Returns the values of some scenes by key."""
        return {key: self.values(key, start, stop) for key in self.keys}

    def figure(self, axis: str, metric: str, start: int = 0, stop: int | None = None) -> Array:
        """Returns a figure of every scene, NaN where there is none, shape (n,)."""
        return np.asarray(self._file[f"figures/{_name(axis)}/{metric}"][start:stop])

    def status(self, start: int = 0, stop: int | None = None) -> NDArray[np.uint8]:
        """Returns the status of every scene, an index in `STATUS`, shape (n,)."""
        return np.asarray(self._file["status"][start:stop])

    def engine(self, start: int = 0, stop: int | None = None) -> NDArray[np.uint8]:
        """Returns what computed every scene, an index in `ENGINES`, shape (n,)."""
        return np.asarray(self._file["engine"][start:stop])

    def remark(self, scene: int) -> str:
        """Returns why a scene was refused, why it ran alone, or what its algorithm took from the plant."""
        number = int(self._file["remark"][scene])
        return self._texts(scene // self.chunk)[number - 1] if number else ""

    def remarks(self) -> Iterator[tuple[str, str, str, int]]:
        """Yields (status, engine, remark, number of scenes) of each chunk in turn, alike ones counted together."""
        for chunk in np.flatnonzero(self.done()).tolist():
            start, stop = self.span(chunk)
            rows = np.stack([self.status(start, stop), self.engine(start, stop), self._file["remark"][start:stop]])
            texts = self._texts(chunk)
            kinds, counts = np.unique(rows, axis=1, return_counts=True)
            for (status, engine, number), count in zip(kinds.T.tolist(), counts.tolist(), strict=True):
                yield STATUS[status], ENGINES[engine], texts[number - 1] if number else "", count

    def write(self, chunk: int, result: ChunkResult) -> None:
        """Writes a chunk: its rows, and when those are on the disk its flag.

        Raises:
            LogWriteError: The disk refuses; what was finished before stays.
        """
        if self._writer is None:
            raise LogWriteError(f"{self.path}: is open for reading only; open it with writable=True")
        start = self.span(chunk)[0]
        rows: dict[str, NDArray[Any]] = {_path_of(name): values for name, values in result.figures.items()}
        rows |= {"status": result.status, "engine": result.engine, "remark": result.remark}
        texts = np.zeros(SLOTS, dtype=f"S{_TEXT_BYTES}")
        texts[: len(result.texts)] = [_cut(text) for text in result.texts]
        for path, values in rows.items():
            self._writer.put(path, start, values)
        self._writer.put("texts", chunk * SLOTS, texts)
        self._writer.flush()
        self._writer.put("done", chunk, np.ones(1, dtype=np.uint8))

    def _texts(self, chunk: int) -> list[str]:
        raw = self._file["texts"][chunk * SLOTS : (chunk + 1) * SLOTS]
        return [bytes(text).decode("utf-8", "replace") for text in raw]


class _Writer:
    """Writes rows at the places that HDF5 gave its columns, without HDF5.

    Args:
        path: Of the file, for messages.
        file: The same, open in HDF5.
        place: Where it is, when not at its path yet.
        kept: What a failure leaves behind, for messages.
    """

    def __init__(self, path: Path, file: Any, place: Path | None = None, kept: str = _KEPT) -> None:
        import fcntl  # not on Windows

        self._path, self._kept = path, kept
        try:
            self._descriptor = os.open(place or path, os.O_RDWR)
            fcntl.lockf(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            os.close(self._descriptor)
            raise LogWriteError(f"{path}: another sweep writes it; wait for its end, or give another --out") from error
        except OSError as error:
            raise _write_error(path, error, kept) from error
        self._places: dict[str, tuple[int, np.dtype[Any]]] = {}

        def visit(name: str, item: Any) -> None:
            if isinstance(item, h5py.Dataset):
                self._places[name] = item.id.get_offset(), item.dtype

        file.visititems(visit)

    def put(self, path: str, start: int, values: NDArray[Any]) -> None:
        """Writes consecutive elements of a column."""
        offset, dtype = self._places[path]
        content = memoryview(np.ascontiguousarray(values, dtype=dtype).tobytes())
        offset += start * dtype.itemsize
        try:
            while content:
                written = os.pwrite(self._descriptor, content, offset)
                content, offset = content[written:], offset + written
        except OSError as error:
            raise _write_error(self._path, error, self._kept) from error

    def fill(self, path: str, count: int, value: NDArray[Any]) -> None:
        """Writes one value all over a column."""
        block = np.full(min(count, _BLOCK), value)
        for start in range(0, count, _BLOCK):
            self.put(path, start, block[: count - start])

    def flush(self) -> None:
        """Waits until the disk has everything."""
        try:
            os.fdatasync(self._descriptor)
        except OSError as error:
            raise _write_error(self._path, error, self._kept) from error

    def close(self) -> None:
        """Closes the file, everything flushed."""
        try:
            self.flush()
        finally:
            os.close(self._descriptor)


def create(path: Path, points: Points, chunk: int, columns: Columnset, *, replace: bool = False) -> None:
    """Makes the file of a sweep with every value in it and no result; it appears whole or not at all.

    Raises:
        InputError: It exists.
        LogWriteError: The folder is missing or read-only, or the disk is too small for all results.
    """
    if path.exists() and not replace:
        raise InputError(f"{path} already exists; --resume continues it, --force replaces it")
    beginning = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        _reserve(beginning, len(points) * (8 * (len(columns.figures) + len(points.varied)) + 3))
        with h5py.File(beginning, "w", libver=("earliest", "v110"), locking=False) as file:
            fills = _lay_out(file, points, chunk, columns)
        with h5py.File(beginning, "r", locking=False) as file:
            writer = _Writer(path, file, beginning, _NOTHING_RUN)
        try:
            for name, (count, fill) in fills.items():
                writer.fill(name, count, fill)
            _write_values(writer, points)
        finally:
            writer.close()
        beginning.replace(path)
    except LogWriteError:
        raise  # an OSError itself, whose message is complete
    except (OSError, RuntimeError) as error:
        raise _write_error(path, error, _NOTHING_RUN) from error
    finally:
        beginning.unlink(missing_ok=True)


def _reserve(path: Path, size: int) -> None:
    """Asks the disk for the room of the whole file, before HDF5 would learn that there is none."""
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_TRUNC, 0o666)
    try:
        os.posix_fallocate(descriptor, 0, size + _ROOM_OF_LAYOUT)
    finally:
        os.close(descriptor)


_Fills = dict[str, tuple[int, NDArray[Any]]]


def _lay_out(file: Any, points: Points, chunk: int, columns: Columnset) -> _Fills:
    """Makes all columns, each in one piece with its room allotted; returns what each one begins with."""
    count, chunks = len(points), -(-len(points) // chunk)
    file.attrs["format"], file.attrs["format_version"], file.attrs["chunk"] = _FORMAT, _VERSION, chunk
    file.attrs["identity"] = json.dumps(columns.identity, sort_keys=True)
    for name, text in columns.notes.items():
        file.attrs[name] = text
    nothing, zero = np.array(np.nan), np.array(0, dtype="u1")
    fills: _Fills = {_path_of(name): (count, nothing) for name in columns.figures}
    fills |= dict.fromkeys(("status", "engine", "remark"), (count, zero))
    fills |= {"texts": (chunks * SLOTS, np.array(b"", dtype=f"S{_TEXT_BYTES}")), "done": (chunks, zero)}
    for name, (length, fill) in fills.items():
        _column(file, name, length, fill.dtype)
    file["status"].attrs["names"], file["engine"].attrs["names"] = json.dumps(STATUS), json.dumps(ENGINES)
    for varied in points.varied:
        dataset = _column(file, f"values/{_name(varied.key)}", count, np.dtype("<f8" if varied.is_number else "<i4"))
        if not varied.is_number:
            dataset.attrs["texts"] = json.dumps([varied.yaml(value) for value in varied.values])
    return fills


def _column(file: Any, path: str, count: int, dtype: np.dtype[Any]) -> Any:
    layout = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    layout.set_alloc_time(h5py.h5d.ALLOC_TIME_EARLY)
    layout.set_fill_time(h5py.h5d.FILL_TIME_NEVER)
    return file.create_dataset(path, (count,), dtype=dtype, dcpl=layout)


def _write_values(writer: _Writer, points: Points) -> None:
    for start in range(0, len(points), _BLOCK):
        stop = min(len(points), start + _BLOCK)
        for (key, column), varied in zip(points.columns(start, stop).items(), points.varied, strict=True):
            numbers = {value: number for number, value in enumerate(varied.values)}
            values = column if isinstance(column, np.ndarray) else [numbers[value] for value in column]
            writer.put(f"values/{_name(key)}", start, np.asarray(values))


def _opened(path: Path) -> Any:
    try:
        file = h5py.File(path, "r", locking=False)
    except (OSError, RuntimeError) as error:
        reason = "no such file" if not path.exists() else str(error)
        raise LogFormatError(
            f"{path}: cannot be read as a sweep ({reason}); give a file made by canhaptic sweep"
        ) from error
    version = file.attrs.get("format_version", 0)
    if file.attrs.get("format") != _FORMAT or version > _VERSION:
        found = file.attrs.get("format", "no canhaptic sweep")
        file.close()
        raise LogFormatError(f"{path}: is {found!r} version {version}, expected {_FORMAT!r} up to {_VERSION}")
    return file


def _write_error(path: Path, error: Exception, kept: str) -> LogWriteError:
    code = error.errno if isinstance(error, OSError) else None
    reason = os.strerror(code) if code else " ".join(str(error).split())
    if code in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
        return LogWriteError(f"{path}: the disk has no room for it ({reason}); make room, {kept}")
    return LogWriteError(f"{path}: cannot be written ({reason}); {kept}")


def _name(key: str) -> str:
    """Returns a name without the separator of HDF5."""
    return key.replace("/", "\u2215")


def _path_of(figure: str) -> str:
    axis, _, metric = figure.rpartition("/")
    return f"figures/{_name(axis)}/{metric}"


def _cut(text: str) -> bytes:
    """Returns a text that fits its slot, whole letters only."""
    return text.encode()[:_TEXT_BYTES].decode("utf-8", "ignore").encode()
