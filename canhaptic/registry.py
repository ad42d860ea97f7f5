"""Lookup of a name of a scene in a table of classes, or in what installed packages offer as entry points.

The module of a class, or of an entry point, is imported on demand.
"""

import difflib
import importlib
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from canhaptic.errors import InputError, ParameterError, cause_of

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

GROUPS: Final = {
    "environment": "canhaptic.environments",
    "passivity algorithm": "canhaptic.algorithms",
    "effect": "canhaptic.effects",
    "hand": "canhaptic.hands",
    "sensor": "canhaptic.sensors",
    "sink": "canhaptic.sinks",
    "display": "canhaptic.displays",
    "exporter": "canhaptic.exporters",
}
"""Kind of part -> group of the entry points that offer it."""


def load(table: Mapping[str, str], name: str, kind: str, further: Iterable[str] = ()) -> Any:
    """Return the class that `table` lists as "module:Class" under `name`.

    Args:
        table: Name -> "module:Class".
        name: Requested name.
        kind: Kind of entries in the table, for the message ("environment", "passivity algorithm", ...).
        further: Further names for the message.

    Raises:
        ParameterError: The name is not in the table; the nearest name is offered.
    """
    if name not in table:
        known = sorted({*table, *further})
        raise ParameterError(f"unknown {kind} {name!r}, expected one of: {', '.join(known)}{nearest(name, known)}")
    module, _, attribute = table[name].partition(":")
    return getattr(importlib.import_module(module), attribute)


def load_algorithm(table: Mapping[str, str], name: str, kind: str, parameters: object | None) -> tuple[Any, Any]:
    """Return an algorithm and the parameters to build it with.

    Args:
        table: As for `load`; every class has a `parameters_type`.
        name: Requested name.
        kind: Kind of entries in the table.
        parameters: Parameters of the algorithm; None for its defaults.

    Raises:
        ParameterError: The name is not in the table, or the parameters belong to another algorithm.
    """
    algorithm = load(table, name, kind)
    if parameters is None:
        return algorithm, algorithm.parameters_type()
    if not isinstance(parameters, algorithm.parameters_type):
        text = f"{kind} {name!r}: got parameters {type(parameters).__name__}"
        raise ParameterError(f"{text}, expected {algorithm.parameters_type.__name__}")
    return algorithm, parameters


def nearest(name: str, names: Iterable[str], most: int = 1) -> str:
    """Return `; did you mean 'stiffness'?` for the end of a message; "" if no name is similar."""
    near = difflib.get_close_matches(name, list(names), n=most)
    return f"; did you mean {' or '.join(map(repr, near))}?" if near else ""


def unknown_key(key: str, names: Iterable[str]) -> str:
    """Return the message about an unknown key, with the nearest known key or all known keys."""
    known = sorted(set(names))
    return f"unknown key{nearest(key, known) or '; expected one of: ' + ', '.join(known)}"


def offered() -> "dict[str, dict[str, EntryPoint]]":
    """Return what installed packages offer, by kind and name."""
    from importlib.metadata import entry_points  # a plain run loads nothing of it

    found = entry_points()
    return {kind: {of.name: of for of in found.select(group=group)} for kind, group in GROUPS.items()}


def installed(kind: str) -> "dict[str, EntryPoint]":
    """Return what installed packages offer of a kind, by name; of an unknown kind nothing."""
    return offered().get(kind, {})


def package_of(found: "EntryPoint") -> str:
    """Return name and version of the package that offers an entry point."""
    return f"{found.dist.name} {found.dist.version}" if found.dist is not None else found.value


def loaded(found: "EntryPoint") -> tuple[Any, bytes]:
    """Import an entry point; return it, and the content of its module.

    Raises:
        ParameterError: It cannot be imported.
    """
    try:
        chosen = found.load()
        return chosen, Path(str(sys.modules[chosen.__module__].__file__)).read_bytes()
    except Exception as error:  # foreign code may raise anything
        text = f"{found.name}: the plug-in {package_of(found)} cannot be used ({type(error).__name__}: {error})"
        raise ParameterError(f"{text}; mend or remove that package") from error


def function_of(kind: str, name: str) -> Any:
    """Return the function that an installed package offers; what it raises names the package.

    Raises:
        InputError: No package offers it, or it cannot be imported.
    """
    known = installed(kind)
    if name not in known:
        text = f"unknown {kind} {name!r}: {', '.join(sorted(known)) or 'no installed package offers one'}"
        raise InputError(f"{text}{nearest(name, known)}")
    function, _ = loaded(known[name])

    def called(*values: object) -> object:
        try:
            return function(*values)
        except OSError:
            raise
        except Exception as error:  # foreign code may raise anything
            text = f"the {kind} {name} of {package_of(known[name])} failed ({cause_of(error)})"
            raise InputError(f"{text}; correct it") from error

    return called
