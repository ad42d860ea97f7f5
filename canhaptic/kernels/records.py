"""Settings and states of many scenes as NumPy records: compiled kernels use them as they use dataclasses."""

from collections.abc import Iterable
from dataclasses import fields, is_dataclass
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Records = NDArray[np.void]


class _Part(NamedTuple):
    path: str
    kind: np.dtype[Any]
    offset: int


def record_type(value: Any) -> np.dtype[Any]:
    """Returns the type of a record with the fields of a dataclass of numbers, and of dataclasses of such."""
    parts = [(field.name, getattr(value, field.name)) for field in fields(value)]
    return np.dtype(
        [(name, record_type(part) if is_dataclass(part) else np.dtype(type(part))) for name, part in parts], align=True
    )


def records_of(values: Iterable[Any]) -> Records:
    """Returns dataclasses of one kind as records, shape (n,)."""
    values = list(values)
    kind = record_type(values[0])
    parts = list(_flat(kind))
    flat = np.dtype(
        {
            "names": [part.path for part in parts],
            "formats": [part.kind for part in parts],
            "offsets": [part.offset for part in parts],
            "itemsize": kind.itemsize,
        }
    )
    if len(parts) == 1:
        rows = [(getattr(value, parts[0].path),) for value in values]
    else:
        rows = [*map(attrgetter(*flat.names or ()), values)]
    return np.array(rows, dtype=flat).view(kind)


def number_in(state: Any, name: str) -> Any:
    """Returns a number of a dataclass, or of the record that stands for it."""
    return state[name] if isinstance(state, np.void) else getattr(state, name)


def _flat(kind: np.dtype[Any], path: str = "", offset: int = 0) -> Iterable[_Part]:
    """Yields the numbers of a record type, by their dotted names."""
    for name, (part, at, *_) in (kind.fields or {}).items():
        if part.fields:
            yield from _flat(part, f"{path}{name}.", offset + at)
        else:
            yield _Part(path + name, part, offset + at)
