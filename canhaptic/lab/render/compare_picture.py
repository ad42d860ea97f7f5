"""Picture of `canhaptic compare`: a column per algorithm, with the continuous environment in grey behind its lines.

All panels of a row share the scale of the continuous run, so that columns can be compared, and an algorithm that
diverges leaves its panel instead of flattening the others.
"""

from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from canhaptic.axis_units import counted, effort_unit, si
from canhaptic.control.verdict import PASSIVE_TOLERANCE
from canhaptic.errors import InputError
from canhaptic.lab.loop.axis_loop import Array, LoopRun
from canhaptic.lab.studies import Row
from canhaptic.lab.studies.compare import AxisComparison, Comparison
from canhaptic.view import picture_style as style
from canhaptic.view.picture_style import GREEN, VERMILION, save_picture
from canhaptic.view.series import decimate

if TYPE_CHECKING:
    from matplotlib.axes import Axes


_ACROSS: Final = 4
"""Largest number of columns next to each other; further algorithms continue below."""


def draw_comparison(comparison: Comparison, path: str | Path) -> None:
    """Draw a comparison into a file; its suffix gives the format (.png, .svg, .pdf).

    Raises:
        InputError: matplotlib is not installed, the file cannot be written, or no algorithm ran.
    """
    style.require_matplotlib()
    most = max(len(_drawn(axis)) for axis in comparison.axes)
    if most == 0:
        raise InputError("no algorithm ran, so there is nothing to draw; see the reasons in the table")
    bands = -(-most // _ACROSS)
    columns = -(-most // bands)
    rows = 3 * bands * len(comparison.axes)
    with style.drawing() as figure_type:
        figure = figure_type(figsize=(1.2 + 3.0 * columns, 0.9 + 2.1 * rows), dpi=110, layout="constrained")
        panels = figure.subplots(rows, columns, sharex=True, sharey="row", squeeze=False)
        for index, axis in enumerate(comparison.axes):
            _draw_axis(axis, comparison, panels[3 * bands * index : 3 * bands * (index + 1)])
        result = comparison.result
        way = "over the simulated CAN bus" if result["path"] == "can" else "without a bus"
        loop = f"{si(result['rate'], 'Hz', 3)}, delay {counted(result['delay'], 'sample')}"
        caption = f"{result['scene']}   {loop}, {way}   grey: continuous"
        figure.suptitle(caption, x=0.01, ha="left", fontsize=9.5, color="#404040")
        save_picture(figure, path)


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
        _line(force, period, run.torque, scales[1], color=VERMILION, linewidth=0.9, drawstyle="steps-pre")
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
    _line(panel, period, run.interaction, scale, color=style.BLUE, linewidth=1.2, label="in")
    _line(panel, period, run.dissipated, scale, color=VERMILION, linewidth=1.1, linestyle="--", label="dissipated")
    _line(panel, period, left, scale, color=GREEN, linewidth=1.1, label="margin: in less dissipated")
    panel.set_title(f"smallest margin {si(run.least_margin, 'J', 3)}", fontsize=8.0, loc="left")
    if (place := panel.get_subplotspec()) is not None and place.is_first_col() and place.rowspan.start == 2:
        panel.legend(loc="upper left", fontsize=7.5, ncols=1)


def _write_verdict(panel: "Axes", run: LoopRun) -> None:
    """Write below the title whether, by the plant's energy, the handle gave out more than it received."""
    given = -run.least_interaction
    word, colour = ("passive", GREEN) if given <= PASSIVE_TOLERANCE else (f"gave out {si(given, 'J', 3)}", VERMILION)
    panel.text(0.0, 1.02, word, transform=panel.transAxes, fontsize=9.5, fontweight="bold", color=colour)


def _write_error(panel: "Axes", account: Row, unit: str) -> None:
    error, ratio = account["position_error"], account["force_variation"]["ratio"]
    words = [] if error is None else [f"rms error {si(error['rms'], unit, 3)}"]
    if account["status"] != "completed":
        words = [str(account["status"]).partition(":")[0]]
    elif ratio is not None:
        words.append(f"force varies {ratio:.3g} x")
    paper: Any = {"facecolor": "white", "alpha": 0.75, "edgecolor": "none", "pad": 1.0}
    look: Any = {"va": "top", "fontsize": 8.0, "color": "#404040", "bbox": paper}
    panel.text(0.02, 0.98, "\n".join(words), transform=panel.transAxes, **look)
