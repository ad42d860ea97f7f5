"""Kernels: functions that run as they stand in the cycle, and compiled by numba in sweeps; one source for both.

A kernel is a function on numbers and records. It keeps nothing, raises nothing, and calls `math`, other kernels and the
methods of an environment only. What it works on comes in four forms:

* settings, fixed for a run: a frozen dataclass of numbers;
* state, what is remembered from SYNC to SYNC: a dataclass of numbers, changed in place;
* memory, sequences whose length the configuration chooses: buffers, changed in place; lists where Python runs the
  kernel, arrays where it is compiled;
* what it returns: numbers and NamedTuples.

Compiled, settings and state are NumPy records of the same fields. A state that is returned anew by every kernel was
tried: it is as fast compiled, but costs the cycle 1.3 to 2 times the step, as CPython makes a NamedTuple in 0.1 to
0.3 us and changes a field in 6 ns.

What has to be avoided so that both give the same bits: `x**0.5` and `x**2` (the C library's pow is neither the exact
root nor the exact product), `sum()` (Python compensates it from 3.12 on), None for a number that is missing.
"""

from collections.abc import Callable, MutableSequence
from functools import cache
from typing import Any, Final, NamedTuple, TypeAlias

Buffer: TypeAlias = MutableSequence[float]
"""Numbers that a kernel changes in place, shape (n,)."""
MakeBuffer: TypeAlias = Callable[[int], Buffer]
"""Returns a buffer of zeros of a given length."""

new: Final = tuple.__new__
"""Makes a NamedTuple of a tuple at half the price of calling its class: `new(EnergyBalance, (0.0, ...))`."""


def list_of_zeros(length: int) -> Buffer:
    """Returns a buffer for kernels that Python runs."""
    return [0.0] * length


def with_quick_fields(memory: Any) -> Any:
    """Returns an object with the fields of a NamedTuple, and of those in it, which Python reads at half the price."""
    names: tuple[str, ...] = getattr(memory, "_fields", ())
    if not names:
        return memory
    quick = _quick_class(names)()
    for name in names:
        setattr(quick, name, with_quick_fields(getattr(memory, name)))
    return quick


@cache
def _quick_class(names: tuple[str, ...]) -> Any:
    return type("Memory", (), {"__slots__": names})


class Kernel(NamedTuple):
    """A passivity algorithm of one axis as functions."""

    settings: Callable[..., Any]  # (environment, parameters, loop) -> what is fixed for a run
    state: Callable[[], Any]  # () -> state at rest
    memory: Callable[..., Any]  # (settings, make_buffer) -> buffers
    step: Callable[..., Any]  # (environment, settings, state, memory, position, torque applied) -> balance
