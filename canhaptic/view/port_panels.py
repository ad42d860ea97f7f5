"""The panels of one port, on the page of a finished run and on that of a running one: the same lines and colours.

Data that are decimated are drawn as plain lines: between two rows that are far apart a stair would show a value for as
long as nothing is known of it. Only where every row is drawn does a torque stay until the SYNC that changes it.
"""

from collections.abc import Mapping, Sequence
from itertools import cycle
from typing import Any, Final

import numpy as np
from bokeh.models import BoxAnnotation, ColumnDataSource, HoverTool, Range
from bokeh.plotting import figure

from canhaptic.logs.hdf5 import Array
from canhaptic.view.bokeh_style import add_hover, finished, new_panel
from canhaptic.view.palette import BLUE, GREEN, GREY, ORANGE, OVERLAID, VERMILION
from canhaptic.view.series import MarkedEvent, PortFacts

OPTIONAL: Final[dict[str, tuple[str, ...]]] = {
    "energy": ("taken_in", "dissipated"),
    "surplus": ("surplus", "deficit"),
    "damping": ("damping",),
}
"""Panel -> its columns; where all of them are zero, the panel is left out."""


def is_empty(name: str, columns: Mapping[str, Array]) -> bool:
    """Returns whether a panel would show nothing but zeros."""
    return name in OPTIONAL and not any(np.any(columns[column]) for column in OPTIONAL[name])


def fault_columns(faults: Sequence[MarkedEvent]) -> dict[str, list[float] | list[str]]:
    """Returns the columns `at` and `text` of faults."""
    return {
        "at": [fault.time for fault in faults],
        "text": [f"{fault.event.kind}: {fault.event.text}" for fault in faults],
    }


class PortPanels:
    """Makes the panels of one port.

    Args:
        facts: Figures of the port.
        time: The range that all panels share.
        source: Columns of `PortSeries.columns`.
        contacts: Columns start and end of each contact [s].
        faults: Columns at [s] and text of each fault.
        others: Name and source of further runs, drawn over it in thin dashed lines.
        stairs: Whether every row is drawn.

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
        others: Sequence[tuple[str, ColumnDataSource]] = (),
        *,
        stairs: bool = False,
    ) -> None:
        self._facts, self._time, self._source, self._others, self._stairs = facts, time, source, others, stairs
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

    def _line(self, panel: figure, name: str, hold: str | None = None, **style: Any) -> None:
        """Draws a column; `hold` says on which side of a row its value acts, where it is drawn as a stair."""
        if hold is not None and self._stairs:
            panel.step("time", name, mode=hold, source=self._source, name=name, **style)
        else:
            panel.line("time", name, source=self._source, name=name, **style)

    def _other(self, panel: figure, *names: str) -> None:
        """Draws the other runs over this one."""
        for (label, source), colour in zip(self._others, cycle(OVERLAID)):
            for name in names:
                style = {"color": colour, "line_width": 1.0, "line_dash": [3, 2], "legend_label": label}
                panel.line("time", name, source=source, **style)

    def _position(self) -> figure:
        unit, wall = self._facts.units["position"], self._facts.wall
        panel = self._panel("position", unit, 190)
        self._line(panel, "position", color=BLUE, line_width=1.5, legend_label="position")
        if wall is not None:
            panel.hspan(y=[wall], line_color=GREY, line_dash="dashed", legend_label="wall", name="wall")
            edge = {"top": wall} if self._facts.wall_side == "below" else {"bottom": wall}
            panel.add_layout(BoxAnnotation(**edge, fill_color=GREY, fill_alpha=0.10, line_alpha=0.0, level="underlay"))
        self._other(panel, "position")
        add_hover(panel, "position", {"position": ("position", unit)})
        return finished(panel)

    def _torque(self) -> figure:
        unit = self._facts.units["applied"]
        panel = self._panel("torque" if unit == "N*m" else "force", unit, 190)
        label, values = "on the hand" if self._facts.is_display else "applied", {"applied": ("applied", unit)}
        if not self._facts.is_display:
            self._line(panel, "command", "after", color=ORANGE, line_width=2.5, alpha=0.8, legend_label="commanded")
            values["commanded"] = ("command", unit)
        self._line(panel, "applied", "before", color=BLUE, line_width=1.2, legend_label=label)
        self._other(panel, "applied")
        add_hover(panel, "applied", values)
        return finished(panel)

    def _velocity(self) -> figure:
        unit = self._facts.units["command"]
        panel = self._panel("velocity", unit, 190)
        self._line(panel, "command", "after", color=ORANGE, line_width=1.5, legend_label="commanded")
        self._other(panel, "command")
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
        self._other(panel, "taken_in", "dissipated")
        names = {"in": "taken_in", "dissipated": "dissipated", "margin": "margin"}
        add_hover(panel, "taken_in", {label: (name, "J") for label, name in names.items()})
        return finished(panel)

    def _surplus(self) -> figure:
        panel = self._panel("surplus", "J", 150)
        self._line(panel, "surplus", color=ORANGE, line_width=1.5, legend_label="surplus to dissipate")
        self._line(panel, "deficit", color=VERMILION, line_dash=[6, 3], legend_label="deficit, summed")
        self._other(panel, "surplus")
        add_hover(panel, "surplus", {"surplus": ("surplus", "J"), "deficit": ("deficit", "J")})
        return finished(panel)

    def _damping(self) -> figure:
        unit = self._facts.units["damping"]
        panel = self._panel("damping", unit, 130)
        self._line(panel, "damping", "after", color=GREEN, line_width=1.2, legend_label="damping rendered")
        add_hover(panel, "damping", {"damping": ("damping", unit)})
        return finished(panel)
