"""A map as one self-contained HTML page, drawn by Bokeh: every cell and point says its values under the pointer."""

import html
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from canhaptic.lab.loop.axis_loop import Array
from canhaptic.lab.studies.map.panel import Cells, Lines, Panel, common_limits
from canhaptic.view.html_page import require_bokeh, write_page

if TYPE_CHECKING:
    from bokeh.models import Plot


_WIDTH, _HEIGHT = 560, 380
_DASHES: Final = {
    "measured": "solid", "ours": "solid", "colgate": "dashed", "abbott_okamura": "dotted", "eigenvalues": "dashdot",
    "certificate": [12, 3],
}  # fmt: skip
_BLANK: Final = "#F2F2F2"
_ACROSS: Final = 3  # entries of a legend
_LEGEND_ROW: Final = 24  # pixels


def write_map(columns: Sequence[Sequence[Panel | None]], caption: str, path: Path) -> None:
    """Writes panels as a page.

    Raises:
        InputError: Bokeh is not installed, or the page cannot be written.
    """
    require_bokeh()
    from bokeh.layouts import column, gridplot
    from bokeh.models import Div

    rows = []
    for row in range(max(len(panels) for panels in columns)):
        panels = [panels[row] if row < len(panels) else None for panels in columns]
        limits = common_limits(panels)
        rows.append([None if panel is None else _figure(panel, limits) for panel in panels])
    heading = Div(text=f"<b>{html.escape(caption)}</b>")
    write_page(column(heading, gridplot(rows)), f"{caption} - canhaptic", path)


def _figure(panel: Panel, limits: tuple[float, float]) -> "Plot":
    from bokeh.plotting import figure

    types = {
        "x_axis_type": "log" if panel.x_log else "linear",
        "y_axis_type": "log" if panel.y_log else "linear",
    }
    place = figure(
        width=_WIDTH, height=_HEIGHT, title=panel.title, x_axis_label=panel.x_label, y_axis_label=panel.y_label,
        tools="pan,wheel_zoom,box_zoom,reset,save", **types,
    )  # fmt: skip
    places = panel.marks()
    if places:
        place.xaxis.ticker = places
        place.xaxis.major_label_overrides = {value: f"{value:g}" for value in places}
    if isinstance(panel, Lines):
        _lines(place, panel)
    else:
        _cells(place, panel, limits)
    return place


def _lines(place: "Plot", panel: Lines) -> None:
    from bokeh.models import HoverTool, Title

    for line in panel.lines:
        given = {"x": line.x, "y": line.y}
        place.line(
            **given,
            color=line.colour,
            line_dash=_DASHES[line.style],
            line_width=4 if line.style == "ours" else 2,
            legend_label=line.label,
        )
        dots = place.scatter(
            **given, color=line.colour, size=6 if line.style in ("measured", "ours") else 2, name=line.label
        )
        tips = [("", "$name"), (panel.x_label, "@x"), (panel.y_label, "@y")]
        place.add_tools(HoverTool(renderers=[dots], tooltips=tips))
    if panel.note:
        place.add_layout(Title(text=panel.note, text_font_size="8pt", text_font_style="normal"), "below")
    if panel.lines:
        place.legend.label_text_font_size, place.legend.border_line_alpha = "8pt", 0.0
        place.legend.click_policy, place.legend.ncols, place.legend.spacing = "hide", _ACROSS, 12
        place.height += _LEGEND_ROW * -(-len(panel.lines) // _ACROSS)
        place.add_layout(place.legend[0], "below")  # where it hides no line


def _cells(place: "Plot", panel: Cells, limits: tuple[float, float]) -> None:
    from bokeh.models import ColorBar, HoverTool, LinearColorMapper, LogColorMapper

    mapper = (LogColorMapper if panel.value_log else LinearColorMapper)(
        palette="Magma256" if panel.more_is_worse else "Viridis256",
        low=limits[0], high=limits[1], nan_color=_BLANK,
    )  # fmt: skip
    if panel.more_is_worse:
        mapper.palette = list(reversed(mapper.palette))
    colour = {"field": "value", "transform": mapper}
    if panel.dots:
        given = {"x": panel.x, "y": panel.y, "value": panel.values}
        drawn = place.scatter("x", "y", source=given, color=colour, size=6)
    else:
        drawn = place.quad("left", "right", "bottom", "top", source=_quads(panel), color=colour, line_color=colour)
    tips = [(panel.x_label, "@x"), (panel.y_label, "@y"), (panel.value_label, "@value")]
    place.add_tools(HoverTool(renderers=[drawn], tooltips=tips))
    place.add_layout(ColorBar(color_mapper=mapper, title=panel.value_label, title_text_font_size="8pt"), "right")


def _quads(panel: Cells) -> dict[str, Array]:
    x, y = panel.edges()
    rows, columns = panel.values.shape
    return {
        "left": np.tile(x[:-1], rows),
        "right": np.tile(x[1:], rows),
        "bottom": np.repeat(y[:-1], columns),
        "top": np.repeat(y[1:], columns),
        "x": np.tile(panel.x, rows),
        "y": np.repeat(panel.y, columns),
        "value": panel.values.ravel(),
    }
