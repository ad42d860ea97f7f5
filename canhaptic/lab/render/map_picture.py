"""Picture and page of `canhaptic map`: one column of panels per algorithm, with the same scales along a row."""

import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from canhaptic.lab.studies import Row
from canhaptic.lab.studies.map import Cells, Lines, Panel, common_limits
from canhaptic.view.html_page import picture, words, write_page
from canhaptic.view.picture_style import GREY, drawing, save_picture
from canhaptic.view.table import Cell, Table

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.cm import ScalarMappable
    from matplotlib.figure import Figure


_LETTERS: Final = 80
"""Number of caption characters on a line, per column of panels."""
_LINES: Final[dict[str, Row]] = {
    "measured": {"linewidth": 1.4, "markersize": 4.5, "fillstyle": "none"},
    "ours": {"linewidth": 2.6, "markersize": 4.5, "fillstyle": "none", "zorder": 5},
    "colgate": {"linewidth": 1.4, "linestyle": "--", "zorder": 4},
    "abbott_okamura": {"linewidth": 1.4, "linestyle": ":"},
    "eigenvalues": {"linewidth": 1.2, "linestyle": "-."},
    "certificate": {"linewidth": 1.2, "linestyle": (0, (10, 3))},
}
_WHITE, _BLACK = "#fffffe", "#000001"  # on coloured cells; no grey, which a dark page would turn over
_MARKS: Final = "osv^<>DPX*hpd"
_OF_STATUS: Final = {"no contact": "x", "nothing rendered": "_"}
"""Status of a scene that is drawn grey -> its mark."""


def draw_map(columns: Sequence[Sequence[Panel | None]], caption: str, path: str | Path) -> None:
    """Draw the panels of a map into a file; its suffix gives the format (.png, .svg, .pdf).

    Raises:
        InputError: matplotlib is not installed, or the file cannot be written.
    """
    rows = max(len(column) for column in columns)
    with drawing() as figure_type:
        figure = figure_type(figsize=(0.8 + 5.0 * len(columns), 0.6 + 3.6 * rows), dpi=110, layout="constrained")
        grid = figure.add_gridspec(rows, len(columns))
        for row in range(rows):
            panels = [panel for column in columns if (panel := column[row] if row < len(column) else None) is not None]
            last = len(columns) - len(panels)  # a row with few panels is filled by its last one
            spans = (slice(k, k + 1 + last * (k == len(panels) - 1)) for k in range(len(panels)))
            _draw_row(figure, [figure.add_subplot(grid[row, span]) for span in spans], panels)
        lines = textwrap.wrap(caption, _LETTERS * len(columns), break_long_words=False)
        figure.suptitle("\n".join(lines), x=0.01, ha="left", fontsize=9.5, color="#404040")
        save_picture(figure, path)


def write_map(columns: Sequence[Sequence[Panel | None]], caption: str, path: Path) -> None:
    """Write a map as one self-contained page: the picture, and the numbers of every panel except scatter plots.

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
    cells = [] if panel.dots else np.column_stack((panel.y, panel.values)).tolist()
    return Table(title, [panel.y_label, *(f"{x:.4g}" for x in panel.x)], cells, keys=0)


def _draw_row(figure: "Figure", axes: "Sequence[Axes]", panels: Sequence[Panel]) -> None:
    limits = common_limits(panels)
    for place, panel in zip(axes, panels, strict=True):
        place.set_title(panel.title, loc="left", fontweight="bold", fontsize=9.0)
        place.set(xlabel=panel.x_label, ylabel=panel.y_label)
        place.set(xscale="log" if panel.x_log else "linear", yscale="log" if panel.y_log else "linear")
        if marks := panel.marks():  # the values themselves, where those are few
            place.set_xticks(marks, [f"{float(f'{value:.3g}'):g}" for value in marks])
            place.set_xticks([], minor=True)
        if isinstance(panel, Lines):
            _draw_lines(place, panel)
        else:
            _draw_cells(figure, place, panel, limits)


def _draw_lines(place: "Axes", panel: Lines) -> None:
    place.grid(visible=True)
    low, high = panel.y_range or (-np.inf, np.inf)
    for line in panel.lines:
        mark = _MARKS[line.number % len(_MARKS)] if line.style in ("measured", "ours") else None
        is_beyond = not np.any((line.y >= low) & (line.y <= high))
        label = f"{line.label} (beyond what was tried)" if is_beyond else line.label
        place.plot(line.x, line.y, label=label, color=line.colour, marker=mark, **_LINES[line.style])
    if panel.y_range is not None:
        room = 0.05 * (high - low)
        place.set_ylim(*((0.8 * low, 1.25 * high) if panel.y_log else (low - room, high + room)))
    if panel.note:
        note = textwrap.fill(panel.note, _LETTERS - 20)
        place.text(0.0, -0.17, note, transform=place.transAxes, fontsize=8.0, color="#606060", va="top")
    look: Row = {"framealpha": 0.85, "edgecolor": "none", "handlelength": 4.0}  # room for two long dashes
    place.legend(fontsize=8.0 if len(panel.lines) <= 5 else 6.5, loc="best", **look)


def _draw_cells(figure: "Figure", place: "Axes", panel: Cells, limits: tuple[float, float]) -> None:
    from matplotlib.colors import LogNorm, Normalize

    norm = (LogNorm if panel.value_log else Normalize)(*limits)
    drawn: ScalarMappable
    colours = "YlOrRd" if panel.more_is_worse else "viridis"  # neither ends in black, which looks like a gap
    if panel.dots:
        look: Row = {"norm": norm, "cmap": colours, "rasterized": True}
        drawn = place.scatter(panel.x, panel.y, c=panel.values, s=14.0, edgecolors="none", **look)
    else:
        drawn = place.pcolormesh(*panel.edges(), panel.values, norm=norm, cmap=colours, rasterized=True)
        _draw_contour(place, panel)
    x, y = (panel.x, panel.y) if panel.dots else np.meshgrid(panel.x, panel.y)
    for status, mask in panel.marked.items():
        if not mask.any():
            continue
        if not panel.dots:
            grey = np.where(mask, 0.3, np.nan)
            place.pcolormesh(*panel.edges(), grey, cmap="Greys", vmin=0.0, vmax=1.0, rasterized=True)
        ink = GREY if panel.dots else _BLACK
        place.scatter(x[mask], y[mask], color=ink, marker=_OF_STATUS[status], s=14.0, label=status)
        place.legend(loc="best", fontsize=8.0, labelcolor=ink)
    figure.colorbar(drawn, ax=place, label=panel.value_label, pad=0.02)


def _draw_contour(place: "Axes", panel: Cells) -> None:
    if panel.contour is None or min(panel.values.shape) < 2 or not np.isfinite(panel.values).any():
        return
    least, most = np.nanmin(panel.values), np.nanmax(panel.values)
    if not least < panel.contour < most:
        ends = dict.fromkeys(f"{100.0 * end:.3g} %" for end in (least, most))
        text = f"{' to '.join(ends)} everywhere"
        place.text(0.5, 0.5, text, transform=place.transAxes, ha="center", color=_BLACK)
        return
    drawn = place.contour(panel.x, panel.y, panel.values, levels=[panel.contour], colors=_WHITE, linewidths=1.2)
    place.clabel(drawn, fmt=f"{100.0 * panel.contour:g} %%", fontsize=8.0)
