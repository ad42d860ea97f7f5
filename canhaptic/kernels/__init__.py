"""Kernels: functions that Python runs in the cycle and numba compiles for sweeps, from one source.

A kernel is a function of numbers and records. It stores nothing, raises nothing, and calls only `math`, other kernels
and methods of an environment. Its data come in four forms:

* settings, fixed for a run: a frozen dataclass of numbers and of the parameters, of which only numbers are read;
* state, kept from SYNC to SYNC: a dataclass of numbers, changed in place;
* memory, whose size the configuration determines: buffers, changed in place; lists where Python runs the kernel,
  arrays where it is compiled;
* results: numbers and NamedTuples.

Compiled, settings and state are NumPy records of the same fields. Returning a new state from every kernel was tried:
compiled it is as fast, but in the cycle a step takes 1.3 to 2 times as long, because CPython makes a NamedTuple in 0.1
to 0.3 us and changes a field in 6 ns.

Both forms must give the same bits. A kernel therefore avoids `x**0.5` and `x**2` (the C library's pow is neither the
exact root nor the exact product), `sum()` (compensated by Python from 3.12 on), and None for a missing number.
"""

from collections.abc import Callable, MutableSequence, Sequence
from functools import cache
from types import FunctionType
from typing import Any, Final, Generic, NamedTuple, TypeAlias, TypeVar, cast

Buffer: TypeAlias = MutableSequence[float]
"""Numbers that a kernel changes in place, shape (n,)."""
Matrix: TypeAlias = Sequence[Buffer]
"""Rows of buffers, shape (m, n)."""
Indices: TypeAlias = MutableSequence[int]
"""Whole numbers, shape (n,)."""
MakeBuffer: TypeAlias = Callable[[int], Buffer]
"""Function that returns a buffer of zeros of a given length."""

_Memory = TypeVar("_Memory")
GivenT = TypeVar("GivenT")
SettingsT = TypeVar("SettingsT", covariant=True)
StateT = TypeVar("StateT", covariant=True)
MemoryT = TypeVar("MemoryT")

OFTEN_ZERO: Final = "often zero"
"""Mark of a number in settings, `Annotated[float, OFTEN_ZERO]`: if it is 0 in all scenes, it is a constant of their
compiled loop, which leaves out what only another value needs. Scenes with other zeros have a loop of their own."""

new: Final = tuple.__new__
"""Makes a NamedTuple from a tuple in half the time of calling its class: `new(EnergyBalance, (0.0, ...))`."""


def list_of_zeros(length: int) -> Buffer:
    """Return a list of zeros, the form of a buffer for kernels that Python runs."""
    return [0.0] * length


def zeros(rows: int, columns: int) -> Matrix:
    """Return a matrix of zeros for kernels that Python runs."""
    return [list_of_zeros(columns) for _ in range(rows)]


def fields_of(kind: object) -> tuple[str, ...]:
    """Names of the fields of a NamedTuple or of its class; empty for anything else."""
    names: tuple[str, ...] = getattr(kind, "_fields", ())
    return names


def with_quick_fields(memory: _Memory) -> _Memory:
    """Copy of a NamedTuple, nested ones included, whose fields Python reads in half the time."""
    names = fields_of(memory)
    if not names:
        return memory
    kind: type = type(memory)
    quick = _quick_class(kind)()
    for name in names:
        setattr(quick, name, with_quick_fields(getattr(memory, name)))
    return cast(_Memory, quick)


@cache
def _quick_class(kind: type) -> type:
    methods = {n: of for n, of in vars(kind).items() if isinstance(of, FunctionType) and not n.startswith("_")}
    return type(kind.__name__, (), {"__slots__": fields_of(kind), **methods})


class Run(NamedTuple, Generic[SettingsT, StateT, MemoryT]):
    """Settings, state and memory of a kernel."""

    settings: SettingsT
    state: StateT
    memory: MemoryT


class Kernel(NamedTuple):
    """A passivity algorithm as four functions; the comments give their arguments for one axis.

    For several axes with the `GroupModel` `world` they are settings(world, parameters, loops), state(),
    memory(world, settings), and step(world, Run, samples lost before, positions, torques applied) -> `GroupHold`.
    """

    settings: Callable[..., Any]  # (environment, parameters, loop) -> constants of a run
    state: Callable[[], Any]  # () -> state at rest
    memory: Callable[..., Any]  # (settings, make_buffer) -> buffers
    step: Callable[..., Any]  # (environment, Run, position, torque applied) -> balance
