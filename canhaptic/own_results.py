"""Check of the results of user code: each must be a finite number of plausible size, or the run ends with an error."""

import sys
from collections.abc import Callable, Iterable
from functools import wraps
from numbers import Real
from pathlib import Path
from typing import Final

from canhaptic.errors import CanHapticError, OwnCodeError

FORCE: Final = 1e10
"""Largest force that own code of the plant may return [N or N*m]; its motion still fits an encoder and its energy."""
_ANY: Final = 1e100
"""Largest number where a search may ask far from where the axis is [SI]; its square and the sums of it are numbers."""


def watch(kind: type, names: Iterable[str], largest: float = _ANY) -> None:
    """Make methods of a user-defined class return only numbers, or balances with a numeric torque; others are the same.

    Args:
        kind: The class; methods that it inherits from canhaptic are not touched.
        names: Methods that return a number, if the class has them.
        largest: Largest allowed magnitude.
    """
    for owner in kind.__mro__:
        if not owner.__module__.startswith("canhaptic."):
            for name in names:
                method = vars(owner).get(name)
                if callable(method) and not hasattr(method, "__wrapped__"):
                    setattr(owner, name, _watched(method, largest))


def _watched(method: Callable[..., object], largest: float) -> Callable[..., object]:
    @wraps(method)
    def watched(self: object, *arguments: object, **named: object) -> object:
        try:
            value = method(self, *arguments, **named)
        except CanHapticError:
            raise
        except Exception as error:  # own code may raise anything
            raise OwnCodeError(program_of(self), f"{method.__name__} raised {type(error).__name__}: {error}") from error
        number = getattr(value, "torque", value)
        if not (isinstance(number, Real) and -largest <= float(number) <= largest):  # NaN as well
            shown = repr(number)[:100]
            raise OwnCodeError(
                program_of(self), f"{method.__name__} returned {shown}, expected a number within +-{largest:g}"
            )
        return value

    return watched


def program_of(owner: object) -> str:
    """Return `file.py:Class`."""
    kind = type(owner)
    file = getattr(sys.modules.get(kind.__module__), "__file__", None) or kind.__module__
    return f"{Path(file).name}:{kind.__qualname__}"
