"""An environment as a controller asks it, several times at every SYNC: its methods on an object that is nothing else.

A model of pydantic answers every look at an attribute through a hook of Python's, at ten times the price of a plain
object, and its methods look at several. The functions here are those of the model's class, not copies of them.
"""

from functools import cache
from types import FunctionType
from typing import Any, TypeVar

from canhaptic.units import Parameters

_Environment = TypeVar("_Environment")


def plain(environment: _Environment) -> _Environment:
    """Returns an object with the same methods and numbers; one that is no parameter model is returned as it is."""
    kind: Any = type(environment)
    kind = _plain_type(kind)
    if kind is None or getattr(environment, "__pydantic_private__", None):
        return environment
    twin: Any = kind()
    for name, value in vars(environment).items():
        setattr(twin, name, value)
    return twin  # type: ignore[no-any-return]


@cache
def _plain_type(kind: type) -> Any:
    """Returns a class with what the classes of a model add to `Parameters`; None where that would not be the same."""
    if not issubclass(kind, Parameters):
        return None
    members: dict[str, Any] = {}
    for base in reversed(kind.__mro__):
        if issubclass(base, Parameters) and base is not Parameters:
            own = {name: value for name, value in vars(base).items() if _is_own(name, value)}
            if any(_names_its_class(value) for value in own.values()):
                return None  # `super()` works in the class alone that it was written in
            members |= own
    return type(kind.__name__, (), {**members, "__doc__": kind.__doc__, "__module__": kind.__module__})


def _is_own(name: str, value: object) -> bool:
    return not (name.startswith("__") or hasattr(Parameters, name) or _is_of_pydantic(value))


def _names_its_class(value: object) -> bool:
    if isinstance(value, property):
        return any(map(_names_its_class, (value.fget, value.fset, value.fdel)))
    return isinstance(value, FunctionType) and "__class__" in value.__code__.co_freevars


def _is_of_pydantic(value: object) -> bool:
    return type(value).__module__.startswith("pydantic")
