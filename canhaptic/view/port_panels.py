"""Panels of one port on the page of a running run, in the colours of the picture of a finished one.

Decimated data are drawn as plain lines: between two distant rows a stair would show a value for as long as
none is known.

The panels that all ports of a page share: durations within the cycle, and losses.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from bokeh.models import BoxAnnotation, ColumnDataSource, DataRange1d, HoverTool, Range, Span
from bokeh.plotting import figure

from canhaptic.logs.hdf5 import Array
from canhaptic.view.bokeh_style import add_hover, finished, new_panel
from canhaptic.view.picture_style import BLUE, GREEN, GREY, ORANGE, PURPLE, VERMILION
from canhaptic.view.series import MarkedEvent, PortFacts

_TIMING_COLOURS: Final = (BLUE, GREEN, VERMILION, PURPLE)


def timing_panel(time: Range, source: ColumnDataSource, period: float) -> figure:
    """Return the panel of durations within the cycle.

    Args:
        time: Time range shared by all panels.
        source: Columns time and, for each duration, its name [s].
        period: Period drawn across the panel [s].
    """
    panel = new_panel("timing", "s", time, 150)
    names = [name for name in source.data if name != "time"]
    for name, colour in zip(names, _TIMING_COLOURS, strict=True):
        label = name.replace("_", " ")
        panel.line("time", name, source=source, color=colour, line_width=1.0, legend_label=label, name=name)
    panel.add_layout(Span(location=period, dimension="width", line_color=GREY, line_dash="dashed"))
    add_hover(panel, names[0], {name.replace("_", " "): (name, "s") for name in names})
    return finished(panel)


def link_panel(time: Range, source: ColumnDataSource) -> figure:
    """Return the panel of cumulative losses; every change is a row of `source`, so that its steps are exact."""
    panel = new_panel("lost", "", time, 130)
    panel.y_range = DataRange1d(start=-0.05, min_interval=1.0)
    names = [name for name in source.data if name != "time"]
    colours = (BLUE, VERMILION, GREEN, ORANGE, PURPLE, GREY)
    for number, name in enumerate(names):
        colour = colours[number % len(colours)]
        panel.step("time", name, source=source, mode="after", color=colour, legend_label=name, name=name)
    add_hover(panel, names[0], {name: (name, "") for name in names})
    return finished(panel)


OPTIONAL: Final[dict[str, tuple[str, ...]]] = {
    "energy": ("taken_in", "dissipated"),
    "surplus": ("surplus", "deficit"),
    "damping": ("damping",),
}
"""Panel -> its columns; where all of them are zero, the panel is left out."""


def is_empty(name: str, columns: Mapping[str, Array]) -> bool:
    """Return whether a panel would show nothing but zeros."""
    return name in OPTIONAL and not any(np.any(columns[column]) for column in OPTIONAL[name])


def fault_columns(faults: Sequence[MarkedEvent]) -> dict[str, list[float] | list[str]]:
    """Return the columns `at` and `text` of faults."""
    return {
        "at": [fault.time for fault in faults],
        "text": [f"{fault.event.kind}: {fault.event.text}" for fault in faults],
    }


class PortPanels:
    """Factory of the panels of one port.

    Args:
        facts: Figures of the port.
        time: Time range shared by all panels.
        source: Columns of `LiveLog`.
        contacts: Columns start and end of each contact [s].
        faults: Columns at [s] and text of each fault.

    Attributes:
        panels: Title -> panel, top to bottom; a group has no position, an axis of a group no energy, and only an
            admittance display a velocity.
    """

    def __init__(
        self,
        facts: PortFacts,
        time: Range,
        source: ColumnDataSource,
        contacts: ColumnDataSource,
        faults: ColumnDataSource,
    ) -> None:
        self._facts, self._time, self._source = facts, time, source
        self.panels: dict[str, figure] = {}
        if not facts.is_group:
            self.panels["position"] = self._position()
        if facts.is_display:
            self.panels["velocity"] = self._velocity()
        self.panels["torque"] = self._torque()
        if not facts.is_member:
            self.panels |= {"energy": self._energy(), "surplus": self._surplus(), "damping": self._damping()}
        for panel in self.panels.values():
            strip = panel.vstrip(x0="start", x1="end", source=contacts, fill_color=GREY, fill_alpha=0.07, line_alpha=0)
            strip.level, strip.name = "underlay", "contacts"
            mark = panel.vspan(x="at", source=faults, line_color=VERMILION, line_width=1.5, line_dash="dotted")
            panel.add_tools(HoverTool(renderers=[mark], tooltips=[("", "@text"), ("at", "@at{0.0000} s")]))

    def _panel(self, title: str, unit: str, height: int) -> figure:
        return new_panel(f"{self._facts.name}: {title}", unit, self._time, height)

    def _line(self, panel: figure, name: str, **style: Any) -> None:
        panel.line("time", name, source=self._source, name=name, **style)

    def _position(self) -> figure:
        unit, wall = self._facts.units["position"], self._facts.wall
        panel = self._panel("position", unit, 190)
        self._line(panel, "position", color=BLUE, line_width=1.5, legend_label="position")
        if wall is not None:
            panel.hspan(y=[wall], line_color=GREY, line_dash="dashed", legend_label="wall", name="wall")
            edge = {"top": wall} if self._facts.wall_side == "below" else {"bottom": wall}
            panel.add_layout(BoxAnnotation(**edge, fill_color=GREY, fill_alpha=0.10, line_alpha=0.0, level="underlay"))
        if self._facts.notches:
            look: Any = {"line_color": GREY, "line_dash": "dashed", "line_alpha": 0.6}
            panel.hspan(y=self._facts.notches, legend_label="notch", name="notches", **look)
            panel.y_range = DataRange1d(renderers=panel.select({"name": "position"}))
        add_hover(panel, "position", {"position": ("position", unit)})
        return finished(panel)

    def _torque(self) -> figure:
        unit = self._facts.units["applied"]
        panel = self._panel("torque" if unit == "N*m" else "force", unit, 190)
        label, values = "on the hand" if self._facts.is_display else "applied", {"applied": ("applied", unit)}
        if not self._facts.is_display:
            self._line(panel, "command", color=ORANGE, line_width=2.5, alpha=0.8, legend_label="commanded")
            values["commanded"] = ("command", unit)
        self._line(panel, "applied", color=BLUE, line_width=1.2, legend_label=label)
        add_hover(panel, "applied", values)
        return finished(panel)

    def _velocity(self) -> figure:
        unit = self._facts.units["command"]
        panel = self._panel("velocity", unit, 190)
        self._line(panel, "command", color=ORANGE, line_width=1.5, legend_label="commanded")
        add_hover(panel, "command", {"commanded": ("command", unit)})
        return finished(panel)

    def _energy(self) -> figure:
        panel = self._panel("energy", "J", 240)
        area = {"source": self._source, "legend_label": "margin"}
        panel.varea("time", "dissipated", "upper", fill_color=GREEN, fill_alpha=0.22, name="margin", **area)
        area["legend_label"] = "margin below 0"
        panel.varea("time", "taken_in", "upper", fill_color=VERMILION, fill_alpha=0.5, name="negative margin", **area)
        self._line(panel, "taken_in", color=BLUE, line_width=1.5, legend_label="in")
        self._line(panel, "dissipated", color=VERMILION, line_width=1.5, line_dash=[6, 3], legend_label="dissipated")
        names = {"in": "taken_in", "dissipated": "dissipated", "margin": "margin"}
        add_hover(panel, "taken_in", {label: (name, "J") for label, name in names.items()})
        return finished(panel)

    def _surplus(self) -> figure:
        panel = self._panel("surplus", "J", 150)
        self._line(panel, "surplus", color=ORANGE, line_width=1.5, legend_label="surplus to dissipate")
        self._line(panel, "deficit", color=VERMILION, line_dash=[6, 3], legend_label="deficit, summed")
        add_hover(panel, "surplus", {"surplus": ("surplus", "J"), "deficit": ("deficit", "J")})
        return finished(panel)

    def _damping(self) -> figure:
        unit = self._facts.units["damping"]
        panel = self._panel("damping", unit, 130)
        self._line(panel, "damping", color=GREEN, line_width=1.2, legend_label="damping rendered")
        add_hover(panel, "damping", {"damping": ("damping", unit)})
        return finished(panel)
