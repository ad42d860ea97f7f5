"""Trimming and packing of an energy log: a kill or a full disk can leave its columns at different lengths."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Final

from canhaptic.logs.hdf5 import Attribute, Dataset, Hdf5File

_PACKED_CHUNK: Final = 16_384  # rows
_BLOCK: Final = 16 * _PACKED_CHUNK  # rows copied at a time
_EVENTS: Final = "events/"


def _whole_lengths(file: Hdf5File) -> tuple[int, int]:
    """Return (rows, events): how many of each every column of a file has."""
    found: tuple[list[int], list[int]] = ([], [])
    for path, dataset in file.datasets():
        found[path.startswith(_EVENTS)].append(len(dataset))
    return min(found[0], default=0), min(found[1], default=0)


def trim(file: Hdf5File) -> tuple[int, int]:
    """Cut all columns of a file to whole rows and events, and return how many (rows, events) are left."""
    rows, events = _whole_lengths(file)
    for path, dataset in file.datasets():
        length = events if path.startswith(_EVENTS) else rows
        if len(dataset) > length:
            dataset.truncate(length)
    return rows, events


def unfinished(path: Path) -> Path:
    """Temporary name of a log, in the folder of its final one; a leftover of a killed run is deleted."""
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
        for name, value in {**old.attributes, **attributes}.items():
            new.set_attribute(name, value)
        rows, events = _whole_lengths(old) if lengths is None else lengths
        for path, dataset in old.datasets():
            _copy_column(dataset, new, path, events if path.startswith(_EVENTS) else rows)
    os.replace(temporary, target)


def _copy_column(dataset: Dataset, new: Hdf5File, path: str, rows: int) -> None:
    copy = new.create(path, dataset.dtype, max(1, min(rows, _PACKED_CHUNK)))
    for name, value in dataset.attributes.items():
        copy.set_attribute(name, value)
    for start in range(0, rows, _BLOCK):
        copy.append(dataset.read(start, min(rows, start + _BLOCK)))
