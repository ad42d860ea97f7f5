"""Lookup of a name of a scene in a table of classes; the module of the class is imported on demand."""

import difflib
import importlib
from collections.abc import Iterable, Mapping
from typing import Any

from canhaptic.errors import ParameterError


def load(table: Mapping[str, str], name: str, kind: str) -> Any:
    """Return the class that `table` lists as "module:Class" under `name`.

    Args:
        table: Name -> "module:Class".
        name: Requested name.
        kind: Kind of entries in the table, for the message ("environment", "passivity algorithm", ...).

    Raises:
        ParameterError: The name is not in the table; the nearest name is offered.
    """
    if name not in table:
        known = ", ".join(sorted(table))
        raise ParameterError(f"unknown {kind} {name!r}, expected one of: {known}{nearest(name, table)}")
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
