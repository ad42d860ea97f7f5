"""The page of a finished run: tabs of ports, panels linked in time; needs Bokeh to be imported."""

from collections.abc import Mapping, Sequence
from itertools import cycle
from typing import Final

import numpy as np
from bokeh.layouts import column, row
from bokeh.models import Button, Column, ColumnDataSource, CustomJS, Div, HoverTool, Range1d, TabPanel, Tabs
from bokeh.plotting import figure

from canhaptic.logs.hdf5 import Array
from canhaptic.view.bokeh_style import add_hover, finished, new_plane, new_xy
from canhaptic.view.common_panels import link_panel, timing_panel
from canhaptic.view.cursors import add_cursors
from canhaptic.view.palette import BLUE, GREY, OVERLAID
from canhaptic.view.port_panels import PortPanels, fault_columns, is_empty
from canhaptic.view.series import PortFacts, PortSeries
from canhaptic.view.si import si
from canhaptic.view.task_plane import TaskPlane

_WORST_SPAN: Final = 0.25  # [s] shown on either side of the worst margin


class Panels:
    """Makes the panels of one page; all share one time axis.

    Args:
        start: First time shown [s].
        stop: Last time shown [s].

    Attributes:
        empty: Panels that were left out because all their data are zero.
    """

    def __init__(self, start: float, stop: float) -> None:
        stop = max(stop, start + 1e-9)
        self._all = (start, stop)
        self._time = Range1d(start, stop, bounds=(start, stop))
        self._buttons: list[Button] = [self._button("whole run", start, stop)]
        self.empty: list[str] = []

    def port(self, series: PortSeries, others: Mapping[str, PortSeries], plane: TaskPlane | None) -> TabPanel:
        """Returns the tab of one port: path, position, torque, energy, surplus, damping; those that show something.

        Below them is force over position, where the port has a position; `others` are further runs by their names.
        """
        facts = series.facts
        marks = ColumnDataSource(series.contacts)
        further = [(name, ColumnDataSource(other.columns)) for name, other in others.items()]
        source = ColumnDataSource(series.columns)
        faults = ColumnDataSource(fault_columns(series.faults))
        made = PortPanels(facts, self._time, source, marks, faults, further, stairs=series.is_whole).panels
        panels = [panel for name, panel in made.items() if not is_empty(name, series.columns)]
        self.empty += [f"{facts.name}: {name}" for name in made if is_empty(name, series.columns)]
        _hover_contacts(panels[0], series)
        if not facts.is_member:
            if made["energy"] in panels:
                _mark_worst(made["energy"], series)
            label = f"{facts.name}: worst margin"
            self._buttons.append(self._button(label, series.worst - _WORST_SPAN, series.worst + _WORST_SPAN))
        for number, fault in enumerate(series.faults[:3]):
            first, last = fault.time - _WORST_SPAN, fault.time + _WORST_SPAN
            self._buttons.append(self._button(f"fault {number + 1} at {fault.time:.4g} s", first, last))
        readout = add_cursors(panels, source, facts.units, self._all)
        if plane is not None:
            panels.insert(0, _drawn_plane(plane))
        if not facts.is_group:
            panels.append(_force_over_position(facts, source, further))
        panels.append(readout)
        return TabPanel(title=facts.name, child=column(*panels, sizing_mode="stretch_width"))

    def timing(self, columns: Mapping[str, Array], period: float) -> figure:
        """Returns the panel of durations within the cycle [s]."""
        return timing_panel(self._time, ColumnDataSource(columns), period)

    def link(self, columns: Mapping[str, Array]) -> figure:
        """Returns the panel of frames and cycles lost, summed."""
        return link_panel(self._time, ColumnDataSource(columns))

    def page(self, heading: str, tabs: Sequence[TabPanel], common: Sequence[figure]) -> Column:
        """Returns the whole page."""
        return column(
            Div(text=heading, sizing_mode="stretch_width", name="heading"),
            row(*self._buttons),
            Tabs(tabs=list(tabs), sizing_mode="stretch_width"),
            *common,
            sizing_mode="stretch_width",
        )

    def _button(self, label: str, start: float, stop: float) -> Button:
        low, high = max(start, self._all[0]), min(stop, self._all[1])
        code = "range.start = low; range.end = high"
        button = Button(label=label, width=max(110, 8 * len(label)), height=30)
        button.js_on_click(CustomJS(args={"range": self._time, "low": low, "high": high}, code=code))
        return button


def _force_over_position(
    facts: PortFacts, source: ColumnDataSource, others: Sequence[tuple[str, ColumnDataSource]]
) -> figure:
    """Returns the panel of the torque that acted over the position: its slope is the stiffness felt."""
    effort = "torque" if facts.units["applied"] == "N*m" else "force"
    title, label = f"{facts.name}: {effort} over position", "on the hand" if facts.is_display else "applied"
    panel = new_xy(title, facts.units["applied"], "position", facts.units["position"], 300)
    panel.line("position", "applied", source=source, color=BLUE, line_width=1.2, legend_label=label, name="xy")
    for (label, further), colour in zip(others, cycle(OVERLAID)):
        style = {"color": colour, "line_width": 1.0, "line_dash": [3, 2], "legend_label": label}
        panel.line("position", "applied", source=further, **style)
    units = {"position": ("position", facts.units["position"]), "applied": ("applied", facts.units["applied"])}
    add_hover(panel, "xy", units, "mouse")
    return finished(panel)


def _drawn_plane(plane: TaskPlane) -> figure:
    """Returns the path of the handle against the surface, material shaded."""
    panel = new_plane(f"{plane.name}: path", plane.unit, plane.across, plane.along, 380)
    deepest = max(float(plane.depth.max()), plane.surface + 1e-12)
    filled = {"fill_color": [GREY], "line_color": [GREY], "fill_alpha": 0.15}
    levels = [plane.surface, deepest * (1.0 + 1e-9)]
    material = panel.contour(plane.across, plane.along, plane.depth, levels, **filled)
    material.fill_renderer.name, material.line_renderer.name = "material", "surface"
    panel.line([np.nan], [np.nan], color=GREY, legend_label="surface")
    x, y = plane.path.T
    source = ColumnDataSource({"time": plane.time, "x": x, "y": y})
    panel.line("x", "y", source=source, color=BLUE, line_width=1.2, legend_label="path", name="path")
    add_hover(panel, "path", {"x": ("x", plane.unit), "y": ("y", plane.unit)}, "mouse")
    return finished(panel)


def _mark_worst(panel: figure, series: PortSeries) -> None:
    worst = int(np.argmin(series.columns["margin"]))
    label = f"least margin {si(float(series.columns['margin'][worst]), 'J')} at {series.worst:.6g} s"
    place = [float(series.columns["taken_in"][worst])]
    panel.scatter([series.worst], place, size=8, color="black", legend_label=label)


def _hover_contacts(panel: figure, series: PortSeries) -> None:
    strips = [renderer for renderer in panel.renderers if renderer.name == "contacts"]
    unit = series.facts.units["applied"]
    tooltips = [
        ("contact", "@start{0.0000} s to @end{0.0000} s"),
        ("peak", f"@peak{{0.000}} {unit}"),
        ("energy in", "@energy{0.000000} J"),
    ]
    panel.add_tools(HoverTool(renderers=strips, tooltips=tooltips, attachment="below"))
