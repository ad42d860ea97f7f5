"""Picture and page of `canhaptic sweep --map`: one column of panels per algorithm, with the same scales along a row."""

import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from canhaptic.lab.figures.figures import NEAR
from canhaptic.lab.loop.axis_loop import Array
from canhaptic.lab.render import BLACK, MARKS, WHITE, sheet
from canhaptic.lab.studies import Row
from canhaptic.lab.studies.map import Cells, Lines, Panel, is_log
from canhaptic.view.html_page import picture, words, write_page
from canhaptic.view.picture_style import BLUE, GREEN, GREY, ORANGE, PURPLE, SKY, VERMILION
from canhaptic.view.table import Cell, Table

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_LETTERS: Final = 60
"""Letters of a note on a line."""
_COLOURS: Final = (BLUE, GREEN, PURPLE, ORANGE, SKY, VERMILION, GREY)
_LINES: Final[dict[str, Row]] = {
    "measured": {"linewidth": 1.4, "markersize": 4.5, "fillstyle": "none"},
    "ours": {"linewidth": 2.6, "markersize": 4.5, "fillstyle": "none", "zorder": 5, "color": "#000000"},
    "colgate": {"linewidth": 1.4, "linestyle": "--", "zorder": 4},
    "abbott_okamura": {"linewidth": 1.4, "linestyle": ":", "color": "#000000"},
    "eigenvalues": {"linewidth": 1.2, "linestyle": "-.", "color": "#000000"},
    "certificate": {"linewidth": 1.2, "linestyle": (0, (10, 3)), "color": "#000000"},
}
"""Kind of a line -> its look; without a colour, that of the number of the line."""
_FEW: Final = 8
"""Largest number of values that are all ticks of a logarithmic axis."""
_FAULTS: Final = ("energy", "error")
"""Kinds of figures of which more is worse."""
_OF_STATUS: Final = {"no contact": "x", "nothing rendered": "_"}
"""Status of a scene that is drawn grey -> its mark."""


def draw_map(columns: Sequence[Sequence[Panel | None]], caption: str, path: str | Path) -> None:
    """Draw the panels of a map into a file; its suffix gives the format (.png, .svg, .pdf).

    Raises:
        InputError: matplotlib is not installed, or the file cannot be written.
    """
    rows = max(len(column) for column in columns)
    with sheet(path, 0.8 + 5.0 * len(columns), 0.6 + 3.6 * rows, caption) as figure:
        grid = figure.add_gridspec(rows, len(columns))
        for row in range(rows):
            panels = [panel for column in columns if (panel := column[row] if row < len(column) else None) is not None]
            last = len(columns) - len(panels)  # a row with few panels is filled by its last one
            spans = (slice(k, k + 1 + last * (k == len(panels) - 1)) for k in range(len(panels)))
            _draw_row(figure, [figure.add_subplot(grid[row, span]) for span in spans], panels)


def write_map(columns: Sequence[Sequence[Panel | None]], caption: str, path: Path) -> None:
    """Write a map as one self-contained page: the picture, and the numbers of every panel.

    Raises:
        InputError: matplotlib is not installed, or the page cannot be written.
    """
    tables = [_table(panel) for column in columns for panel in column if panel is not None]
    shown = picture(lambda file: draw_map(columns, caption, file), "map")
    write_page(path, "Map", [words(caption), shown, *(table for table in tables if table.rows)])


def _table(panel: Panel) -> Table:
    if isinstance(panel, Lines):
        points: list[list[Cell]] = [
            [line.label, float(x), float(y)] for line in panel.lines for x, y in zip(line.x, line.y, strict=True)
        ]
        return Table(panel.title, ("line", panel.x_label, panel.y_label), points, keys=1)
    title = f"{panel.title}; across: {panel.x_label}"
    cells = np.column_stack((panel.y, panel.values)).tolist()
    return Table(title, [panel.y_label, *(f"{x:.4g}" for x in panel.x)], cells, keys=0)


def _draw_row(figure: "Figure", axes: "Sequence[Axes]", panels: Sequence[Panel]) -> None:
    limits = _common_limits([panel for panel in panels if isinstance(panel, Cells)])
    for place, panel in zip(axes, panels, strict=True):
        x_log, marks = is_log(panel.x), np.unique(panel.x)
        place.set_title(panel.title, loc="left", fontweight="bold", fontsize=9.0)
        place.set(xlabel=panel.x_label, ylabel=panel.y_label)
        place.set(xscale="log" if x_log else "linear", yscale="log" if panel.y_log else "linear")
        if x_log and len(marks) <= _FEW:
            place.set_xticks(marks, [f"{float(f'{value:.3g}'):g}" for value in marks])
            place.set_xticks([], minor=True)
        if isinstance(panel, Lines):
            _draw_lines(place, panel)
        else:
            _draw_cells(figure, place, panel, limits)


