"""The same code of a kernel, and of every kernel that it reaches, with other functions in the place of some."""

import builtins
from collections.abc import Callable, Mapping
from dis import get_instructions
from types import CodeType, FunctionType
from typing import TypeVar, cast

_Function = TypeVar("_Function", bound=Callable[..., object])


class Binding:
    """Functions whose global names are bound anew, each once.

    Args:
        instead: A function that is reached, or a global name -> what to take in its place.
        wrap: Makes of a function that is reached what its name is bound to.
        known: What needs no look: function -> what takes its place.
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
        """Returns the same code with other functions in the place of its global names."""
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
        """Returns a value that a function names."""
        return value

    def of(self, name: str, value: object) -> object:
        """Returns what takes the place of a function or class."""
        if value not in self._known:
            self._known[value] = self._wrap(self.rebound(value)) if isinstance(value, FunctionType) else value
        return self._known[value]


def bound(function: _Function, instead: Mapping[object, object]) -> _Function:
    """Returns a kernel as Python runs it, with other functions in the place of some that it reaches.

    Args:
        function: The kernel.
        instead: As for `Binding`.
    """
    return cast(_Function, Binding(instead).rebound(function))


def filled(function: _Function, **places: Callable[..., object]) -> _Function:
    """Returns a kernel with functions in the places that it leaves open; what those name is looked up when it runs.

    Args:
        function: The kernel.
        places: Name of a placeholder that it calls itself -> the function in its place.
    """
    kernel = cast(FunctionType, function)
    return cast(_Function, FunctionType(kernel.__code__, {**kernel.__globals__, **places}, kernel.__name__))


def _names_in(code: CodeType) -> set[str]:
    """Returns the global names that a function asks for; those of attributes are not among them."""
    inner = [_names_in(constant) for constant in code.co_consts if isinstance(constant, CodeType)]
    return {step.argval for step in get_instructions(code) if step.opname == "LOAD_GLOBAL"}.union(*inner)
