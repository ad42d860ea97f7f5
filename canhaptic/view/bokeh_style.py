"""Style of the panels of live pages: frame, legend, and numbers with an SI prefix.

The data of a page are in SI units. The browser chooses the prefix of an axis from its ticks, so that the prefix follows
zoom and new data.
"""

from collections.abc import Mapping
from typing import Final

from bokeh.models import CustomJSHover, CustomJSTickFormatter, HoverTool, Range
from bokeh.plotting import figure

from canhaptic.axis_units import prefixes_of

_TOOLS: Final = "xpan,xwheel_zoom,xbox_zoom,reset,save"
_PREFIX: Final = """
const near = (value) => prefixes.find(([scale]) => Math.abs(value) >= scale * (1 - 1e-9)) ?? prefixes.at(-1);
"""
_TICKS: Final = (
    _PREFIX
    + """
const largest = Math.max(...ticks.map(Math.abs));
if (largest == 0) return `0 ${unit}`;
const [scale, prefix] = near(largest);
const step = ticks.length > 1 ? Math.abs(ticks[1] - ticks[0]) : largest;
const digits = Math.min(12, Math.max(0, Math.ceil(-Math.log10(step / scale) - 1e-9)));
return `${(tick / scale).toFixed(digits)} ${prefix}${unit}`;
"""
)
_VALUE: Final = (
    _PREFIX
    + """
if (!isFinite(value)) return "-";
if (value == 0) return `0 ${unit}`;
const [scale, prefix] = near(value);
return `${(value / scale).toPrecision(5)} ${prefix}${unit}`;
"""
)


def new_panel(title: str, unit: str, time: Range, height: int) -> figure:
    """Return an empty panel over time.

    Args:
        title: Label of the vertical axis.
        unit: SI unit, shown with a prefix at the ticks.
        time: Time range shared by all panels of a page.
        height: Height [pixels].
    """
    panel = figure(
        x_range=time,
        height=height,
        tools=_TOOLS,
        active_drag="xbox_zoom",
        active_scroll="xwheel_zoom",
        output_backend="canvas",
        window_axis="x",
        sizing_mode="stretch_width",
        min_border_left=90,
        min_border_right=40,
        name=title,
    )
    panel.yaxis.axis_label = title
    panel.xaxis.formatter, panel.yaxis.formatter = si_ticks("s"), si_ticks(unit)
    panel.toolbar.logo = None
    panel.grid.grid_line_color = "#E6E6E6"
    return panel


def si_ticks(unit: str) -> CustomJSTickFormatter:
    """Return a formatter for the ticks of an axis; the largest tick decides on the SI prefix of all."""
    return CustomJSTickFormatter(args={"prefixes": prefixes_of(unit), "unit": unit}, code=_TICKS)


def add_hover(panel: figure, unit: str, columns: Mapping[str, str]) -> None:
    """Show time and values at the pointer, with five digits and SI prefix; it snaps to the line of the first column.

    Args:
        panel: Panel to extend.
        unit: SI unit of the values.
        columns: Label -> name of the data column.
    """
    main = next(iter(columns.values()))
    renderers = [renderer for renderer in panel.renderers if renderer.name == main]
    tooltips = [("time", "@time{0.0000} s"), *((label, f"@{{{name}}}{{custom}}") for label, name in columns.items())]
    value = CustomJSHover(args={"prefixes": prefixes_of(unit), "unit": unit}, code=_VALUE)
    formatters = {f"@{{{name}}}": value for name in columns.values()}
    tool = HoverTool(renderers=renderers, mode="vline", tooltips=tooltips, formatters=formatters, line_policy="nearest")
    panel.add_tools(tool)


def finished(panel: figure) -> figure:
    """Put the legend above the panel, where it cannot hide data."""
    legend = panel.legend[0]
    legend.orientation, legend.location, legend.click_policy = "horizontal", "right", "hide"
    legend.border_line_alpha, legend.padding, legend.margin, legend.spacing = 0.0, 0, 0, 16
    legend.label_text_font_size = "9pt"
    panel.add_layout(legend, "above")
    return panel
