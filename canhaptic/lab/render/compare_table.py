"""A comparison as tables for a terminal: one column per algorithm, one row per figure, the best of a row in bold."""

from collections.abc import Callable, Mapping
from typing import Any, Final

from rich.console import Group, RenderableType
from rich.text import Text

from canhaptic.axis_units import effort_unit
from canhaptic.control.verdict import PASSIVE_TOLERANCE
from canhaptic.view.si import si
from canhaptic.view.table import Cell, Styled, Table

_Account = Mapping[str, Any]


def comparison_report(result: _Account) -> RenderableType:
    """Return tables and remarks of a comparison.

    Args:
        result: Plain values, as `compare --json` prints them.
    """
    parts: list[RenderableType] = [_heading(result)]
    for name, axis in result["axes"].items():
        parts.append(Text(f" {name}: {axis['environment']}   continuous: {axis['reference']['method']}"))
        parts += [_table(axis), *_remarks(axis)]
    return Group(*parts)


def _heading(result: _Account) -> Text:
    path = "over the CAN path" if result["path"] == "can" else f"without a bus, by {' and '.join(_engines(result))}"
    text = Text(" ")
    text.append(str(result["scene"]), style="bold")
    text.append(f"   {si(result['rate'], 'Hz', 3)}, delay {result['delay']}, {result['duration']:.4g} s, {path}")
    return text


def _engines(result: _Account) -> list[str]:
    """Return what computed the runs: python, numba."""
    every = (account["engine"] for axis in result["axes"].values() for account in axis["algorithms"].values())
    return sorted({engine.partition(":")[0] for engine in every if engine}) or ["python"]


def _table(axis: _Account) -> Table:
    rows: list[list[Cell]] = []
    for label, read, show, better in _ROWS:
        values = [_value(read, axis, account) for account in axis["algorithms"].values()]
        if any(value is not None for value in values):
            best, is_below = _best(values, better), label in _ENERGIES_BELOW
            rows.append([label, *(_cell(value, show, axis["unit"], best, is_below=is_below) for value in values)])
    return Table("", ["", *(name.replace("_", "\n") for name in axis["algorithms"])], rows, keys=1)


def _cell(
    value: float | str | None, show: Callable[[Any, str], str], unit: str, best: float | None, *, is_below: bool
) -> Styled:
    if value is None:
        return Styled("-")
    bad = is_below and isinstance(value, float) and value < -PASSIVE_TOLERANCE
    return Styled(show(value, unit), "red" if bad else "bold" if value == best else "")


def _value(read: Callable[[_Account, _Account], Any], axis: _Account, account: _Account) -> float | str | None:
    try:
        value: float | str | None = read(account, axis)
    except (KeyError, TypeError):  # refused, or nothing to measure
        return None
    return value


def _best(values: list[float | str | None], better: Callable[[float], float] | None) -> float | None:
    numbers = [value for value in values if isinstance(value, float)]
    return min(numbers, key=better) if better is not None and len(numbers) > 1 else None


def _remarks(axis: _Account) -> list[Text]:
    lines = []
    for name, account in axis["algorithms"].items():
        words = [account["remark"]] if account["remark"] else []
        if account.get("diverged") is not None:
            words.append(f"diverged at {account['diverged']:.4g} s")
        if words:
            lines.append(Text(f" {name}: {'; '.join(words)}", style="yellow"))
    return lines


def _length(value: float, unit: str) -> str:
    return si(value, unit, 3) if unit == "m" else f"{1e3 * value:.3g} mrad"


def _force(value: float, unit: str) -> str:
    return si(value, effort_unit(unit), 3)


def _joule(value: float, _unit: str) -> str:
    return si(value, "J", 3)


def _share(value: float, _unit: str) -> str:
    return f"{100.0 * value:.3g} %"


def _plain(value: float, _unit: str) -> str:
    return f"{value:.3g}"


def _status(account: _Account, _axis: _Account) -> str:
    return str(account["status"])


def _word(value: str, _unit: str) -> str:
    return value


def _asked_damping(account: _Account, _axis: _Account) -> float | None:
    damping = account["damping_rendered"]
    return float(damping["mean"] / damping["asked"]) if damping["asked"] and damping["mean"] is not None else None


_ENERGIES_BELOW: Final = ("least true sum(h_i)", "least margin of (4)")
_ROWS: Final[tuple[tuple[str, Callable[[_Account, _Account], Any], Callable[[Any, str], str], Any], ...]] = (
    ("", _status, _word, None),
    ("position error, rms", lambda a, _: a["position_error"]["rms"], _length, abs),
    ("position error, most", lambda a, _: a["position_error"]["max"], _length, abs),
    ("force error, rms", lambda a, _: a["force_error"]["rms"], _force, abs),
    ("force error, most", lambda a, _: a["force_error"]["max"], _force, abs),
    ("force variation, ratio", lambda a, _: a["force_variation"]["ratio"], _plain, lambda v: abs(v - 1.0)),
    ("stiffness rendered", lambda a, _: a["stiffness_rendered"]["share"], _share, lambda v: abs(v - 1.0)),
    ("stiffness at rest", lambda a, _: a["stiffness_at_rest"]["share"], _share, lambda v: abs(v - 1.0)),
    ("damping rendered", _asked_damping, _share, lambda v: abs(v - 1.0)),
    ("limit cycle", lambda a, _: a["limit_cycle"], _length, abs),
    ("least true sum(h_i)", lambda a, _: a["least_interaction"], _joule, None),
    ("least margin of (4)", lambda a, _: a["margin"]["value"], _joule, None),
    ("believed - true", lambda a, _: a["believed_error"], _joule, None),
    ("residual of account", lambda a, _: a["residual"], _plain, None),
    ("weakest certificate", lambda a, _: a["certificate"].replace("_", " ").removeprefix("device "), _word, None),
    ("time of a step", lambda a, _: a["microseconds_per_step"], lambda v, _: f"{v:.2f} us", None),
)
