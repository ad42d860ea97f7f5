"""Interface of an object dictionary, for any reader."""

from collections.abc import Iterator
from typing import Any, Protocol


class Variable(Protocol):
    """One object, or one subindex of it (CiA 306)."""

    name: str
    index: int
    subindex: int
    data_type: int | None
    """A `DataType`; None where the file states none."""
    access_type: str
    """ro, wo, rw, rwr, rww or const."""
    default: Any
    value: Any
    """ParameterValue of a DCF; None where the file states none."""
    min: int | None
    max: int | None
    pdo_mappable: bool

    @property
    def readable(self) -> bool:
        """Whether SDO may read it."""

    @property
    def writable(self) -> bool:
        """Whether SDO may write it."""


class Dictionary(Protocol):
    """The objects of one drive by index."""

    def __contains__(self, index: int, /) -> bool:
        """Whether an object is listed."""

    def __iter__(self) -> Iterator[int]:
        """Yield the indices."""

    def __getitem__(self, index: int, /) -> Any:
        """An object: a `Variable`, or an entry with `subindices`."""

    def get_variable(self, index: int, subindex: int = 0) -> Variable | None:
        """Return an object or one of its subindices; None where it is not listed."""


def variables(dictionary: Dictionary) -> Iterator[Variable]:
    """Yield every object without subindices, and every subindex of the others."""
    for index in dictionary:
        item = dictionary[index]
        members = getattr(item, "subindices", None)
        yield from (item,) if members is None else members.values()


def is_writable(dictionary: Dictionary, index: int, subindex: int = 0) -> bool:
    """Whether the dictionary lists the object as writable."""
    variable = dictionary.get_variable(index, subindex)
    return variable is not None and bool(variable.writable)
