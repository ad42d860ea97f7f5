"""Table and picture of `canhaptic compare`.

The table has a column per algorithm and a row per figure that a run of the port has, the best value in bold.

The picture has a column per algorithm, with the continuous environment in grey behind its lines. All panels of a row
share the scale of the continuous run, so that columns can be compared, and an algorithm that diverges leaves its panel
instead of flattening the others.
"""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rich.console import Group, RenderableType
from rich.text import Text

from canhaptic.axis_units import counted, damping_unit, effort_unit, si
from canhaptic.control.verdict import PASSIVE_TOLERANCE
from canhaptic.errors import InputError
from canhaptic.files import scene_title
from canhaptic.lab.figures.figures import CONTINUOUS, METRICS
from canhaptic.lab.loop.axis_loop import Array, LoopRun
from canhaptic.lab.render import sheet
from canhaptic.lab.studies import Row
from canhaptic.lab.studies.compare import AxisComparison, Comparison
from canhaptic.quantities import ACCOUNT, SUMMARY, TRUTH, QuantityRow
from canhaptic.view import picture_style as style
from canhaptic.view.html_page import picture, words, write_page
from canhaptic.view.picture_style import ALARM, GREEN
from canhaptic.view.run_lines import rests_on
from canhaptic.view.series import decimate
from canhaptic.view.table import Cell, Styled, Table

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_Account = Mapping[str, Any]


def comparison_report(result: _Account) -> RenderableType:
    """Return tables and remarks of a comparison.

    Args:
        result: Plain values, as `compare --json` prints them.
    """
    parts: list[RenderableType] = [_heading(result)]
    for title, part in _parts(result):
        parts += [Text(f" {title}"), _table(part), *_ranking(part), *_remarks(part)]
    return Group(*parts)


def write_comparison_page(comparison: Comparison, path: Path) -> None:
    """Write a comparison as one self-contained page: the picture of axes outside groups, and all tables.

    Raises:
        InputError: matplotlib is not installed, or the page cannot be written.
    """
    result = comparison.result
    parts: list[str | Table] = [words(_heading(result).plain.strip())]
    if any(map(_drawn, comparison.axes)):
        parts.append(picture(partial(draw_comparison, comparison), "comparison"))
    for title, part in _parts(result):
        parts += [replace(_table(part), title=title), words(*(line.plain for line in _remarks(part)))]
    write_page(path, f"{scene_title(result['scene'])} - comparison", parts)


def _parts(result: _Account) -> Iterator[tuple[str, _Account]]:
    """Yield title, unit and accounts of each port; an account has its figures of the run, and those of the plant."""
    for name, port in {**result.get("groups", {}), **result.get("axes", {})}.items():
        found = {key: _figures(account) for key, account in port.get("algorithms", port).items()}
        known = {key: value for account in found.values() for key, value in account.items()} | port
        what = known.get("network") or known.get("environment")
        title = f"{name}: {what}" if what else name
        if "network" in known:
            title += f" on {', '.join(known['axes'])}"
        if "reference" in known:
            title += f"   continuous reference: {known['reference']['method']}"
        yield title, {"algorithms": found, "unit": known.get("unit", "")}


def _figures(account: _Account) -> _Account:
    return {**account.get("account", {}), **account, **account.get("truth", {})}


def _heading(result: _Account) -> Text:
    path = "over the simulated CAN bus"
    if result["path"] != "can":
        path = f"without a bus, computed by {' and '.join(_engines(result))}"
    delay = counted(result["delay"], "sample")
    way = f"   {si(result['rate'], 'Hz', 3)}, delay {delay}, {result['duration']:.4g} s, {path}"
    return Text.assemble(" ", (scene_title(result["scene"]), "bold"), way)


def _engines(result: _Account) -> list[str]:
    """Return the names of the engines that computed the runs, such as python and numba."""
    every = (account.get("engine") for _, part in _parts(result) for account in part["algorithms"].values())
    return sorted({engine.partition(":")[0] for engine in every if engine}) or ["python"]


class _Row(NamedTuple):
    """A row of the table."""

    label: str
    read: Callable[[_Account, _Account], Any]  # (account, part) -> value
    show: Callable[[Any, str], str] = lambda value, _unit: str(value)  # (value, unit) -> text
    better: Callable[[float], float] | None = None  # function of the values that is smallest for the best
    is_bounded: bool = False  # whether a value below zero is a fault


def _table(part: _Account) -> Table:
    rows: list[list[Cell]] = []
    for row in _ROWS:
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
    least = account["least_interaction"]
    if least is None or least < -PASSIVE_TOLERANCE:
        return None if least is None else "no"
    return str(account.get("outcome") or "yes")


