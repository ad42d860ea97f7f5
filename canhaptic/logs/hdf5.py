"""Typed interface to the part of h5py that the logs use: the only module that touches the untyped library."""

import ctypes
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from threading import RLock
from typing import Any, Final, Self
from zlib import crc32

import h5py
import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]
"""A column; the type of its elements depends on the column."""
Attribute = str | bytes | int | float | np.generic

_TABLE_CACHE: Final = 1 << 18  # [B]
_CHUNK_CACHE: Final = 1 << 19  # [B] a column; the default of HDF5 2.0 is 8 MiB, and a log has 40 columns
_TEXTS_AND_CHUNKS: Final = 1 << 26  # [B], the most that those of one item may take
_ATTEMPTS: Final = 24  # waits double from 1 ns: 17 ms for a writer to complete an item; the library's 100 last for ever
_USER_BLOCK: Final = 512  # [B] before the file's own content, the least that the format allows
_SIGNATURE: Final = b"\x89HDF\r\n\x1a\n"
_FAILED: Final = b"failed: "
ENDS_AT: Final = "the log ends at cycle"
_BOUND: Final = RLock()
_STATM: Final = Path("/proc/self/statm")


class Dataset:
    """One column of a file.

    Raises:
        OSError: The values are in another file, which may be a pipe.
    """

    def __init__(self, dataset: h5py.Dataset) -> None:
        if dataset.external or dataset.is_virtual:
            raise OSError(f"{dataset.name} has its values in another file; those of a log never are")
        self._dataset = dataset

    def __len__(self) -> int:
        return int(self._dataset.shape[0]) if self._dataset.shape else 0

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the column; () for a single value."""
        return tuple(self._dataset.shape or ())

    @property
    def chunk(self) -> int:
        """Number of elements per chunk; 1 where the column is contiguous."""
        return int(self._dataset.chunks[0]) if self._dataset.chunks else 1

    def refreshed_length(self) -> int:
        """Return the present length while another process writes the column."""
        self._dataset.refresh()
        return len(self)

    def read_tables(self) -> None:
        """Read type, attributes and chunk addresses, but no elements, so that HDF5 reports damage in them."""
        self._dataset.dtype, self.attributes  # noqa: B018 - for what the library does to find them
        with _bounded_memory():
            if self._dataset.chunks:
                self._dataset.id.get_num_chunks()

    @property
    def dtype(self) -> np.dtype[np.generic]:
        """Type of the elements."""
        dtype: np.dtype[np.generic] = self._dataset.dtype
        return dtype

    @property
    def attributes(self) -> dict[str, Attribute]:
        """Attributes of the column."""
        with _bounded_memory():
            return dict(self._dataset.attrs)

    def read(self, start: int = 0, stop: int | None = None) -> Array:
        """Return elements `start` to `stop` (all by default)."""
        with _bounded_memory(2 * len(range(*slice(start, stop).indices(len(self)))) * self.dtype.itemsize):
            return np.asarray(self._dataset[start:stop])

    def append(self, values: Array) -> None:
        """Add elements at the end."""
        length = len(self)
        self._dataset.resize((length + len(values),))
        self._dataset[length:] = values

    def truncate(self, length: int) -> None:
        """Keep the first `length` elements."""
        self._dataset.resize((length,))


class Hdf5File:
    """An open HDF5 file.

    Args:
        path: The file.
        mode: "live": read, even while another process writes or after it was killed; "x": create a new
            file; "x live": create a new file that others read while it is written.

    Nothing newer than the format of HDF5 1.10 (2016) is written, so that MATLAB and old readers can open it.
    """

    def __init__(self, path: Path, mode: str) -> None:
        if mode == "live":
            with _bounded_memory():
                how = h5py.h5f.ACC_RDONLY | h5py.h5f.ACC_SWMR_READ
                self._file = h5py.File(h5py.h5f.open(os.fsencode(path), how, _live_access()))
        else:
            oldest, block = ("v110", _USER_BLOCK) if mode == "x live" else ("earliest", None)
            # Without a cache for chunks: each is written once, whole; a megabyte of them per column would be kept.
            self._file = h5py.File(
                path, "x", libver=(oldest, "v110"), locking=False, rdcc_nbytes=0, userblock_size=block
            )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    @property
    def is_closed(self) -> bool:
        """Whether the file was closed."""
        return not self._file

    @property
    def attributes(self) -> dict[str, Attribute]:
        """Attributes of the root; bytes that are not valid UTF-8 are replaced."""
        with _bounded_memory():
            return {name: _text(value) if isinstance(value, str) else value for name, value in self._file.attrs.items()}

    def set_attributes(self, attributes: Mapping[str, Attribute]) -> None:
        """Set attributes of the root."""
        self._file.attrs.update(attributes)

    def create(
        self,
        path: str,
        dtype: str | np.dtype[np.generic],
        chunk: int,
        attributes: Mapping[str, Attribute],
        *,
        compressed: bool = True,
        also: str = "",
    ) -> Dataset:
        """Return a new empty column that can grow; with a second name if `also` is given."""
        options: dict[str, Any] = {"compression": "gzip", "compression_opts": 1, "shuffle": True}
        if not compressed:  # which has a checksum
            options = {"fletcher32": True}
        column = self._file.create_dataset(path, (0,), maxshape=(None,), dtype=dtype, chunks=(chunk,), **options)
        column.attrs.update(attributes)
        if also:
            self._file[also] = column
        return Dataset(column)

    def __getitem__(self, path: str) -> Dataset:
        self._require_own(path)
        with _bounded_memory():
            found = self._file[path]
        if not isinstance(found, h5py.Dataset):
            raise KeyError(f"{path} is no column")
        return Dataset(found)

    def _require_own(self, path: str) -> None:
        """Require that a path stays inside this file.

        Raises:
            OSError: The path goes through a link, which may lead to another file or to a pipe.
        """
        names, links = path.strip("/").split("/"), self._file.id.links
        with _bounded_memory():
            for name in filter(None, ("/".join(names[: n + 1]) for n in range(len(names)))):
                if not links.exists(os.fsencode(name)):
                    return
                if links.get_info(os.fsencode(name)).type != h5py.h5l.TYPE_HARD:
                    raise OSError(f"{name} is a link, which a log never contains")

    def names(self, group: str) -> list[str]:
        """Return the names inside a group; empty when the group is missing."""
        self._require_own(group)
        with _bounded_memory():
            found = self._file.get(group)
            return list(found) if isinstance(found, h5py.Group) else []

    def datasets(self) -> list[tuple[str, Dataset]]:
        """Return path and column of every dataset in the file."""
        found: list[tuple[str, Dataset]] = []

        def visit(path: str | bytes, item: h5py.Dataset | h5py.Group) -> None:  # h5py leaves a damaged name as bytes
            if isinstance(item, h5py.Dataset) and item.ndim == 1:
                found.append((path if isinstance(path, str) else path.decode("utf-8", "replace"), Dataset(item)))

        with _bounded_memory():
            self._file.visititems(visit)
        return found

    def read_tables(self) -> None:
        """Read the metadata: the root's attributes, and name, type, attributes and chunks of every column.

        Continues after damaged entries: another reader may reach them first.
        """
        with suppress(Exception):
            self.attributes  # noqa: B018 - for what the library does to find them
        for _, dataset in self.datasets():
            with suppress(Exception):
                dataset.read_tables()

    def copy_to(self, other: "Hdf5File") -> None:
        """Copy everything, compressed chunks as they are, and the root's attributes."""
        for name in self._file:
            self._require_own(name)
            self._file.copy(name, other._file)  # noqa: SLF001 - the same class
        other.set_attributes(self.attributes)

    def start_live(self) -> None:
        """Let other processes read while this one writes; no more columns or attributes can be added.

        The library's cache of metadata, which grows to megabytes in the first hour of a log, is bounded.
        """
        cache = self._file.id.get_mdc_config()
        cache.set_initial_size, cache.initial_size = True, _TABLE_CACHE
        cache.min_size = cache.max_size = _TABLE_CACHE
        self._file.id.set_mdc_config(cache)
        self._file.swmr_mode = True

    def flush(self) -> None:
        """Pass everything to the operating system."""
        self._file.flush()


