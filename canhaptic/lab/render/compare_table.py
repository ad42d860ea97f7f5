"""Tables of `canhaptic compare` for a terminal: a column per algorithm, a row per figure, the best value in bold.

Impedance axes, groups and admittance displays have different rows.
"""

import math
from collections.abc import Callable, Iterator, Mapping
from typing import Any, Final, NamedTuple

from rich.console import Group, RenderableType
from rich.text import Text

from canhaptic.axis_units import counted, damping_unit, effort_unit, si
from canhaptic.control.verdict import PASSIVE_TOLERANCE
from canhaptic.lab.figures.figures import CONTINUOUS, METRICS, Figure
from canhaptic.view.run_lines import rests_on
from canhaptic.view.table import Cell, Styled, Table

_Account = Mapping[str, Any]


def comparison_report(result: _Account) -> RenderableType:
    """Return tables and remarks of a comparison.

    Args:
        result: Plain values, as `compare --json` prints them.
    """
    parts: list[RenderableType] = [_heading(result)]
    for title, part, rows in _parts(result):
        ranked = [_ranking(part)] if rows is _ROWS and len(part["algorithms"]) > 1 else []
        parts += [Text(f" {title}"), _table(part, rows), *ranked, *_remarks(part)]
    return Group(*parts)


def _parts(result: _Account) -> Iterator[tuple[str, _Account, tuple["_Row", ...]]]:
    """Yield (title, accounts, rows of its table) of each axis, group or admittance display."""
    for name, group in result.get("groups", {}).items():
        yield f"{name}: {group['network']} on {', '.join(group['axes'])}", group, _GROUP_ROWS
    for name, axis in result.get("axes", {}).items():
        if "algorithms" in axis:
            yield f"{name}: {axis['environment']}   continuous reference: {axis['reference']['method']}", axis, _ROWS
        else:
            yield name, {"algorithms": axis, "unit": ""}, _DISPLAY_ROWS


def _heading(result: _Account) -> Text:
    path = "over the simulated CAN bus"
    if result["path"] != "can":
        path = f"without a bus, computed by {' and '.join(_engines(result))}"
    delay = counted(result["delay"], "sample")
    way = f"   {si(result['rate'], 'Hz', 3)}, delay {delay}, {result['duration']:.4g} s, {path}"
    return Text.assemble(" ", (str(result["scene"]), "bold"), way)


def _engines(result: _Account) -> list[str]:
    """Return the names of the engines that computed the runs, such as python and numba."""
    every = (account.get("engine") for _, part, _ in _parts(result) for account in part["algorithms"].values())
    return sorted({engine.partition(":")[0] for engine in every if engine}) or ["python"]


class _Row(NamedTuple):
    """A row of the table."""

    label: str
    read: Callable[[_Account, _Account], Any]  # (account, part) -> value
    show: Callable[[Any, str], str] = lambda value, _unit: str(value)  # (value, unit) -> text
    better: Callable[[float], float] | None = None  # function of the values that is smallest for the best
    is_bounded: bool = False  # whether a value below zero is a fault


def _table(part: _Account, of: tuple[_Row, ...]) -> Table:
    rows: list[list[Cell]] = []
    for row in of:
        values = [_value(row.read, part, account) for account in part["algorithms"].values()]
        if any(value is not None for value in values):
            best = _best(values, row.better)
            rows.append([row.label, *(_cell(value, row, part["unit"], best) for value in values)])
    return Table("", ["", *(name.replace("_", "\n") for name in part["algorithms"])], rows, keys=1)


def _cell(value: float | str | None, row: _Row, unit: str, best: float | None) -> Styled:
    if value is None:
        return Styled("-")
    if isinstance(value, str):
        return Styled(row.show(value, unit), _STYLES.get(value, ""))
    bad = row.is_bounded and value < -PASSIVE_TOLERANCE
    return Styled(row.show(value, unit), "red" if bad else "bold" if value == best else "")


def _value(read: Callable[[_Account, _Account], Any], axis: _Account, account: _Account) -> float | str | None:
    try:
        value: float | str | None = read(account, axis)
    except (KeyError, TypeError):  # refused, or nothing to measure
        return None
    return value


def _best(values: list[float | str | None], better: Callable[[float], float] | None) -> float | None:
    numbers = [value for value in values if isinstance(value, float)]
    return min(numbers, key=better) if better is not None and len(numbers) > 1 else None


def _verdict(account: _Account) -> str | None:
    """Return yes if, by the plant's energy, the handle never gave out more than it received; else no, or an outcome."""
    least = account.get("truth", account)["least_interaction"]
    if least is None or least < -PASSIVE_TOLERANCE:
        return None if least is None else "no"
    return str(account.get("outcome") or "yes")


