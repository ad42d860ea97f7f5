"""Copies of kernels with some functions replaced, and their data as NumPy records and arrays for compiled code."""

import builtins
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import fields, is_dataclass
from dis import get_instructions
from operator import attrgetter
from types import CodeType, FunctionType
from typing import Final, TypeAlias, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from canhaptic.errors import ParameterError
from canhaptic.kernels import OFTEN_ZERO, Buffer, Indices, Matrix, fields_of

_Function = TypeVar("_Function", bound=Callable[..., object])


class Binding:
    """Copies functions, each once, and binds global names in the copies to replacements.

    Args:
        instead: Function or global name that a copied function uses -> its replacement.
        wrap: Makes the object to which the name of a reached function is bound.
        known: Replacements of functions that are not inspected.
    """

    def __init__(
        self,
        instead: Mapping[object, object],
        wrap: Callable[[FunctionType], object] = lambda function: function,
        known: Mapping[object, object] | None = None,
    ) -> None:
        self._instead, self._wrap = instead, wrap
        self._known: dict[object, object] = dict(known or {})

    def rebound(self, function: Callable[..., object]) -> FunctionType:
        """Copy of a function whose global names are bound to the replacements."""
        function = cast(FunctionType, function)
        found: dict[str, object] = {"__name__": function.__module__, "__builtins__": builtins}
        for name in sorted(_names_in(function.__code__)):
            if name in function.__globals__:
                found[name] = self._value(name, function.__globals__[name])
        return FunctionType(function.__code__, found, function.__name__, function.__defaults__)

    def _value(self, name: str, value: object) -> object:
        value = self._instead.get(name, value)
        return self.of(name, self._instead.get(value, value)) if callable(value) else self.constant(name, value)

    def constant(self, name: str, value: object) -> object:
        """Return the value to bind to a constant that a function names."""
        return value

    def of(self, name: str, value: object) -> object:
        """Return the object to bind to a function or class that a function names."""
        if value not in self._known:
            self._known[value] = self._wrap(self.rebound(value)) if isinstance(value, FunctionType) else value
        return self._known[value]


def bound(function: _Function, instead: Mapping[object, object]) -> _Function:
    """Return a copy of a kernel, to run in Python, with some of the functions that it reaches replaced.

    Args:
        function: The kernel.
        instead: As for `Binding`.
    """
    return cast(_Function, Binding(instead).rebound(function))


def filled(function: _Function, **places: Callable[..., object]) -> _Function:
    """Return a copy of a kernel that calls given functions in place of its placeholder functions.

    Args:
        function: The kernel.
        places: Name of a placeholder that the kernel itself calls -> the function to call instead.

    Raises:
        ParameterError: A function takes another number of arguments than its place.
    """
    kernel = cast(FunctionType, function)
    for name, given in places.items():
        place = cast(FunctionType, kernel.__globals__[name]).__code__
        words, code = place.co_varnames[: place.co_argcount], getattr(given, "__code__", None)  # a builtin has none
        taken = len(words) if code is None else code.co_argcount
        if taken != len(words):
            raise ParameterError(
                f"{given.__name__}: takes {taken} arguments in place of {name}, expected {len(words)}: "
                f"({', '.join(words)}); see docs/extending.md"
            )
    return cast(_Function, FunctionType(kernel.__code__, {**kernel.__globals__, **places}, kernel.__name__))


def _names_in(code: CodeType) -> set[str]:
    """Global names that a function uses, attributes not included."""
    inner = [_names_in(constant) for constant in code.co_consts if isinstance(constant, CodeType)]
    return {step.argval for step in get_instructions(code) if step.opname == "LOAD_GLOBAL"}.union(*inner)


Records = NDArray[np.void]
_Kind: TypeAlias = np.dtype[np.generic]
_Value = TypeVar("_Value")
_ARRAYS: Final[dict[object, type[np.generic]]] = {Buffer: np.float64, Matrix: np.float64, Indices: np.int64}
"""Annotation of a field that holds a buffer -> type of the buffer's numbers."""


_NUMBER: Final = (float, int, np.generic)


def record_type(values: Sequence[object], *, plain: bool = False) -> np.dtype[np.void]:
    """NumPy record type of the numbers of similar objects, nested objects included; see `_parts_of`.

    A further field, named by `of_zero`, says that a field of `OFTEN_ZERO` is 0 in all of them; none does if `plain`.
    """
    kinds, often_zero = list[tuple[str, object]](), set[str]() if plain else _often_zero(values[0])
    for name, part in _parts_of(values[0]):
        if not isinstance(part, _NUMBER):
            kinds.append((name, record_type([getattr(value, name) for value in values], plain=plain)))
            continue
        kinds.append((name, type(part)))
        if name in often_zero and not any(getattr(value, name) for value in values):
            kinds.append((of_zero(name, type(part)), np.int8))
    return np.dtype(kinds, align=True)