def _ranking(part: _Account) -> list[Text]:
    """Return the ranking in words: guaranteed ones first, then passive ones, then by error; none without errors."""
    if len(part["algorithms"]) < 2 or not any("position_error" in account for account in part["algorithms"].values()):
        return []

    def worth(name: str) -> tuple[bool, bool, bool, float]:
        account = part["algorithms"][name]
        error = _value(lambda of, _: of["position_error"]["rms"], part, account)
        passive = _value(lambda of, _: _verdict(of), part, account)
        is_luck = account.get("certificate") == "none"
        length = error if isinstance(error, float) else math.inf
        return account["status"] != "completed", passive != "yes", is_luck, length

    words = [f"{place} {name}" for place, name in enumerate(sorted(part["algorithms"], key=worth), 1)]
    order = "passive ones first, of them those with a guarantee, then by position error"
    return [Text(f" ranking: {', '.join(words)} ({order})")]


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


def _premise(account: _Account) -> str:
    words = rests_on(account["certificate"], hand_force=account.get("hand_force"))
    words = words.replace("no guarantee", "no\nguarantee").replace("needs no ", "needs no\n")  # narrow columns
    return words.removeprefix("device ").removeprefix("moving mass, ")


def figure_row(name: str, row: QuantityRow) -> _Row:
    """Return the table row of a figure."""
    whole, _, part = name.partition(".")

    def read(account: _Account, _axis: _Account) -> Any:
        value = account[whole]
        return value[part or "value"] if isinstance(value, Mapping) else value

    return _Row(row.title, read, _SHOWN[row.unit], _BETTER.get(row.better), row.better == "not negative")


_STYLES: Final = {"yes": "green", "in doubt": "yellow", "no": "red", "nothing rendered": "red"}
_BETTER: Final[dict[str, Callable[[float], float]]] = {"less": abs, "near one": lambda value: abs(value - 1.0)}
_SHOWN: Final[dict[str, Callable[[float, str], str]]] = {
    "m": lambda value, unit: si(value, unit, 3) if unit == "m" else f"{1e3 * value:.3g} mrad",
    "N": lambda value, unit: si(value, effort_unit(unit), 3),
    "J": _joule,
    "1": _share,
    "N*s/m": lambda value, unit: f"{value:.3g} {damping_unit(unit)}",
    "": lambda value, _unit: f"{value:.3g}",
}
_ACCOUNTED: Final = ("in", "out", "dissipated", "energy_resolution")
_ROWS: Final = (
    _Row("", lambda a, _: a["status"]),
    _Row(SUMMARY["passive_by_account"].title, lambda a, _: a["passive"]),
    _Row(SUMMARY["passive_by_plant"].title, lambda a, _: _verdict(a)),
    *(figure_row(name, figure.row) for name, figure in {**CONTINUOUS, **METRICS}.items() if figure.row.better),
    figure_row("interaction", TRUTH["interaction"]),
    *(figure_row(name, ACCOUNT[name]) for name in _ACCOUNTED),
    _Row(f"{ACCOUNT['surplus'].title}, peak", lambda a, _: a["surplus"]["max"], _joule),
    *(figure_row(name, METRICS[name].row) for name in ("damping_rendered.least", "damping_rendered.most")),
    _Row(ACCOUNT["certificates"].title, lambda a, _: _premise(a) if a["contact"] else None),
    _Row(SUMMARY["time_of_step"].title, lambda a, _: a["microseconds_per_step"], lambda v, _: f"{v:.2f} us"),
)
"""Rows of the table; one of which no run has the value is left out."""


_ACROSS: Final = 4
"""Largest number of columns next to each other; further algorithms continue below."""


