"""Rows of the shared ring -> HDF5 file, whole chunks at a time, readable while it grows (SWMR).

Only whole chunks are appended during a run: flushing an incomplete compressed chunk again and again leaks its old
copies (9.6 MB of data became 86 to 307 MB). On a clean close the file is packed into large chunks. A kill or a full
disk can leave columns of different lengths, which `trim` and `repack` cut to whole rows.
"""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Final

import numpy as np

from canhaptic.logs.columns import EVENT_COLUMNS, FORMAT_NAME, FORMAT_VERSION, LogSchema
from canhaptic.logs.hdf5 import ENDS_AT, Attribute, Hdf5File, mark_failed, row_digests
from canhaptic.logs.ring import NO_SPACE, LogSink, SharedArea, cause_of, open_regular
from canhaptic.quantities import OLD_COLUMNS

_PACKED_CHUNK: Final = 16_384  # rows
_BLOCK: Final = 16 * _PACKED_CHUNK  # rows copied at a time
_EVENTS: Final = "events/"


def _whole_lengths(file: Hdf5File) -> tuple[int, int]:
    """Return (rows, events): the number of each that all columns of a file have."""
    found: tuple[list[int], list[int]] = ([], [])
    for path, dataset in file.datasets():
        found[path.startswith(_EVENTS)].append(len(dataset))
    return min(found[0], default=0), min(found[1], default=0)


def trim(file: Hdf5File) -> tuple[int, int]:
    """Cut all columns of a file to whole rows and events, and return how many (rows, events) are left."""
    lengths = _whole_lengths(file)
    for path, dataset in file.datasets():
        dataset.truncate(lengths[path.startswith(_EVENTS)])
    return lengths


def unfinished(path: Path) -> Path:
    """Return the temporary name of a log, in its folder; such a file of a killed run is deleted."""
    temporary = path.with_name(f".{path.name}.new")
    temporary.unlink(missing_ok=True)
    return temporary


def repack(
    source: Path, target: Path, attributes: Mapping[str, Attribute], lengths: tuple[int, int] | None = None
) -> None:
    """Write a compact copy of a log with large chunks; `target` may be `source`.

    Args:
        source: Log, also one that a kill left open.
        target: The copy.
        attributes: Attributes of the root to change.
        lengths: Rows and events to keep; by default all that are complete.
    """
    temporary = unfinished(target)
    with Hdf5File(source, "live") as old, Hdf5File(temporary, "x") as new:
        new.set_attributes({**old.attributes, **attributes})
        lengths = _whole_lengths(old) if lengths is None else lengths
        columns = {_names_of(path, old): path for path, _ in old.datasets()}
        for (stored, also), path in columns.items():
            length, column = lengths[path.startswith(_EVENTS)], old[path]
            copy = new.create(stored, column.dtype, max(1, min(length, _PACKED_CHUNK)), column.attributes, also=also)
            for start in range(0, length, _BLOCK):
                copy.append(column.read(start, min(length, start + _BLOCK)))
    os.replace(temporary, target)


def _names_of(path: str, file: Hdf5File) -> tuple[str, str]:
    """Return the stored name of a column, and its second name or "", from either of them."""
    folder, _, name = path.rpartition("/")
    if not folder.startswith("ports/"):
        return path, ""
    stored, found = OLD_COLUMNS.get(name, name), file.names(folder)
    also = [new for new, old in OLD_COLUMNS.items() if old == stored and new in found]
    return f"{folder}/{stored}", f"{folder}/{also[0]}" if also else ""