def of_zero(name: str, kind: type) -> str:
    """Return the name of the field that marks a field of zeros, given the type of its numbers."""
    return f"{name} = {kind()}"


def _often_zero(value: object) -> set[str]:
    annotations: dict[str, object] = getattr(type(value), "__annotations__", {})
    return {name for name, kind in annotations.items() if OFTEN_ZERO in getattr(kind, "__metadata__", ())}


def _parts_of(value: object) -> list[tuple[str, object]]:
    """Return the fields of a dataclass, or the numbers of the plain object of a parameter model."""
    if is_dataclass(value):
        return [(field.name, getattr(value, field.name)) for field in fields(value)]
    return [(name, part) for name, part in vars(value).items() if isinstance(part, _NUMBER)]


def records_of(values: Iterable[object], *, plain: bool = False) -> Records:
    """Return dataclasses of one class as records, shape (n,); `plain` as for `record_type`."""
    values = list(values)
    kind = record_type(values, plain=plain)
    names, kinds, offsets = zip(*_flat(kind), strict=True)
    flat = np.dtype({"names": names, "formats": kinds, "offsets": offsets, "itemsize": kind.itemsize})
    read = attrgetter(*names)
    rows = [(read(value),) for value in values] if len(names) == 1 else [*map(read, values)]
    return np.array(rows, dtype=flat).view(kind)


def _flat(kind: _Kind, path: str = "", offset: int = 0) -> Iterable[tuple[str, _Kind, int]]:
    """Yield dotted name, type and offset of the numbers of a record type."""
    for name, (part, at, *_) in (kind.fields or {}).items():
        if part.fields:
            yield from _flat(part, f"{path}{name}.", offset + at)
        elif " = " not in name:  # which marks a field of zeros
            yield path + name, part, offset + at


def arrays_of(value: _Value) -> _Value:
    """Copy of a NamedTuple, nested ones included, with arrays in place of its buffers.

    The annotation of a field says what it is: `Buffer`, `Indices`, `Matrix`, or anything else, which is kept.
    """
    kind = type(value)
    if not fields_of(kind):
        return value
    found: list[object] = []
    for name in fields_of(kind):
        part, annotation = getattr(value, name), kind.__annotations__[name]
        if annotation in _ARRAYS:
            number, shape = _form(annotation, part)
            found.append(np.array(part, dtype=number).reshape(shape))
        else:
            found.append(arrays_of(part))
    return kind(*found)


def record_of(value: object) -> Records:
    """Convert a NamedTuple of buffers, nested NamedTuples and dataclasses to one structured array, shape (1,).

    Compiled code takes the record by its address, and its type states the lengths of the arrays. A tuple of arrays
    would be passed as hundreds of arguments.
    """
    record: Records = np.zeros(1, _record_type(value))
    _fill(record[0], value)
    return record


def _record_type(value: object) -> np.dtype[np.void]:
    if is_dataclass(value):
        return record_type([value])
    kind = type(value)
    parts, often_zero = list[tuple[str, object] | tuple[str, object, tuple[int, ...]]](), _often_zero(value)
    for name in fields_of(kind):
        part, annotation = getattr(value, name), kind.__annotations__[name]
        if annotation in _ARRAYS:
            parts.append((name, *_form(annotation, part)))
        elif isinstance(part, list):
            parts.append((name, record_type(part), (len(part),)))
        else:
            parts.append((name, _record_type(part)))
        if name in often_zero and not part:
            parts.append((of_zero(name, type(part)), np.int8))
    return np.dtype(parts, align=True) if parts else cast("np.dtype[np.void]", np.dtype(kind))


def _form(annotation: object, value: Buffer | Matrix | Indices) -> tuple[type[np.generic], tuple[int, ...]]:
    """Return type and shape of the array of a buffer."""
    inner = (len(cast(Matrix, value)[0]) if len(value) else 0,) if annotation == Matrix else ()
    return _ARRAYS[annotation], (len(value), *inner)


def _fill(record: np.void, value: object) -> None:
    for name in fields_of(value):
        part = getattr(value, name)
        if hasattr(part, "_fields"):
            _fill(record[name], part)
        elif record[name].size:
            record[name] = records_of(part) if isinstance(part, list) and is_dataclass(part[0]) else part
