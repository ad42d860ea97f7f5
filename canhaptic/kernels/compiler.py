"""Kernels compiled by numba, each with every kernel that it reaches; needs the extra `fast`.

The source is that of the functions; only their global names are bound to compiled functions. No floating-point
operation is reordered or fused, and a division by zero gives an infinity, so that both forms give the same bits.
Reference counts of arrays are left out - a kernel makes no array - which makes it ten times faster.
"""

from collections.abc import Callable, Collection, Iterable, Mapping
from pathlib import Path
from secrets import token_hex
from types import CodeType, FunctionType
from typing import Final, Protocol, TypeVar, cast

import numba
from numba import types
from numba.extending import overload_method
from numba.np.unsafe.ndarray import to_fixed_tuple

from canhaptic.errors import InputError
from canhaptic.kernels import fields_of, new
from canhaptic.kernels.binding import Binding
from canhaptic.kernels.code_cache import CheckedCache, kept_code

_OPTIONS: Final[dict[str, object]] = {"error_model": "numpy", "_nrt": False}
_INNER: Final = {**_OPTIONS, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
"""Options of functions that are never called from Python: a fifth less to compile."""
METHODS: Final = (
    "contact",
    "true_state",
    "admissible",
    "stored_energy",
    "effort",
    "state_of_energy",
    "relaxed",
    "locate",
    "measure",
    "energy",
    "add_gradient",
    "add_discrete_gradient",
    "add_slopes",
    "add_change",
    "fill_structure",
)
"""What a kernel may ask an environment, a mechanism, a geometry and the functions of a network."""

_PROCESS: Final = token_hex(8)
"""A part of the name of every function that this process compiles. numba names a record type by a number that counts
from 0 in each process, so that code from two processes may have one name for two types, and the first that is loaded
would be taken for both."""

_Function = TypeVar("_Function", bound=Callable[..., object])


class _Dispatcher(Protocol):
    """A function compiled by numba, with the place of its code."""

    _cache: object

    def __call__(self, *args: object) -> object: ...


class _Njit(Protocol):
    def __call__(self, function: Callable[..., object], **options: object) -> _Dispatcher: ...


_njit: Final = cast(_Njit, numba.njit)

fixed_tuple: Final = cast(Callable[[object, int], tuple[float, ...]], to_fixed_tuple)
"""(array, length) -> tuple of its numbers; the length is a global name of the function that calls it."""


def compiled(
    function: _Function,
    instead: Mapping[object, object] | None = None,
    *,
    keep: bool = False,
    parts: Iterable[type] = (),
    calls: Collection[Callable[..., object]] | None = None,
) -> _Function:
    """Return a kernel as a function that is compiled at its first call.

    Args:
        function: The kernel.
        instead: Replacements by function reached, or by global name.
        keep: Whether the machine code is kept on disk for the next process.
        parts: Classes whose methods it calls, but does not name.
        calls: Functions that stay calls, because they are long and called from several places, while every other
            becomes a part of those that call it: that halves the time of a loop, for the arrays of a NamedTuple are
            some fifty words, which a call hands on. None leaves it to LLVM.

    Raises:
        InputError: A NamedTuple that it names has a field with the name of a method.
    """
    compiling = _Compiling(instead or {}, calls)
    rebound = compiling.rebound(function)
    for kind in parts:
        compiling.look_at(kind)
    if not keep:
        return cast(_Function, _njit(rebound, **_OPTIONS))
    made = _njit(rebound, **_OPTIONS)
    with kept_code(compiling.sources) as can_keep:
        if can_keep:
            made._cache = CheckedCache(function)  # noqa: SLF001 - as `enable_caching` does
    return cast(_Function, made)


class _Compiling(Binding):
    """Functions found on the way, each compiled once.

    Attributes:
        sources: Determinants of the machine code: the code of every function, and the constants that they name.
    """

    def __init__(self, instead: Mapping[object, object], calls: Collection[Callable[..., object]] | None) -> None:
        codes = {cast(FunctionType, function).__code__ for function in calls or ()}

        def wrap(function: FunctionType) -> object:
            return _njit(function, **_INNER, forceinline=calls is not None and function.__code__ not in codes)

        super().__init__(instead, wrap, {new: _made})
        self.sources: list[str] = [repr(_OPTIONS), Path(__file__).read_text(encoding="utf-8")]
        self.sources.append(repr(calls and sorted(cast(FunctionType, function).__name__ for function in calls)))

    def rebound(self, function: Callable[..., object]) -> FunctionType:
        """Return the same code with compiled functions in the place of its global names."""
        function = cast(FunctionType, function)
        self.sources.append(_text_of(function.__code__) + repr(function.__defaults__))
        made = super().rebound(function)
        made.__qualname__ = f"{function.__name__}_{_PROCESS}"
        return made

    def constant(self, name: str, value: object) -> object:
        """Value that a function names; adds it to the sources."""
        self.sources.append(f"{name}={value!r}")
        return value

    def of(self, name: str, value: object) -> object:
        """Replacement of a function or class; adds a class's content to the sources."""
        if value not in self._known and isinstance(value, type):
            self.look_at(value)
        elif not isinstance(value, FunctionType):
            self.sources.append(f"{name}={getattr(value, '__name__', name)}")
        return super().of(name, value)

    def look_at(self, kind: type) -> None:
        """Add the fields of a class and the code of its methods to the sources.

        Raises:
            InputError: A field of a NamedTuple has the name of a method, and numba would take it for the method.
        """
        taken = sorted(set(fields_of(kind)).intersection(METHODS))
        if taken:
            raise InputError(
                f"{kind.__name__}: got a field {taken[0]!r}, expected a name that is no method of an environment, a "
                "mechanism or a geometry: compiled code would take the field for the method; give it another name"
            )
        self.sources.append(f"{kind.__qualname__}{fields_of(kind)}")
        for method in METHODS:
            if isinstance(getattr(kind, method, None), FunctionType):
                self.rebound(getattr(kind, method))


def _text_of(code: CodeType) -> str:
    constants = [_text_of(part) if isinstance(part, CodeType) else repr(part) for part in code.co_consts]
    return repr((code.co_name, code.co_code, constants, code.co_names, code.co_varnames, code.co_freevars))


def _make(kind: Callable[..., object], values: Iterable[object]) -> object:
    return kind(*values)


_made: Final = _njit(_make, **_OPTIONS, forceinline=True)


class _NumbaTuple(Protocol):
    """numba's type of a NamedTuple."""

    instance_class: type


def _overload(name: str) -> None:
    @overload_method(types.BaseNamedTuple, name)
    def method(self: object, *args: object) -> Callable[..., object]:  # numba asks that both be annotated alike
        function = compiled(getattr(cast(_NumbaTuple, self).instance_class, name))

        def call(self: object, *args: object) -> object:
            return function(self, *args)

        return call


for _name in METHODS:
    _overload(_name)
