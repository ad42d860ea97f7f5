"""Passivity algorithms for a loop of your own: no CAN, no file, no thread; pydantic is the only dependency.

A controller takes the position at a sample and the torque held until then; it returns the next torque, and the energies
of the hold that ended. See "A loop of your own" in docs/from_python.md. `passivity.pyi` lists the names; each is
imported when it is first used.
"""

import importlib
from typing import Any, Final

from canhaptic import listed

_PLACES: Final = listed(__file__)
__all__ = list(_PLACES)


def __dir__() -> list[str]:
    """Return the public names."""
    return sorted(__all__)


def __getattr__(name: str) -> Any:
    """Import a public name on its first use (PEP 562)."""
    if name not in _PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(_PLACES[name]), name)
