"""Checks of a run that a user writes as text: `margin >= -1 uJ`, `handle.deficit == 0`, `compute.p99.9 < 50 us`."""

import difflib
import operator
import re
from collections.abc import Iterator, Mapping
from typing import Any, Final

from canhaptic.errors import InputError
from canhaptic.units import parse_unit

_EXPRESSION: Final = re.compile(
    r"\s*([\w.]+)\s*(>=|<=|==|!=|>|<)\s*([-+]?[\d.]+(?:[eE][-+]?\d+)?)\s*([A-Za-z*/^0-9]*)\s*"
)
_OPERATORS: Final = {
    ">=": operator.ge,
    "<=": operator.le,
    "==": operator.eq,
    "!=": operator.ne,
    ">": operator.gt,
    "<": operator.lt,
}
_SHORT: Final = {"margin": "margin.value", "surplus": "surplus.max"}


def check(result: Mapping[str, Any], expression: str) -> list[dict[str, Any]]:
    """Returns, for every value that the expression names, whether it holds.

    A name without a port means every port: `margin>=-1e-6`. A name may be shortened from the left as long as it ends
    at a dot: `handle.margin.value`, `margin`. A bound may carry a unit with a prefix; plain numbers are SI.

    Args:
        result: As `inspect` or `run --json` gives it.
        expression: NAME, one of >= <= == != > <, a number.

    Returns:
        One `{check, name, value, holds}` per value.

    Raises:
        InputError: The expression cannot be read, or names nothing in the result.
    """
    match = _EXPRESSION.fullmatch(expression)
    if match is None:
        raise InputError(f"check {expression!r}: expected NAME >= NUMBER, such as 'margin >= -1e-6'")
    name, comparison, number, unit = match.groups()
    try:
        bound = float(number) * (parse_unit(unit)[0] if unit else 1.0)
    except ValueError as error:
        raise InputError(f"check {expression!r}: {error}") from error
    values = dict(_numbers(result, ""))
    wanted = _wanted(name)
    found = {path: value for path, value in values.items() if f".{path}".endswith(f".{wanted}")}
    if not found:
        names = {path.split(".", 2)[-1] if path.startswith("ports.") else path for path in values}
        near = difflib.get_close_matches(wanted, names, n=3, cutoff=0.4)
        raise InputError(
            f"check {expression!r}: the run has no {name!r}; did you mean {' or '.join(near) or 'margin'}?"
        )
    holds = _OPERATORS[comparison]
    return [
        {"check": expression, "name": path, "value": value, "holds": bool(holds(value, bound))}
        for path, value in found.items()
    ]


def _wanted(name: str) -> str:
    head, dot, last = name.rpartition(".")
    return head + dot + _SHORT.get(last, last)


def _numbers(value: Any, path: str) -> Iterator[tuple[str, float]]:
    if isinstance(value, Mapping):
        for name, part in value.items():
            yield from _numbers(part, f"{path}.{name}" if path else str(name))
    elif isinstance(value, int | float) and not isinstance(value, bool):
        yield path, float(value)
