"""The panels of an HTML report, linked in time; the only module of the report that needs Bokeh to be imported."""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from bokeh.layouts import column, row
from bokeh.models import (
    Button,
    ColumnDataSource,
    CustomJS,
    DataRange1d,
    Div,
    HoverTool,
    LinearAxis,
    Range1d,
    Span,
    TabPanel,
    Tabs,
)
from bokeh.plotting import figure

from canhaptic.view.palette import BLUE, GREEN, GREY, ORANGE, PURPLE, VERMILION
from canhaptic.view.series import PortSeries

_TOOLS: Final = "xpan,xwheel_zoom,xbox_zoom,reset,save"
_WORST_SPAN: Final = 0.25  # [s] shown on either side of the worst margin
_TIMING_COLOURS: Final = (BLUE, GREEN, VERMILION, PURPLE)


class Panels:
    """Makes the panels of one page; all share one time axis.

    Args:
        start: First time shown [s].
        stop: Last time shown [s].
    """

    def __init__(self, start: float, stop: float) -> None:
        stop = max(stop, start + 1e-9)
        self._all = (start, stop)
        self._time: Any = Range1d(start, stop, bounds=(start, stop))
        self._buttons: list[Any] = [self._button("whole run", start, stop)]

    def port(self, series: PortSeries, other: PortSeries | None, wall: object) -> Any:
        """Returns the tab of one port: position, torque, energy, surplus.

        A group of axes has no position; an axis in a group has no account of its own.
        """
        source = ColumnDataSource(_drawn(series))
        second = None if other is None else ColumnDataSource(_drawn(other))
        marks = ColumnDataSource(series.contacts)
        panels = [] if series.is_group else [self._position(series, source, second, wall)]
        panels.append(self._torque(series, source, second))
        if not series.is_member:
            panels += [self._energy(series, source, second), self._surplus(series, source, second)]
        for panel in panels:
            strip = panel.vstrip(x0="start", x1="end", source=marks, fill_color=GREY, fill_alpha=0.07, line_alpha=0.0)
            strip.level = "underlay"
            self._mark_faults(panel, series)
        _hover_contacts(panels[0], series)
        if not series.is_member:
            self._buttons.append(
                self._button(f"{series.name}: worst margin", series.worst - _WORST_SPAN, series.worst + _WORST_SPAN)
            )
        for number, fault in enumerate(series.faults[:3]):
            at = fault.sync_index * series.sample_time
            self._buttons.append(self._button(f"fault {number + 1} at {at:.4g} s", at - _WORST_SPAN, at + _WORST_SPAN))
        return TabPanel(title=series.name, child=column(*panels, sizing_mode="stretch_width"))

    def timing(self, columns: dict[str, Any], period: float) -> Any:
        """Returns the panel of durations within the cycle [us]."""
        panel = self._figure("timing", "us", 150)
        source = ColumnDataSource(columns)
        names = [name for name in columns if name != "time"]
        for name, colour in zip(names, _TIMING_COLOURS, strict=True):
            label = name.replace("_", " ")
            panel.line("time", name, source=source, color=colour, line_width=1.0, legend_label=label, name=name)
        panel.add_layout(Span(location=period, dimension="width", line_color=GREY, line_dash="dashed"))
        _hover(panel, names[0], [(name.replace("_", " "), f"@{name}{{0.0}} us") for name in names])
        return _finished(panel)

    def link(self, columns: dict[str, Any]) -> Any:
        """Returns the panel of frames and cycles lost, summed."""
        panel = self._figure("lost", "count", 120)
        source = ColumnDataSource(columns)
        panel.y_range = DataRange1d(start=-0.05, min_interval=1.0)
        names = [name for name in columns if name != "time"]
        colours = (BLUE, VERMILION, GREEN, ORANGE, PURPLE, GREY)
        for number, name in enumerate(names):
            colour = colours[number % len(colours)]
            panel.step("time", name, source=source, mode="after", color=colour, legend_label=name, name=name)
        _hover(panel, names[0], [(name, f"@{{{name}}}{{0}}") for name in names])
        return _finished(panel)

    def page(self, heading: str, tabs: Sequence[Any], common: Sequence[Any]) -> Any:
        """Returns the whole page."""
        return column(
            Div(text=heading, sizing_mode="stretch_width"),
            row(*self._buttons),
            Tabs(tabs=list(tabs), sizing_mode="stretch_width"),
            *common,
            sizing_mode="stretch_width",
        )

    # --- the panels of a port ---------------------------------------------------------------------------------------

    def _position(self, series: PortSeries, source: Any, second: Any, wall: object) -> Any:
        unit = series.units["position"]
        panel = self._figure("position", unit, 190)
        panel.line("time", "position", source=source, color=BLUE, line_width=1.5, legend_label="position", name="main")
        if isinstance(wall, int | float):
            panel.line(list(self._all), [wall, wall], color=GREY, line_dash="dashed", legend_label="wall")
        _dashed(panel, second, "position")
        _hover(panel, "main", [("time", "@time{0.0000} s"), ("position", f"@position{{0.000000}} {unit}")])
        return _finished(panel)

    def _torque(self, series: PortSeries, source: Any, second: Any) -> Any:
        unit = series.units["applied"]
        panel = self._figure("torque" if unit == "N*m" else "force", unit, 190)
        wide = {"source": source, "color": ORANGE, "line_width": 2.5, "alpha": 0.8}
        panel.step("time", "command", mode="after", legend_label="commanded", **wide)
        panel.step("time", "applied", mode="before", source=source, color=BLUE, legend_label="applied", name="main")
        _dashed(panel, second, "applied")
        values = [("commanded", f"@command{{0.0000}} {unit}"), ("applied", f"@applied{{0.0000}} {unit}")]
        _hover(panel, "main", [("time", "@time{0.0000} s"), *values])
        return _finished(panel)

    def _energy(self, series: PortSeries, source: Any, second: Any) -> Any:
        panel = self._figure("energy", "J", 240)
        green = {"source": source, "fill_color": GREEN, "fill_alpha": 0.22, "legend_label": "margin"}
        panel.varea("time", "dissipated", "upper", **green)
        panel.varea("time", "taken_in", "upper", source=source, fill_color=VERMILION, fill_alpha=0.5)
        panel.line("time", "taken_in", source=source, color=BLUE, line_width=1.5, legend_label="in", name="main")
        dashes = {"line_dash": [6, 3], "legend_label": "dissipated"}
        panel.line("time", "dissipated", source=source, color=VERMILION, line_width=1.5, **dashes)
        _dashed(panel, second, "taken_in", "dissipated")
        worst = int(np.argmin(series.columns["margin"]))
        least = float(series.columns["margin"][worst])
        label = f"least margin {least:.3g} J at {series.worst:.6g} s"
        place = [float(series.columns["taken_in"][worst])]
        panel.scatter([series.worst], place, size=8, color="black", legend_label=label)
        names = {"taken_in": "in", "dissipated": "dissipated", "margin": "margin"}
        values = [(label, f"@{name}{{0.000000000}} J") for name, label in names.items()]
        _hover(panel, "main", [("time", "@time{0.0000} s"), *values])
        return _finished(panel)

    def _surplus(self, series: PortSeries, source: Any, second: Any) -> Any:
        panel = self._figure("surplus", "J", 170)
        style = {"color": ORANGE, "line_width": 1.5, "legend_label": "surplus", "name": "main"}
        panel.y_range.renderers = [panel.line("time", "surplus", source=source, **style)]
        panel.extra_y_ranges = {"damping": DataRange1d(only_visible=True)}
        unit = series.units["damping"]
        panel.add_layout(LinearAxis(y_range_name="damping", axis_label=f"damper [{unit}]"), "right")
        damper = {"color": GREEN, "alpha": 0.7, "legend_label": "damper rendered", "y_range_name": "damping"}
        damping = panel.step("time", "damping", mode="after", source=source, **damper)
        panel.extra_y_ranges["damping"].renderers = [damping]
        _dashed(panel, second, "surplus")
        values = [("surplus", "@surplus{0.000000000} J"), ("damper", f"@damping{{0.0000}} {unit}")]
        _hover(panel, "main", [("time", "@time{0.0000} s"), *values])
        return _finished(panel)

    def _figure(self, title: str, unit: str, height: int) -> Any:
        panel = figure(
            x_range=self._time,
            height=height,
            tools=_TOOLS,
            active_drag="xbox_zoom",
            active_scroll="xwheel_zoom",
            output_backend="canvas",
            window_axis="x",
            sizing_mode="stretch_width",
            min_border_left=90,
            min_border_right=90,
        )
        panel.yaxis.axis_label = f"{title} [{unit}]"
        panel.toolbar.logo = None
        panel.grid.grid_line_color = "#E6E6E6"
        return panel

    def _mark_faults(self, panel: Any, series: PortSeries) -> None:
        if series.faults:
            at = [fault.sync_index * series.sample_time for fault in series.faults]
            texts = [f"{fault.kind}: {fault.text}" for fault in series.faults]
            source = ColumnDataSource({"at": at, "text": texts})
            mark = panel.vspan(x="at", source=source, line_color=VERMILION, line_width=1.5, line_dash="dotted")
            panel.add_tools(HoverTool(renderers=[mark], tooltips=[("", "@text"), ("at", "@at{0.0000} s")]))

    def _button(self, label: str, start: float, stop: float) -> Any:
        low, high = max(start, self._all[0]), min(stop, self._all[1])
        code = "range.start = low; range.end = high"
        button = Button(label=label, width=max(110, 8 * len(label)), height=30)
        button.js_on_click(CustomJS(args={"range": self._time, "low": low, "high": high}, code=code))
        return button


