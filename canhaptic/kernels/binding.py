"""Copies of a kernel, and of every kernel that it reaches, with some functions replaced."""

import builtins
from collections.abc import Callable, Mapping
from dis import get_instructions
from types import CodeType, FunctionType
from typing import TypeVar, cast

from canhaptic.errors import ParameterError

_Function = TypeVar("_Function", bound=Callable[..., object])


class Binding:
    """Copies of functions with global names bound to replacements, each copied once.

    Args:
        instead: Replacements by function reached, or by global name.
        wrap: Makes the binding of a reached function's name.
        known: Functions with known replacements, used without inspection.
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
        """The same code with other functions in the place of its global names."""
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
        """Value that a function names."""
        return value

    def of(self, name: str, value: object) -> object:
        """Replacement of a function or class."""
        if value not in self._known:
            self._known[value] = self._wrap(self.rebound(value)) if isinstance(value, FunctionType) else value
        return self._known[value]


def bound(function: _Function, instead: Mapping[object, object]) -> _Function:
    """A kernel for Python, with some of the functions that it reaches replaced.

    Args:
        function: The kernel.
        instead: As for `Binding`.
    """
    return cast(_Function, Binding(instead).rebound(function))


def filled(function: _Function, **places: Callable[..., object]) -> _Function:
    """A kernel with its placeholders filled; the names in those functions are resolved when it runs.

    Args:
        function: The kernel.
        places: Name of a placeholder that it calls itself -> the function in its place.

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
                f"{given.__name__}: takes {taken} arguments in the place of {name}, expected {len(words)}: "
                f"({', '.join(words)}); see docs/extending.md"
            )
    return cast(_Function, FunctionType(kernel.__code__, {**kernel.__globals__, **places}, kernel.__name__))


def _names_in(code: CodeType) -> set[str]:
    """Global names that a function uses, attributes not included."""
    inner = [_names_in(constant) for constant in code.co_consts if isinstance(constant, CodeType)]
    return {step.argval for step in get_instructions(code) if step.opname == "LOAD_GLOBAL"}.union(*inner)
