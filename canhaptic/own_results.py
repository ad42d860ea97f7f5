"""What user code hands over: objects of a Python program, and numbers, which must be finite and of plausible size."""

import sys
from collections.abc import Callable, Iterable
from functools import wraps
from numbers import Real
from pathlib import Path
from typing import Any, Final

from canhaptic.errors import CanHapticError, OwnCodeError, cause_of

GIVEN: Final[dict[str, Any]] = {}
"""Reference in a scene -> what a Python program of this process gave (`canhaptic.scene.given`)."""
GIVEN_MARK: Final = "python:"
"""Start of such a reference."""
FORCE: Final = 1e10
"""Largest force that user code of the plant may return [N or N*m]; motion and energy then stay representable."""
_ANY: Final = 1e100
"""Largest number that other user code may return [SI], since searches evaluate it far away; its square is finite."""


def watch(kind: type, names: Iterable[str], largest: float = _ANY) -> None:
    """Wrap methods of a user-defined class, so that they raise unless they return a number or a balance with a torque.

    Args:
        kind: The class; methods inherited from canhaptic are not wrapped.
        names: Names of the methods to wrap, as far as the class has them.
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
            raise OwnCodeError(program_of(self), f"{method.__name__} raised {cause_of(error)}") from error
        number = getattr(value, "torque", value)
        if not (isinstance(number, Real) and -largest <= float(number) <= largest):  # NaN as well
            shown = repr(number)[:100]
            raise OwnCodeError(
                program_of(self), f"{method.__name__} returned {shown}, expected a number within +-{largest:g}"
            )
        return value

    return watched


def program_of(owner: object) -> str:
    """Return the class of an object as `file.py:Class`."""
    kind = type(owner)
    file = getattr(sys.modules.get(kind.__module__), "__file__", None) or kind.__module__
    return f"{Path(file).name}:{kind.__qualname__}"