def _drawn(series: PortSeries) -> dict[str, Any]:
    upper = np.maximum(series.columns["taken_in"], series.columns["dissipated"])
    return {**series.columns, "upper": upper}


def _dashed(panel: Any, source: Any, *names: str) -> None:
    """Draws the second run of a comparison."""
    if source is not None:
        for name in names:
            style = {"color": "black", "line_width": 1.0, "line_dash": [3, 2], "legend_label": "other run"}
            panel.line("time", name, source=source, **style)


def _hover(panel: Any, main: str, tooltips: list[tuple[str, str]]) -> None:
    renderers = [renderer for renderer in panel.renderers if renderer.name == main]
    panel.add_tools(HoverTool(renderers=renderers, mode="vline", tooltips=tooltips, line_policy="nearest"))


def _hover_contacts(panel: Any, series: PortSeries) -> None:
    strips = [renderer for renderer in panel.renderers if type(renderer.glyph).__name__ == "VStrip"]
    unit = series.units["applied"]
    tooltips = [
        ("contact", "@start{0.0000} s to @end{0.0000} s"),
        ("peak", f"@peak{{0.000}} {unit}"),
        ("energy in", "@energy{0.000000} J"),
    ]
    panel.add_tools(HoverTool(renderers=strips, tooltips=tooltips, attachment="below"))


def _finished(panel: Any) -> Any:
    """Puts the legend above the panel, where nothing can lie on the data."""
    legend = panel.legend[0]
    legend.orientation, legend.location, legend.click_policy = "horizontal", "right", "hide"
    legend.border_line_alpha, legend.padding, legend.margin = 0.0, 0, 0
    legend.label_text_font_size = "9pt"
    panel.add_layout(legend, "above")
    return panel