def draw_comparison(comparison: Comparison, path: str | Path) -> None:
    """Draw a comparison into a file; its suffix gives the format (.png, .svg, .pdf).

    Raises:
        InputError: matplotlib is not installed, the file cannot be written, or no algorithm ran.
    """
    most = max(len(_drawn(axis)) for axis in comparison.axes)
    if most == 0:
        raise InputError("no algorithm ran, so there is nothing to draw; see the reasons in the table")
    bands = -(-most // _ACROSS)
    columns = -(-most // bands)
    rows = 3 * bands * len(comparison.axes)
    result = comparison.result
    way = "over the simulated CAN bus" if result["path"] == "can" else "without a bus"
    loop = f"{si(result['rate'], 'Hz', 3)}, delay {counted(result['delay'], 'sample')}, {way}"
    caption = f"{scene_title(result['scene'])}   {loop}   grey: continuous"
    with sheet(path, 1.2 + 3.0 * columns, 0.9 + 2.1 * rows, caption) as figure:
        panels = figure.subplots(rows, columns, sharex=True, sharey="row", squeeze=False)
        for index, axis in enumerate(comparison.axes):
            _draw_axis(axis, comparison, panels[3 * bands * index : 3 * bands * (index + 1)])


def _drawn(axis: AxisComparison) -> dict[str, LoopRun]:
    """Return the runs of an axis that have at least one SYNC."""
    return {name: run for name, run in axis.runs.items() if run.position.size}


def _draw_axis(axis: AxisComparison, comparison: Comparison, panels: NDArray[Any]) -> None:
    """Draw one axis into bands of three rows of panels."""
    unit = axis.unit
    runs, reference, period = _drawn(axis), axis.reference, comparison.sample_time
    places = [tuple(band[:, k]) for band in np.split(panels, len(panels) // 3) for k in range(panels.shape[1])]
    for panel in (panel for place in places[len(runs) :] for panel in place):
        panel.set_visible(False)
    if not runs:
        return
    calm = [run for run in runs.values() if not run.ended] or list(runs.values())
    scales = (
        _scale(reference.position if reference else calm[0].true_position),
        _scale(reference.fine_torque if reference else calm[0].torque),
        _scale(*_comparable([run.interaction for run in calm])),
    )
    accounts = comparison.result["axes"][axis.name]["algorithms"]
    for (position, force, energy), (name, run) in zip(places, runs.items(), strict=False):
        title = name if len(comparison.axes) == 1 else f"{axis.name}: {name}"
        position.set_title(title, fontweight="bold", fontsize=10.0, pad=18.0)
        _write_verdict(position, run)
        if reference is not None:
            behind: Any = {"color": style.PALE, "linewidth": 3.0, "alpha": 0.6}
            _line(position, period, reference.position, scales[0], **behind)
            _line(force, float(reference.fine_time[1]), reference.fine_torque, scales[1], **behind)
        _line(position, period, run.true_position, scales[0], color=style.BLUE, linewidth=1.0)
        _line(force, period, run.torque, scales[1], color=style.BLUE, linewidth=0.9, drawstyle="steps-pre")
        _draw_energy(energy, run, period, scales[2])
        energy.set_xlabel("time [s]")
        energy.tick_params(labelbottom=True)
        _write_error(position, accounts[name], unit)
    for row, (what, symbol) in enumerate((("position", unit), ("force", effort_unit(unit)), ("energy", "J"))):
        scale, prefix, (low, high) = scales[row]
        for panel in panels[row::3, 0]:
            panel.set_ylim(low / scale, high / scale)
            panel.set_ylabel(f"{what} [{prefix}{symbol}]")


_Scale = tuple[float, str, tuple[float, float]]


def _comparable(lines: list[Array]) -> list[Array]:
    """Return the lines without those whose range would flatten the others."""
    ranges = [float(np.ptp(line)) for line in lines]
    usual = float(np.median(ranges))
    return [line for line, size in zip(lines, ranges, strict=True) if size <= 4.0 * usual]


def _scale(*lines: Array) -> _Scale:
    """Return factor, SI prefix and axis limits that show all lines with a margin."""
    low = min(float(line.min(initial=0.0)) for line in lines)
    high = max(float(line.max(initial=0.0)) for line in lines)
    room = 0.35 * max(high - low, 1e-12)
    scale, prefix = style.scale_of(max(abs(low), abs(high)))
    return scale, prefix, (low - room, high + room)


def _line(panel: "Axes", period: float, values: Array, scale: _Scale, **look: Any) -> None:
    """Draw a line with one value per `period` [s], clipped outside the panel so that a diverged run can be drawn."""
    low, high = scale[2]
    far, shown = 3.0 * (high - low), decimate(values, 1200)
    time = np.arange(len(values), dtype=np.float64) * np.float64(period)
    panel.plot(time[shown], np.clip(values[shown], low - far, high + far) / scale[0], **look)


def _draw_energy(panel: "Axes", run: LoopRun, period: float, scale: _Scale) -> None:
    panel.axhline(0.0, color="black", linewidth=0.8)
    left = run.interaction - run.dissipated
    looks: Any = {name: {"color": ACCOUNT[name].colour, "label": ACCOUNT[name].title} for name in ACCOUNT}
    _line(panel, period, run.interaction, scale, linewidth=1.2, **looks["interaction"])
    _line(panel, period, run.dissipated, scale, linewidth=1.1, linestyle="--", **looks["dissipated"])
    _line(panel, period, left, scale, linewidth=1.1, **looks["margin"] | {"label": "margin: net less dissipated"})
    panel.set_title(f"smallest margin {si(run.least_margin, 'J', 3)}", fontsize=8.0, loc="left")
    if (place := panel.get_subplotspec()) is not None and place.is_first_col() and place.rowspan.start == 2:
        panel.legend(loc="best", fontsize=7.5, ncols=1)


def _write_verdict(panel: "Axes", run: LoopRun) -> None:
    """Write below the title whether, by the plant's energy, the handle gave out more than it received."""
    given = -run.least_interaction
    word, colour = ("passive", GREEN) if given <= PASSIVE_TOLERANCE else (f"gave out {si(given, 'J', 3)}", ALARM)
    panel.text(0.0, 1.02, word, transform=panel.transAxes, fontsize=9.5, fontweight="bold", color=colour)


def _write_error(panel: "Axes", account: Row, unit: str) -> None:
    error, ratio = account["position_error"], account["force_ripple"]["ratio"]
    words = [] if error is None else [f"rms error {si(error['rms'], unit, 3)}"]
    if account["status"] != "completed":
        words = [str(account["status"]).partition(":")[0]]
    elif ratio is not None:
        words.append(f"force ripple {ratio:.3g} x")
    paper: Any = {"facecolor": "white", "alpha": 0.75, "edgecolor": "none", "pad": 1.0}
    look: Any = {"va": "top", "fontsize": 8.0, "color": "#404040", "bbox": paper}
    panel.text(0.02, 0.98, "\n".join(words), transform=panel.transAxes, **look)
