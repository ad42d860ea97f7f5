"""Check of the columns of an energy log: all present, of their type, and of one length."""

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from canhaptic.errors import LogFormatError
from canhaptic.logs.columns import EVENT_TEXT_SIZES, FORMAT_VERSION, LogSchema, PortDescription
from canhaptic.logs.hdf5 import Dataset, Hdf5File

_RUNNING: Final = "running"
"""Status of a log whose writer has not closed it: a kill can come between two columns of one chunk."""

FoundColumns = Mapping[str, Dataset]


def checked_rows(path: Path, file: Hdf5File, ports: Sequence[str], status: str) -> int:
    """Number of rows that every column has.

    Args:
        path: The log, for messages.
        file: The same file, open.
        ports: Names of its ports.
        status: Status of the log: while it is `_RUNNING`, columns may differ by a chunk.

    Raises:
        LogFormatError: A column is missing, of another type, or shorter than the others; names it, with the rows found
            and expected.
    """
    rows, events = found_columns(path, file, ports)
    for columns in (rows, events):
        _require_one_length(path, columns, status == _RUNNING)
    return min(len(dataset) for dataset in rows.values())


def found_columns(path: Path, file: Hdf5File, ports: Sequence[str]) -> tuple[FoundColumns, FoundColumns]:
    """Return the columns of the rows and those of the events, by path.

    The format of an older version has fewer.

    Raises:
        LogFormatError: One is missing or of another type.
    """
    version = int(file.attributes.get("format_version", FORMAT_VERSION))
    described = tuple(PortDescription(name, "m") for name in ports)
    schema = LogSchema(described, 1, bool(file.names("truth")), 1, False, {}, version)
    types = {column.path: column.dtype for column in schema.columns() if column.path}
    of_events = {"sync_index": "i8", **{name: f"S{size}" for name, size in EVENT_TEXT_SIZES.items()}}
    rows = {name: _column(path, file, name, dtype) for name, dtype in types.items()}
    return rows, {f"events/{name}": _column(path, file, f"events/{name}", dtype) for name, dtype in of_events.items()}


def _column(path: Path, file: Hdf5File, name: str, dtype: str) -> Dataset:
    try:
        dataset = file[name]
    except (LookupError, OSError, RuntimeError, ValueError) as error:
        raise LogFormatError(f"{path}: {name} is missing or cannot be read ({error}); the file is damaged") from error
    if len(dataset.shape) != 1 or dataset.dtype != np.dtype(dtype):
        raise LogFormatError(
            f"{path}: {name} holds {dataset.dtype} of shape {dataset.shape}, expected a column of {np.dtype(dtype)}; "
            "the file is damaged, or was not written by canhaptic"
        )
    return dataset


def _require_one_length(path: Path, columns: FoundColumns, grows: bool) -> None:
    lengths = {name: len(dataset) for name, dataset in columns.items()}
    expected = usual_length(columns)
    if grows:  # it may also have grown from one column to the next
        least = expected - max(dataset.chunk for dataset in columns.values())
        odd = [name for name in lengths if lengths[name] < least and columns[name].refreshed_length() < least]
    else:
        odd = [name for name in lengths if lengths[name] != expected]
    if odd:
        more = f" ({len(odd)} columns are of another length)" if len(odd) > 1 else ""
        raise LogFormatError(
            f"{path}: {odd[0]} has {lengths[odd[0]]} rows, expected {expected} like the other columns{more}; "
            "the file is damaged, `inspect --repair` saves the rows that every column has"
        )


def usual_length(columns: FoundColumns) -> int:
    """Length that most columns have; of two equally common lengths the longer."""
    counts = Counter(len(dataset) for dataset in columns.values())
    return max(counts, key=lambda length: (counts[length], length))