@cache
def _live_access() -> Any:
    """Return the properties for reading a live file: an item whose checksum stays wrong is given up soon.

    h5py lacks the call for it; the library that it has loaded is searched, through one of its modules.
    """
    access = h5py.h5p.create(h5py.h5p.FILE_ACCESS)
    elements, slots, _, preemption = access.get_cache()
    access.set_cache(elements, slots, _CHUNK_CACHE, preemption)
    with suppress(OSError, AttributeError):  # a system whose loader does not search: slow on a damaged file
        library = ctypes.PyDLL(h5py.h5p.__file__)
        library.H5Pset_metadata_read_attempts(ctypes.c_int64(access.id), ctypes.c_uint(_ATTEMPTS))
    return access


@contextmanager
def _bounded_memory(needed: int = 0) -> Iterator[None]:
    """On Linux, bound the memory that HDF5 may allocate: it trusts damaged lengths, and would allocate gigabytes.

    Args:
        needed: Size of an undamaged item [B], besides texts and chunks.
    """
    if not _STATM.exists():
        yield
        return
    import resource

    with _BOUND:  # the limit is of the whole process: restored before another thread reads it
        before = resource.getrlimit(resource.RLIMIT_AS)
        with _STATM.open("rb", buffering=0) as file:
            pages = int(file.read(64).split()[0])
        bound = pages * resource.getpagesize() + _TEXTS_AND_CHUNKS + needed
        if before[0] != resource.RLIM_INFINITY:
            bound = min(bound, before[0])
        resource.setrlimit(resource.RLIMIT_AS, (bound, before[1]))
        try:
            yield
        except MemoryError as error:
            raise OSError("a text or chunk claims more memory than any log needs") from error
        finally:
            resource.setrlimit(resource.RLIMIT_AS, before)