def _ranking(part: _Account) -> Text:
    """Return the ranking of the algorithms in words: guaranteed ones first, then passive ones, then by error."""

    def worth(name: str) -> tuple[bool, bool, bool, float]:
        account = part["algorithms"][name]
        error = _value(lambda of, _: of["position_error"]["rms"], part, account)
        passive = _value(lambda of, _: _verdict(of), part, account)
        is_luck = account["certificate"] == "none"
        length = error if isinstance(error, float) else math.inf
        return account["status"] != "completed", passive != "yes", is_luck, length

    words = [f"{place} {name}" for place, name in enumerate(sorted(part["algorithms"], key=worth), 1)]
    return Text(
        f" ranking: {', '.join(words)} (passive ones first, of them those with a guarantee, then by position error)"
    )


def _remarks(axis: _Account) -> list[Text]:
    lines = []
    for name, account in axis["algorithms"].items():
        words = [account["remark"]] if account.get("remark") else []
        if account.get("diverged") is not None:
            words.append(f"diverged at {account['diverged']:.4g} s")
        if words:
            lines.append(Text(f" {name}: {'; '.join(words)}", style="yellow"))
    return lines


def _joule(value: float, _unit: str) -> str:
    return si(value, "J", 3)


def _share(value: float, _unit: str) -> str:
    return f"{100.0 * value:.3g} %"


def _damping(account: _Account, group: _Account) -> str:
    rendered = account["damping_rendered"]
    return f"{rendered['least']:.3g}..{rendered['most']:.3g} {damping_unit(group['unit'])}"


def _premise(account: _Account) -> str:
    words = rests_on(account["certificate"], hand_force=account.get("hand_force"))
    return words.removeprefix("device ").removeprefix("moving mass, ")


def row_of(name: str, figure: Figure) -> _Row:
    """Return the table row of a figure with a label."""
    whole, _, part = name.partition(".")

    def read(account: _Account, _axis: _Account) -> Any:
        value = account[whole]
        return value[part or "value"] if isinstance(value, Mapping) else value

    return _Row(figure.label, read, _SHOWN[figure.unit], _BETTER.get(figure.better), figure.better == "not negative")


_STYLES: Final = {"yes": "green", "in doubt": "yellow", "no": "red", "nothing rendered": "red"}
_BETTER: Final[dict[str, Callable[[float], float]]] = {"less": abs, "near one": lambda value: abs(value - 1.0)}
_SHOWN: Final[dict[str, Callable[[float, str], str]]] = {
    "m": lambda value, unit: si(value, unit, 3) if unit == "m" else f"{1e3 * value:.3g} mrad",
    "N": lambda value, unit: si(value, effort_unit(unit), 3),
    "J": _joule,
    "1": _share,
    "": lambda value, _unit: f"{value:.3g}",
}
_ROWS: Final = (
    _Row("", lambda a, _: a["status"]),
    _Row("passive, by the plant", lambda a, _: _verdict(a)),
    *(row_of(name, figure) for name, figure in {**CONTINUOUS, **METRICS}.items() if figure.label),
    _Row("guarantee rests on", lambda a, _: _premise(a) if a["contact"] else None),
    _Row("computing time per step", lambda a, _: a["microseconds_per_step"], lambda v, _: f"{v:.2f} us"),
)
_GROUP_ROWS: Final = (
    _Row("", lambda a, _: a["status"]),
    _Row("passive, by the account", lambda a, _: a["passive"]),
    _Row("passive, by the plant", lambda a, _: _verdict(a)),
    _Row("lowest net energy, from the plant", lambda a, _: a["truth"]["least_interaction"], _joule, is_bounded=True),
    _Row("smallest margin", lambda a, _: a["margin"]["value"], _joule, is_bounded=True),
    _Row("largest error of the account", lambda a, _: a["truth"]["believed_error"], _joule),
    _Row("in", lambda a, _: a["in"], _joule),
    _Row("out", lambda a, _: a["out"], _joule),
    _Row("dissipated", lambda a, _: a["dissipated"], _joule),
    _Row("energy created by sampling, peak", lambda a, _: a["surplus"]["max"], _joule),
    _Row("damping rendered", _damping),
    _Row("guarantee rests on", lambda a, _: _premise(a)),
)
_DISPLAY_ROWS: Final = (
    _Row("", lambda a, _: a["status"]),
    _Row("energy in", lambda a, _: a["account"]["in"], _joule),
    _Row("energy out", lambda a, _: a["account"]["out"], _joule),
    _Row("uncertainty of the account, +-", lambda a, _: a["account"]["energy_resolution"], _joule),
    _Row("passive, by the account", lambda a, _: a["account"]["passive"]),
    _Row("passive, by the plant", lambda a, _: _verdict(a)),
    _Row("guarantee rests on", lambda a, _: _premise(a["account"])),
    _Row("net energy, from the plant", lambda a, _: a["truth"]["interaction"], _joule),
    _Row("lowest net energy, from the plant", lambda a, _: a["truth"]["least_interaction"], _joule, is_bounded=True),
)
