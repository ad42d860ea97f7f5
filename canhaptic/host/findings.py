"""Verdicts on the settings of this computer and its interfaces, as `check --host` prints them."""

from typing import Literal, NamedTuple

_Severity = Literal["well", "note", "refused"]
Row = tuple[str, object, _Severity, str]
"""Item, what is seen, severity, text."""


class PreflightFinding(NamedTuple):
    """Verdict on one property of an interface."""

    interface: str  # channel, as can0
    item: str
    seen: str
    severity: _Severity
    text: str  # expected value and remedy; empty if all is well


def row(item: str, seen: object, severity: _Severity, text: str = "", *, good: bool = False) -> Row:
    """Return one finding; a good property has no severity and no text."""
    return (item, seen, "well", "") if good else (item, seen, severity, text)