def mark_failed(path: Path, cause: str) -> None:
    """Write why a log is incomplete into space reserved at the start of its file, which works on a full disk too.

    Raises:
        OSError: The file cannot be written.
    """
    with path.open("r+b") as file:
        file.seek(_USER_BLOCK)
        if file.read(len(_SIGNATURE)) == _SIGNATURE:
            file.seek(0)
            file.write((_FAILED + cause.encode())[:_USER_BLOCK])


def failure_of(path: Path) -> str:
    """Return the text that `mark_failed` wrote, "failed: CAUSE"; empty if there is none."""
    with path.open("rb") as file:
        text = file.read(_USER_BLOCK)
    return text.rstrip(b"\0").decode("utf-8", "replace") if text.startswith(_FAILED) else ""


def note_length(path: Path, cycles: int) -> str:
    """Add the run's length to the text of `mark_failed` if the log ends early; return the text, or empty for none."""
    cause = failure_of(path) if path.is_file() else ""
    if ENDS_AT in cause:
        mark_failed(path, f"{cause.removeprefix('failed: ')} of {cycles}")
    return cause and failure_of(path)


def row_digests(columns: Sequence[Array]) -> Array:
    """Return the CRC-32 of each row of the given columns, shape (n_rows,): each value as 8 bytes, little endian."""
    table = np.stack([column.view("<u8") if column.dtype == "f8" else column.astype("<u8") for column in columns], 1)
    return np.fromiter(map(crc32, table), "u4", len(table))


def _text(value: str) -> str:
    return value.encode("utf-8", "surrogateescape").decode("utf-8", "replace")
