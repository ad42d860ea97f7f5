"""Tables in which user-defined environments, algorithms, effects, hands, kinematics and networks are registered.

Such a part is a class with the methods of its protocol. Scenes can use it once a table names it::

    from canhaptic.extending import ENVIRONMENTS

    ENVIRONMENTS["centering_spring"] = "centering_spring:CenteringSpring"

Examples are in docs/extending.md. `extending.pyi` lists the names; each is imported when it is first used.
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