class EnergySink(LogSink):
    """One energy log being written.

    Args:
        path: The file.
        schema: Columns of the log.
        area: Shared memory with two rings: rows and events.
    """

    def __init__(self, path: Path, schema: LogSchema, area: SharedArea) -> None:
        super().__init__(path)
        self._schema = schema
        self._rows, self._events = area.rings
        self._columns = schema.columns()
        kinds = ("<f8" if column.dtype == "f8" else "<i8" for column in self._columns)
        self._record = np.dtype([(f"f{number}", kind) for number, kind in enumerate(kinds)])
        self._next_row = self._next_event = self._lost = 0
        self._is_whole = False

    def open(self, restart: bool) -> None:
        """Create the file; after a restart, continue the file of the killed writer from its first missing row."""
        temporary = unfinished(self._path)
        if not (restart and self._recover(temporary)):
            self._next_row = self._lost = self._rows.tail
            self._next_event = self._events.tail
            self._file = Hdf5File(unfinished(self._path), "x live")
            self._create_columns()
        os.replace(temporary, self._path)
        self._file.start_live()
        self._datasets = [self._file[column.path] for column in self._schema.stored()]
        self._event_datasets = [self._file[path] for path in EVENT_COLUMNS]
        self._descriptor = open_regular(self._path, os.O_RDONLY)
        self._size = os.fstat(self._descriptor).st_size

    def _create_columns(self) -> None:
        schema = self._schema
        self._file.set_attributes(
            {
                **schema.attributes,
                "format": FORMAT_NAME,
                "format_version": FORMAT_VERSION,
                "sample_time_ns": schema.sample_time_ns,
                "ports": "\n".join(f"{port.name} {port.unit}" for port in schema.ports),
                "status": "running",
                "rows_lost": self._lost,
            }
        )
        for column in schema.stored():
            meaning = {"meaning": column.meaning} if column.meaning else {}
            given = {"unit": column.unit, **meaning}
            self._file.create(column.path, column.dtype, schema.chunk_rows, given, also=column.also)
        for path, dtype in EVENT_COLUMNS.items():
            self._file.create(path, dtype, 1, {}, compressed=False)

    def _recover(self, temporary: Path) -> bool:
        """Copy the killed writer's rows into a clean file and continue there; False when nothing can be read."""
        try:
            with Hdf5File(self._path, "live") as old:
                self._file = Hdf5File(temporary, "x live")
                old.copy_to(self._file)
        except (OSError, RuntimeError, KeyError) as error:
            if cause_of(error) == NO_SPACE:
                raise  # of the copy: the log itself is well
            if self._path.exists():
                self._path.replace(self._path.with_name(self._path.name + ".damaged"))
            return False
        rows, self._next_event = trim(self._file)
        self._lost = int(self._file.attributes["rows_lost"])
        self._next_row = self._lost + rows
        return True

    def drain(self, heads: list[int], final: bool) -> None:
        """Write the whole chunks of rows up to `heads[0]` (with `final` the rest too) and the events."""
        chunk = self._schema.chunk_rows
        while heads[0] - self._next_row >= chunk or (final and heads[0] > self._next_row):
            self._write_rows(min(chunk, heads[0] - self._next_row))
        if heads[1] > self._next_event:
            self._write_events(heads[1] - self._next_event)

    def _write_rows(self, count: int) -> None:
        block = np.frombuffer(self._rows.read(self._next_row, count), self._record)
        values = [block[f"f{n}"].astype(column.dtype) for n, column in enumerate(self._columns) if column.path]
        for dataset, column in zip(self._datasets, [*values, row_digests(values)], strict=True):
            dataset.append(column)
        self._flush()
        self._next_row += count
        self._rows.release(self._next_row)

    def _write_events(self, count: int) -> None:
        block = np.frombuffer(self._events.read(self._next_event, count), np.dtype(list(EVENT_COLUMNS.items())))
        for name, dataset in zip(EVENT_COLUMNS, self._event_datasets, strict=True):
            for position in range(count):  # one chunk each
                dataset.append(block[name][position : position + 1])
        self._flush()
        self._next_event += count
        self._events.release(self._next_event)

    def _flush(self) -> None:
        self._file.flush()
        self._size = os.fstat(self._descriptor).st_size
        if self._schema.synchronise:
            os.fsync(self._descriptor)

    def finish(self, status: str) -> None:
        """Close the file and pack it."""
        self.check()
        self._file.close()
        os.close(self._descriptor)
        self._is_whole = True
        repack(self._path, self._path, {"status": status})

    def fail(self, cause: str) -> None:
        """Keep the rows up to the last flush in the file, and record the cause as the status of the run."""
        unfinished(self._path)
        rows = self._next_row - self._lost
        unpacked = f" while it was packed; all {rows} rows are in it, unpacked"
        mark_failed(self._path, f"{cause}{unpacked if self._is_whole else f'; {ENDS_AT} {rows}'}")
