"""canhaptic: passive haptic rendering on industrial CiA 402 servo drives over CAN.

    import canhaptic

    result = canhaptic.simulate("configs/demo.yaml", {"environment.stiffness": "500 N/m"})
    print(result.account["handle"].margin)

Names are imported when they are first used, so that `import canhaptic` costs nothing; `__init__.pyi` lists them.
"""

import importlib
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final


def listed(file: str) -> dict[str, str]:
    """Return the names that the stub of a module lists, each with the module that defines it.

    Args:
        file: File of the module; its stub has a line `from MODULE import NAME as NAME` for each name.
    """
    stub = Path(file).with_suffix(".pyi").read_text(encoding="utf-8")
    return {name: module for module, name in re.findall(r"(?m)^from (\S+) import (\w+) as \2$", stub)}


def door(file: str, name: str) -> tuple[list[str], Callable[[], list[str]], Callable[[str], Any]]:
    """Return `__all__`, `__dir__` and `__getattr__` of a module whose stub lists its names (PEP 562).

    Args:
        file: File of the module.
        name: Name of the module, for errors.
    """
    places = listed(file)

    def look_up(wanted: str) -> Any:
        if wanted not in places:
            raise AttributeError(f"module {name!r} has no attribute {wanted!r}")
        return getattr(importlib.import_module(places[wanted]), wanted)

    return list(places), lambda: sorted(places), look_up


_PUBLIC: Final = listed(__file__)
__all__ = [name for name, module in _PUBLIC.items() if module != __name__]


def __dir__() -> list[str]:
    """Return the public names, modules included."""
    return sorted(_PUBLIC)


def __getattr__(name: str) -> Any:
    """Import a public name on its first use (PEP 562)."""
    if name == "__version__":
        from importlib.metadata import version

        return version(__name__)
    if name not in _PUBLIC:
        raise AttributeError(f"module 'canhaptic' has no attribute {name!r}")
    if _PUBLIC[name] == __name__:
        return importlib.import_module(f"{__name__}.{name}")
    return getattr(importlib.import_module(_PUBLIC[name]), name)
