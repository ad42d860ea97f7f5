"""Checks of a run that a user writes as text: `passive`, `margin >= -1 uJ`, `handle.deficit == 0`, `rate == 1 kHz`."""

import difflib
import operator
import re
from collections.abc import Iterator, Mapping
from typing import Any, Final, Literal, NotRequired, TypedDict

from canhaptic.axis_units import Motion
from canhaptic.errors import InputError
from canhaptic.quantities import ACCOUNT, TRUTH, row_of
from canhaptic.units import parse_unit

_EXPRESSION: Final = re.compile(
    r"\s*([\w.]+)\s*(>=|<=|==|!=|>|<)\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*([A-Za-z*/^0-9]*)\s*"
)
_OPERATORS: Final = {
    ">=": operator.ge,
    "<=": operator.le,
    "==": operator.eq,
    "!=": operator.ne,
    ">": operator.gt,
    "<": operator.lt,
}
_VERDICT: Final[Literal["passive"]] = "passive"
_SHORT: Final = {"margin": "margin.value", "surplus": "surplus.max"}


Checked = Mapping[str, Any]
"""Output of `inspect` or `run --json`: `ports` and their accounts."""


class Outcome(TypedDict):
    """One checked value, and whether it satisfies the check."""

    check: str
    name: str
    value: float | str
    holds: bool
    unit: NotRequired[str]  # of a number; "1" of a pure one
    log: NotRequired[str]  # its file, where several logs are checked
    first_active: NotRequired[float]  # of a verdict: first time at which the booked sum was below 0 [s]


def check(result: Checked, expression: str) -> list[Outcome]:
    """Return, for every value that the expression names, whether it satisfies the check.

    A name without a port means every port: `margin>=-1e-6`. A name may be shortened from the left as long as it ends
    at a dot: `handle.margin.value`, `margin`. A bound may carry a unit with a prefix; plain numbers are SI.
    A verdict is written without a comparison: `passive` is satisfied by the verdict yes, and not by no, in doubt, or
    a run without contact.

    Args:
        result: Output of `inspect` or `run --json`.
        expression: NAME, one of >= <= == != > <, a number; or `passive` or `NAME.passive`.

    Raises:
        InputError: The expression cannot be read, names nothing in the result, or has the unit of another quantity.
    """
    if not result.get("cycles", 1):  # a log that ended before its first flush shows nothing, and no check may pass
        raise InputError(f"check {expression!r}: the run has no cycle; expected at least one, record it again")
    if expression.strip().rpartition(".")[2] == _VERDICT:
        return _verdicts(result, expression)
    match = _EXPRESSION.fullmatch(expression)
    if match is None:
        raise InputError(f"check {expression!r}: expected NAME >= NUMBER, such as 'margin >= -1e-6'")
    name, comparison, number, unit = match.groups()
    values = dict(_numbers(result, ""))
    head, dot, last = name.rpartition(".")
    wanted = head + dot + _SHORT.get(last, last)
    found: dict[str, float] = {}
    for sign in ("_", "."):  # as written, else with either sign for the other
        found = found or {
            n: v for n, v in values.items() if f".{n}".replace("_", sign).endswith(f".{wanted}".replace("_", sign))
        }
    bound = float(number) * _factor(expression, unit, found, result)
    if not found:
        names = {path.split(".", 2)[-1] if path.startswith("ports.") else path for path in values}
        near = difflib.get_close_matches(wanted, names, n=3)
        remedy = f"did you mean {' or '.join(near)}?" if near else "inspect --json lists all of them"
        raise InputError(f"check {expression!r}: the run has no figure {name!r}; {remedy}")
    holds = _OPERATORS[comparison]
    return [
        {
            "check": expression,
            "name": path,
            "value": value,
            "holds": bool(holds(value, bound)),
            "unit": _unit_of(path, result),
        }
        for path, value in found.items()
    ]


def _verdicts(result: Checked, expression: str) -> list[Outcome]:
    """Return whether each account that the expression names was passive.

    Raises:
        InputError: It names no account of the run.
    """
    port = expression.strip().rpartition(".")[0]
    accounts = {name: of for name, of in result["ports"].items() if _VERDICT in of and port in ("", name)}
    if not accounts:
        raise InputError(f"check {expression!r}: the run has no account of that name; expected NAME.passive or passive")
    found: list[Outcome] = []
    for name, account in accounts.items():
        verdict = "no contact" if account.get("verdict") == "no contact" else account[_VERDICT]
        path = f"ports.{name}.{_VERDICT}"
        found.append({"check": expression, "name": path, "value": verdict, "holds": verdict == "yes"})
        if verdict != "yes" and "first_active" in account:
            found[-1]["first_active"] = account["first_active"]
    return found


def _factor(expression: str, unit: str, found: Mapping[str, float], result: Checked) -> float:
    """Return the factor from a given unit to the unit of the figures; 1 without a unit.

    Raises:
        InputError: The unit cannot be read, or is of another quantity than a figure.
    """
    if not unit:
        return 1.0
    try:
        factor, dimension = parse_unit(unit)
    except ValueError as error:
        raise InputError(f"check {expression!r}: {error}") from error
    for path in found:
        kept = _unit_of(path, result)
        if parse_unit(kept)[1] != dimension:
            expected = "no unit: it is a pure number" if kept == "1" else f"{kept}, or the same with a prefix"
            raise InputError(f"check {expression!r}: got {unit} for {path}, expected {expected}")
    return factor


def _unit_of(path: str, result: Checked) -> str:
    """Unit of a figure in the result, "1" for a pure number.

    Args:
        path: Path of the figure in the result, such as `ports.handle.margin.value`.
        result: Output of `inspect` or `run --json`.
    """
    section, _, rest = path.partition(".")
    if section in ("ports", "truth"):
        port, _, figure = rest.partition(".")
        while port not in result["ports"]:  # a name may hold dots
            head, _, figure = figure.partition(".")
            port = f"{port}.{head}"
        motion: Motion = result["ports"][port].get("unit", "m")
        return row_of(ACCOUNT if section == "ports" else TRUTH, figure).unit_on(motion)
    if section == "timing":
        return {"cycles_per_second": "1/s", "deadlines_missed": "1"}.get(rest, "s")
    return {"duration": "s", "from": "s", "to": "s", "rate": "Hz"}.get(path, "1")


def _numbers(value: object, path: str) -> Iterator[tuple[str, float]]:
    if isinstance(value, Mapping):
        for name, part in value.items():
            yield from _numbers(part, f"{path}.{name}" if path else str(name))
    elif isinstance(value, int | float) and not isinstance(value, bool):
        yield path, float(value)
