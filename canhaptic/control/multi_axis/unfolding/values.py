"""What stands for a value while source is unfolded: plain Python where it is known, else one of these."""

from enum import Enum
from math import inf, isinf, isnan
from typing import Any, Final, NamedTuple

from canhaptic.errors import ParameterError


class CannotUnfoldError(ParameterError):
    """Source that has no form of plain numbers; the message names the place and the construct."""


class Var(NamedTuple):
    """A number of the function that is written."""

    name: str
    kind: str  # "float", "int" or "bool"
    known: bool = False  # a parameter, neither 0 nor 1 nor infinite


class Cell:
    """A list made while unfolding; what is in it stands in `State.lists`."""


class Array:
    """A list of the controller that lives in the array, read and written in place."""

    def __init__(self, name: str, shape: tuple[int, ...]) -> None:
        self.name, self.shape = name, shape


class Maybe(NamedTuple):
    """An entry of a list that is there only where a condition holds."""

    condition: Var
    value: Any


class Span(NamedTuple):
    """A range whose ends are not known."""

    first: Any
    end: Any


class CellMethod(NamedTuple):
    """A method of a list made while unfolding."""

    cell: Cell
    name: str


class Dead:
    """Where the function has already returned, or left its loop."""


class Through:
    """Where a block has come to its end."""


class Mixed:
    """A local name with values of different shapes by branch; nothing may read it."""


DEAD: Final = Dead()
THROUGH: Final = Through()
MIXED: Final = Mixed()
SCALARS: Final = (float, int, bool)


def is_scalar(value: Any) -> bool:
    """Returns True for a number, known or not."""
    return isinstance(value, (Var, *SCALARS))


def is_plain(value: Any) -> bool:
    """Returns True where nothing in a value waits for data."""
    if isinstance(value, (Var, Cell, Array, Maybe, Span, Mixed)):
        return False
    return all(is_plain(v) for v in value) if isinstance(value, (tuple, list)) else True


def kind_of(value: Any) -> str:
    """Returns "float", "int" or "bool"."""
    if isinstance(value, Var):
        return value.kind
    return "bool" if isinstance(value, bool) else "int" if isinstance(value, int) else "float"


def text_of(value: Any) -> str:
    """Returns how a number is written."""
    if isinstance(value, Var):
        return value.name
    if isinstance(value, Enum):
        return repr(int(value.value))
    if isinstance(value, float) and (isinf(value) or isnan(value)):
        return "inf" if value == inf else "(-inf)" if value == -inf else "(inf - inf)"
    if not isinstance(value, SCALARS):
        raise CannotUnfoldError(f"compiled: got {value!r} where a number is needed")
    return f"({value!r})" if value < 0 else repr(value)


def as_kind(value: Any, kind: str) -> str:
    """Returns how a number is written where one of another kind is kept."""
    text = text_of(value)
    if kind_of(value) == kind:
        return text
    if kind_of(value) == "bool":
        return f"({'1.0' if kind == 'float' else '1'} if {text} else {'0.0' if kind == 'float' else '0'})"
    return f"{kind}({text})"


def known_other(value: Any, number: Any) -> bool:
    """Returns True where a parameter is surely not a number."""
    return isinstance(value, Var) and value.known and number in (0.0, 1.0)
