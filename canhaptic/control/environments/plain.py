"""Plain form of an environment: its methods on an object without pydantic.

A pydantic model routes every attribute access through a Python hook, at ten times the price of a plain object, and its
methods read several. The functions here are those of the model's class, not copies of them. Properties are evaluated
once: an environment never changes.
"""

from collections import namedtuple
from collections.abc import Callable, Mapping
from functools import cache
from types import FunctionType
from typing import Any, NamedTuple, TypeVar

from canhaptic.units import Parameters

_Environment = TypeVar("_Environment")


class _Form(NamedTuple):
    """Additions of a model's classes to `Parameters`."""

    plain: Any  # class with the methods and the values of the class
    derived: Mapping[str, Callable[[Any], Any]]  # properties


def plain(environment: _Environment) -> _Environment:
    """Return an object with the same methods and numbers; one that is no parameter model is returned as it is."""
    kind: Any = type(environment)
    if _form_of(kind) is None or getattr(environment, "__pydantic_private__", None):
        return environment
    return plain_with(kind, vars(environment))  # type: ignore[no-any-return]


def plain_with(kind: Any, fields: Mapping[str, Any]) -> Any:
    """Plain object of a model's class with given fields, without validation."""
    form = _form_of(kind)
    if form is None:
        raise TypeError(f"{kind.__name__}: expected a class of parameters")
    twin = form.plain()
    for name, value in fields.items():
        setattr(twin, name, value)
    for name, derive in form.derived.items():
        setattr(twin, name, derive(twin))
    return twin


def _numbers_of(twin: Any) -> dict[str, float]:
    """Every number of a plain object by name, including those of its class; NaN for None."""
    values = {
        **{name: value for base in type(twin).__mro__[-2::-1] for name, value in vars(base).items()},
        **vars(twin),
    }
    return {
        name: float("nan") if value is None else float(value)
        for name, value in values.items()
        if (value is None or isinstance(value, int | float)) and not name.startswith("_")
    }


def tuple_type(twin: Any) -> Any:
    """Return the NamedTuple of the numbers of a plain object, with its methods; what numba compiles."""
    kind: Any = type(twin)
    return _tuple_type(kind, tuple(_numbers_of(twin)))


@cache
def _tuple_type(kind: Any, fields: tuple[str, ...]) -> Any:
    methods = {name: value for name, value in vars(kind).items() if isinstance(value, FunctionType)}
    return type(kind.__name__, (namedtuple(kind.__name__, fields),), {**methods, "__slots__": ()})


@cache
def _form_of(kind: Any) -> _Form | None:
    """Return the plain form of a model's class; None where it would not be the same."""
    if not issubclass(kind, Parameters):
        return None
    members: dict[str, Any] = {}
    for base in reversed(kind.__mro__):
        if issubclass(base, Parameters) and base is not Parameters:
            own = {name: value for name, value in vars(base).items() if _is_own(name, value)}
            if any(_names_its_class(value) for value in own.values()):
                return None  # `super()` works in the class alone that it was written in
            members |= own
    derived = {name: value.fget for name, value in members.items() if isinstance(value, property) and value.fget}
    kept = {name: value for name, value in members.items() if not isinstance(value, property)}
    attributes = {**kept, "__doc__": kind.__doc__, "__module__": kind.__module__}
    return _Form(type(kind.__name__, (), attributes), derived)


def _is_own(name: str, value: object) -> bool:
    return not (name.startswith("__") or hasattr(Parameters, name) or _is_of_pydantic(value))


def _names_its_class(value: object) -> bool:
    if isinstance(value, property):
        return any(map(_names_its_class, (value.fget, value.fset, value.fdel)))
    return isinstance(value, FunctionType) and "__class__" in value.__code__.co_freevars


def _is_of_pydantic(value: object) -> bool:
    return type(value).__module__.startswith("pydantic")