def _common_limits(cells: Sequence[Cells]) -> tuple[float, float]:
    """Return the range of the colours for all panels of cells in a row."""
    if not cells or cells[0].kind == "share":
        return 0.0, 1.2
    known = np.concatenate([panel.values[np.isfinite(panel.values)] for panel in cells])
    low, high = (float(known.min()), float(known.max())) if known.size else (1.0, 1.0)
    if cells[0].kind != "plain":
        return low, max(high, 10.0 * low)
    return low, high if high > low else low + 1.0


def _draw_lines(place: "Axes", panel: Lines) -> None:
    place.grid(visible=True)
    low, high = panel.y_range or (-np.inf, np.inf)
    for line in panel.lines:
        mark = MARKS[line.number % len(MARKS)] if line.style in ("measured", "ours") else None
        is_beyond = not np.any((line.y >= low) & (line.y <= high))
        label = f"{line.label} (beyond what was tried)" if is_beyond else line.label
        look: Row = {"color": _COLOURS[line.number % len(_COLOURS)], **_LINES[line.style]}
        place.plot(line.x, line.y, label=label, marker=mark, **look)
    if panel.y_range is not None:
        room = 0.05 * (high - low)
        place.set_ylim(*((0.8 * low, 1.25 * high) if panel.y_log else (low - room, high + room)))
    if panel.note:
        note = textwrap.fill(panel.note, _LETTERS)
        place.text(0.0, -0.17, note, transform=place.transAxes, fontsize=8.0, color="#606060", va="top")
    if not panel.lines:
        return
    frame: Row = {"framealpha": 0.85, "edgecolor": "none", "handlelength": 4.0}  # room for two long dashes
    place.legend(fontsize=8.0 if len(panel.lines) <= 5 else 6.5, loc="best", **frame)


def _draw_cells(figure: "Figure", place: "Axes", panel: Cells, limits: tuple[float, float]) -> None:
    from matplotlib.colors import LogNorm, Normalize

    norm = (Normalize if panel.kind in ("share", "plain") else LogNorm)(*limits)
    colours = "YlOrRd" if panel.kind in _FAULTS else "viridis"  # neither ends in black, which looks like a gap
    edges = edges_of(panel.x), edges_of(panel.y)
    drawn = place.pcolormesh(*edges, panel.values, norm=norm, cmap=colours, rasterized=True)
    if panel.kind == "share":
        _draw_contour(place, panel)
    x, y = np.meshgrid(panel.x, panel.y)
    for status, mask in panel.marked.items():
        if not mask.any():
            continue
        grey = np.where(mask, 0.3, np.nan)
        place.pcolormesh(*edges, grey, cmap="Greys", vmin=0.0, vmax=1.0, rasterized=True)
        place.scatter(x[mask], y[mask], color=BLACK, marker=_OF_STATUS[status], s=14.0, label=status)
        place.legend(loc="best", fontsize=8.0, labelcolor=BLACK)
    figure.colorbar(drawn, ax=place, label=panel.value_label, pad=0.02)


def _draw_contour(place: "Axes", panel: Cells) -> None:
    """Draw the line at which a share is `1 - NEAR`, or in words between which ends the whole panel lies."""
    if min(panel.values.shape) < 2 or not np.isfinite(panel.values).any():
        return
    least, most = np.nanmin(panel.values), np.nanmax(panel.values)
    if not least < 1.0 - NEAR < most:
        ends = dict.fromkeys(f"{100.0 * end:.3g} %" for end in (least, most))
        text = f"{' to '.join(ends)} everywhere"
        place.text(0.5, 0.5, text, transform=place.transAxes, ha="center", color=BLACK)
        return
    drawn = place.contour(panel.x, panel.y, panel.values, levels=[1.0 - NEAR], colors=WHITE, linewidths=1.2)
    place.clabel(drawn, fmt=f"{100.0 * (1.0 - NEAR):g} %%", fontsize=8.0)


def edges_of(values: Array) -> Array:
    """Return the edges of cells around sorted values, shape (n + 1,): halfway between neighbours on the axis."""
    log = is_log(values)
    scaled = np.log(values) if log else values
    if len(values) == 1:
        half = np.array([0.5 * max(abs(float(values[0])), 1.0)])
        edges = np.concatenate([scaled - half, scaled + half])
    else:
        middle = 0.5 * (scaled[1:] + scaled[:-1])
        edges = np.concatenate([[2.0 * scaled[0] - middle[0]], middle, [2.0 * scaled[-1] - middle[-1]]])
    return np.asarray(np.exp(edges) if log else edges)
