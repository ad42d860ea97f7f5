"""Table and picture of `canhaptic compare`.

The table has a column per algorithm and a row per figure that a run of the port has, the best value in bold.

The picture has a column per algorithm, with the continuous environment in grey behind its lines. All panels of a row
share the scale of the continuous run, so that columns can be compared, and an algorithm that diverges leaves its panel
instead of flattening the others.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rich.console import Group, RenderableType
from rich.text import Text

from canhaptic.axis_units import counted, effort_unit, si
from canhaptic.control.verdict import PASSIVE_TOLERANCE
from canhaptic.errors import InputError
from canhaptic.files import scene_title
from canhaptic.lab.figures.figures import CONTINUOUS, METRICS
from canhaptic.lab.loop.axis_loop import Array, LoopRun
from canhaptic.lab.render import sheet
from canhaptic.lab.studies import Row
from canhaptic.lab.studies.columns import shown
from canhaptic.lab.studies.compare import Comparison
from canhaptic.quantities import ACCOUNT, SUMMARY, TRUTH, QuantityRow
from canhaptic.view import picture_style as style
from canhaptic.view.html_page import picture, words, write_page
from canhaptic.view.picture_style import ALARM, GREEN
from canhaptic.view.run_lines import rests_on
from canhaptic.view.series import decimate
from canhaptic.view.table import Cell, Styled, Table

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def comparison_report(result: Row) -> RenderableType:
    """Return tables and remarks of a comparison.

    Args:
        result: Plain values, as `compare --json` prints them.
    """
    parts: list[RenderableType] = [_heading(result)]
    for rows in _ports(result):
        parts += [Text(f" {_title(rows[0])}"), _table(rows), *_ranking(rows), *_remarks(rows)]
    return Group(*parts)


def write_comparison_page(comparison: Comparison, path: Path) -> None:
    """Write a comparison as one self-contained page: the picture of axes outside groups, and all tables.

    Raises:
        InputError: matplotlib is not installed, or the page cannot be written.
    """
    result = comparison.result
    parts: list[str | Table] = [words(_heading(result).plain.strip())]
    if any(map(_drawn, comparison.runs.values())):
        parts.append(picture(partial(draw_comparison, comparison), "comparison"))
    for rows in _ports(result):
        parts += [replace(_table(rows), title=_title(rows[0])), words(*(line.plain for line in _remarks(rows)))]
    write_page(path, f"{scene_title(result['scene'])} - comparison", parts)


def _ports(result: Row) -> list[list[Row]]:
    """Return the rows of each port."""
    names = dict.fromkeys(row["port"] for row in result["rows"])
    return [[row for row in result["rows"] if row["port"] == name] for name in names]


def _title(row: Row) -> str:
    on = f" on {', '.join(row['axes'])}" if "axes" in row else ""
    reference = f"   continuous reference: {row['reference.method']}" if "reference.method" in row else ""
    return f"{row['port']}: {row['environment']}{on}{reference}"


def _heading(result: Row) -> Text:
    path = "over the simulated CAN bus"
    if result["path"] != "can":
        engines = {row["engine"].partition(":")[0] for row in result["rows"] if row["engine"]}
        path = f"without a bus, computed by {' and '.join(sorted(engines) or ['python'])}"
    delay = counted(result["delay"], "sample")
    way = f"   {si(result['rate'], 'Hz', 3)}, delay {delay}, {result['duration']:.4g} s, {path}"
    return Text.assemble(" ", (scene_title(result["scene"]), "bold"), way)


class _Line(NamedTuple):
    """A line of the table."""

    label: str
    key: str  # of the rows
    kind: str = ""  # of the values, see `columns.shown`
    better: Callable[[float], float] | None = None  # function of the values that is smallest for the best
    is_bounded: bool = False  # whether a value below zero is a fault


def _table(rows: list[Row]) -> Table:
    known = [{**row, _PREMISE: _premise(row)} for row in rows]
    found = [(line, [row.get(line.key) for row in known]) for line in _LINES]
    cells: list[list[Cell]] = [
        [line.label, *(_cell(value, line, rows[0]["unit"], _best(values, line.better)) for value in values)]
        for line, values in found
        if any(value is not None for value in values)
    ]
    return Table("", ["", *(row["algorithm"].replace("_", "\n") for row in rows)], cells, keys=1)


def _cell(value: float | str | None, line: _Line, unit: str, best: float | None) -> Styled:
    if value is None:
        return Styled("-")
    if isinstance(value, str):
        return Styled(shown(value, line.kind, unit), _STYLES.get(value, ""))
    bad = line.is_bounded and value < -PASSIVE_TOLERANCE
    return Styled(shown(value, line.kind, unit), "red" if bad else "bold" if value == best else "")


def _best(values: list[float | str | None], better: Callable[[float], float] | None) -> float | None:
    numbers = [value for value in values if isinstance(value, float)]
    return min(numbers, key=better) if better is not None and len(numbers) > 1 else None


def _ranking(rows: list[Row]) -> list[Text]:
    """Return the ranking in words: guaranteed ones first, then passive ones, then by error; none without errors."""
    if len(rows) < 2 or not any(_ERROR in row for row in rows):
        return []

    def worth(row: Row) -> tuple[bool, bool, bool, float]:
        error, is_luck = row.get(_ERROR), row.get("certificate") == "none"
        ended, passive = row["status"] != "completed", row["passive_by_plant"]
        return ended, passive != "yes", is_luck, math.inf if error is None else error

    words = [f"{place} {row['algorithm']}" for place, row in enumerate(sorted(rows, key=worth), 1)]
    order = "passive ones first, of them those with a guarantee, then by position error"
    return [Text(f" ranking: {', '.join(words)} ({order})")]


def _remarks(rows: list[Row]) -> list[Text]:
    lines = []
    for row in rows:
        words = [row["remark"]] if row["remark"] else []
        if row.get("diverged") is not None:
            words.append(f"diverged at {row['diverged']:.4g} s")
        if words:
            lines.append(Text(f" {row['algorithm']}: {'; '.join(words)}", style="yellow"))
    return lines


def _premise(row: Row) -> str | None:
    """Return what the guarantee of an algorithm rests on, if it was needed."""
    if "certificate" not in row or row.get("contact") == 0.0:
        return None
    words = rests_on(row["certificate"], hand_force=row.get("hand_force"))
    words = words.replace("no guarantee", "no\nguarantee").replace("needs no ", "needs no\n")  # narrow columns
    return words.removeprefix("device ").removeprefix("moving mass, ")


def figure_line(name: str, row: QuantityRow) -> _Line:
    """Return the line of a figure."""
    return _Line(row.title, name, _KINDS.get(row.unit, row.unit), _BETTER.get(row.better), row.better == "not negative")


_STYLES: Final = {"yes": "green", "in doubt": "yellow", "no": "red", "nothing rendered": "red"}
_BETTER: Final[dict[str, Callable[[float], float]]] = {"less": abs, "near one": lambda value: abs(value - 1.0)}
_KINDS: Final = {"1": "%", "": ".3g"}
"""Unit of a quantity -> kind of its values, where they differ."""
_ACCOUNTED: Final = ("in", "out", "dissipated", "energy_resolution")
_ERROR: Final = "position_error.rms"
_PREMISE: Final = "premise"
_LINES: Final = (
    _Line("", "status"),
    _Line(SUMMARY["passive_by_account"].title, "passive"),
    _Line(SUMMARY["passive_by_plant"].title, "passive_by_plant"),
    *(figure_line(name, figure.row) for name, figure in {**CONTINUOUS, **METRICS}.items() if figure.row.better),
    figure_line("interaction", TRUTH["interaction"]),
    *(figure_line(name, ACCOUNT[name]) for name in _ACCOUNTED),
    _Line(f"{ACCOUNT['surplus'].title}, peak", "surplus.max", "J"),
    *(figure_line(name, METRICS[name].row) for name in ("damping_rendered.least", "damping_rendered.most")),
    _Line(ACCOUNT["certificates"].title, _PREMISE),
    _Line(SUMMARY["time_of_step"].title, "microseconds_per_step", "us"),
)
"""Lines of the table; one of which no run has the value is left out."""


_ACROSS: Final = 4
"""Largest number of columns next to each other; further algorithms continue below."""


def draw_comparison(comparison: Comparison, path: str | Path) -> None:
    """Draw a comparison into a file; its suffix gives the format (.png, .svg, .pdf).

    Raises:
        InputError: matplotlib is not installed, the file cannot be written, or no algorithm ran.
    """
    drawn = {name: _drawn(runs) for name, runs in comparison.runs.items()}
    most = max(map(len, drawn.values()))
    if most == 0:
        raise InputError("no algorithm ran, so there is nothing to draw; see the reasons in the table")
    bands = -(-most // _ACROSS)
    columns = -(-most // bands)
    rows = 3 * bands * len(drawn)
    result = comparison.result
    way = "over the simulated CAN bus" if result["path"] == "can" else "without a bus"
    loop = f"{si(result['rate'], 'Hz', 3)}, delay {counted(result['delay'], 'sample')}, {way}"
    caption = f"{scene_title(result['scene'])}   {loop}   grey: continuous"
    with sheet(path, 1.2 + 3.0 * columns, 0.9 + 2.1 * rows, caption) as figure:
        panels = figure.subplots(rows, columns, sharex=True, sharey="row", squeeze=False)
        for index, axis in enumerate(drawn):
            _draw_axis(axis, drawn[axis], comparison, panels[3 * bands * index : 3 * bands * (index + 1)])


def _drawn(runs: dict[str, LoopRun]) -> dict[str, LoopRun]:
    """Return the runs that have at least one SYNC."""
    return {name: run for name, run in runs.items() if run.position.size}


def _draw_axis(axis: str, runs: dict[str, LoopRun], comparison: Comparison, panels: NDArray[Any]) -> None:
    """Draw one axis into bands of three rows of panels."""
    rows = {row["algorithm"]: row for row in comparison.result["rows"] if row["port"] == axis}
    reference, period = comparison.references[axis], comparison.sample_time
    places = [tuple(band[:, k]) for band in np.split(panels, len(panels) // 3) for k in range(panels.shape[1])]
    for panel in (panel for place in places[len(runs) :] for panel in place):
        panel.set_visible(False)
    if not runs:
        return
    unit = rows[next(iter(runs))]["unit"]
    calm = [run for run in runs.values() if not run.ended] or list(runs.values())
    scales = (
        _scale(reference.position if reference else calm[0].true_position),
        _scale(reference.fine_torque if reference else calm[0].torque),
        _scale(*_comparable([run.interaction for run in calm])),
    )
    for (position, force, energy), (name, run) in zip(places, runs.items(), strict=False):
        title = name if len(comparison.runs) == 1 else f"{axis}: {name}"
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
        _write_error(position, rows[name], unit)
    for place, (what, symbol) in enumerate((("position", unit), ("force", effort_unit(unit)), ("energy", "J"))):
        scale, prefix, (low, high) = scales[place]
        for panel in panels[place::3, 0]:
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


def _write_error(panel: "Axes", row: Row, unit: str) -> None:
    error, ratio = row[_ERROR], row["force_ripple.ratio"]
    words = [] if error is None else [f"rms error {si(error, unit, 3)}"]
    if row["status"] != "completed":
        words = [str(row["status"])]
    elif ratio is not None:
        words.append(f"force ripple {ratio:.3g} x")
    paper: Any = {"facecolor": "white", "alpha": 0.75, "edgecolor": "none", "pad": 1.0}
    look: Any = {"va": "top", "fontsize": 8.0, "color": "#404040", "bbox": paper}
    panel.text(0.02, 0.98, "\n".join(words), transform=panel.transAxes, **look)
