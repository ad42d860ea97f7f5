"""A study of accuracy as one page that any browser opens without a network; drawn by Bokeh, imported on demand."""

import html
from pathlib import Path
from typing import TYPE_CHECKING, Final

from canhaptic.errors import InputError
from canhaptic.lab.render.accuracy_picture import GROUPS, STYLES, price_of
from canhaptic.lab.studies.accuracy.accuracy_choice import FLOOR
from canhaptic.lab.studies.accuracy.accuracy_table import Row, advice_lines, heading
from canhaptic.lab.studies.accuracy.advice import front
from canhaptic.view.html_page import decades, require_bokeh, write_page

if TYPE_CHECKING:
    from bokeh.models import ColumnDataSource, Plot


_TOOLS: Final = "pan,wheel_zoom,box_zoom,reset,save"
_MARKERS: Final = {
    "o": "circle",
    "v": "inverted_triangle",
    "s": "square",
    "^": "triangle",
    "D": "diamond",
    "*": "star",
    "P": "plus",
    "X": "hex",
}


def write_accuracy_page(result: Row, path: Path) -> None:
    """Writes a study as one self-contained page with hover, zoom and a legend that hides methods.

    Raises:
        InputError: Nothing was measured, Bokeh is not installed, or the page cannot be written.
    """
    if not result["plant"]:
        raise InputError("nothing was measured, there is nothing to draw")
    require_bokeh()
    from bokeh.layouts import column, row
    from bokeh.models import Div

    words = "".join(f"<p>{html.escape(line)}</p>" for line in (*advice_lines(result), *heading(result)))
    price = price_of(result)
    panels = [
        _ladder(result, *price, "position_error", f"largest error of the position [{result['unit']}]"),
        _ladder(
            result, "evaluations_per_period", "evaluations per period", "energy_error", "largest error of an energy [J]"
        ),
    ]
    parts = [Div(text=words), row(*panels)]
    if any(r["position_error"] for r in result["loop"]):
        parts.append(_loop(result))
    write_page(column(*parts), f"{result['scene']} - accuracy", path)


def _ladder(result: Row, price: str, price_label: str, error: str, error_label: str) -> "Plot":
    from bokeh.models import HoverTool
    from bokeh.plotting import figure

    panel = figure(
        width=620, height=540, x_axis_type="log", y_axis_type="log", tools=_TOOLS, x_axis_label=price_label,
        y_axis_label=error_label,
    )  # fmt: skip
    least = FLOOR * result["reference"]["travel" if error == "position_error" else "energy"]
    for method in dict.fromkeys(r["method"] for r in result["plant"]):
        own = [r for r in result["plant"] if r["method"] == method and r["status"] == "ok" and r.get(price)]
        if not own:
            continue
        colour, marker = STYLES[method]
        source = _points_of(own, price, error, least, colour)
        panel.scatter(
            "price", "error", source=source, marker=_MARKERS[marker], size=9, color=colour,
            line_color="edge", line_width=2, legend_label=method,
        )  # fmt: skip
    points = [(r[price], max(r[error], least)) for r in result["plant"] if r["status"] == "ok" and r.get(price)]
    if points:
        x, y = zip(*sorted(front(points)), strict=True)
        panel.step(x, y, mode="after", line_color="black", line_dash="dashed", legend_label="Pareto front")
        panel.x_range = decades([price for price, _ in points])
    if error == "position_error":
        look = {"line_color": "#CC0000", "line_dash": "dotted", "line_width": 2, "legend_label": "tolerance"}
        panel.hspan(y=[result["tolerance"]], **look)
    panel.add_tools(
        HoverTool(tooltips=[("", "@name"), (error_label, "@error"), (price_label, "@price"), ("", "@pareto")])
    )
    panel.legend.click_policy = "hide"
    panel.legend.ncols, panel.legend.border_line_alpha = 3, 0.0
    panel.add_layout(panel.legend[0], "below")  # where it hides no point
    return panel


def _points_of(own: list[Row], price: str, error: str, least: float, colour: str) -> "ColumnDataSource":
    """Returns the points of one method; an error below `least` is drawn there."""
    from bokeh.models import ColumnDataSource

    return ColumnDataSource(
        {
            "price": [r[price] for r in own],
            "error": [max(r[error], least) for r in own],
            "name": [f"{r['method']}, {r['setting']}" for r in own],
            "edge": ["black" if r["pareto"] else colour for r in own],
            "pareto": ["on the Pareto front" if r["pareto"] else "" for r in own],
        }
    )


def _loop(result: Row) -> "Plot":
    from bokeh.models import ColumnDataSource, HoverTool
    from bokeh.plotting import figure

    rows = [r for r in result["loop"] if r["position_error"]]
    names = [f"{r['group']}: {r['setting']}" for r in rows]
    panel = figure(
        width=1240, height=120 + 20 * len(rows), x_axis_type="log", y_range=names[::-1], tools=_TOOLS,
        x_axis_label=f"largest difference of the position from the continuous axis [{result['unit']}]",
    )  # fmt: skip
    source = ColumnDataSource(
        {
            "name": names,
            "error": [r["position_error"] for r in rows],
            "energy": [r["energy_error"] for r in rows],
            "load": [100.0 * r["bus_load"] for r in rows],
            "thread": [r.get("control_thread_us") or float("nan") for r in rows],
            "colour": [GROUPS[r["group"]] for r in rows],
        }
    )
    panel.scatter("error", "name", source=source, size=9, color="colour")
    tips = [
        ("", "@name"), ("position", f"@error {result['unit']}"), ("energy", "@energy J"), ("bus load", "@load{0.0} %"),
        ("control thread", "@thread{0.0} us"),
    ]  # fmt: skip
    panel.add_tools(HoverTool(tooltips=tips))
    return panel
