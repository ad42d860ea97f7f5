"""The page of `canhaptic scope`: position, torque, energy account and cycle time of the last seconds, as they come."""

import html
from typing import Any, Final

import numpy as np
from bokeh.layouts import column
from bokeh.models import ColumnDataSource, DataRange1d, Div, HoverTool
from bokeh.plotting import figure

from canhaptic.drive.profile.power_states import drive_state
from canhaptic.units import effort_unit
from canhaptic.view.decimate import decimate
from canhaptic.view.live_log import LiveLog, News
from canhaptic.view.palette import BLUE, GREEN, GREY, ORANGE, VERMILION
from canhaptic.view.si import si

_POINTS: Final = 6000  # kept per line
_BUCKETS: Final = 250  # per look; about twice as many rows
_LINES: Final = ("position", "torque_command", "torque_applied", "taken_in", "dissipated", "margin", "h_dis")
_LABELS: Final = {
    "torque_command": "commanded",
    "torque_applied": "applied",
    "taken_in": "in",
    "h_dis": "surplus",
    "cycle_time": "SYNC to RPDO",
}
_EVENTS_SHOWN: Final = 4


class ScopePage:
    """One visitor's view of a log that is being written.

    Args:
        document: The visitor's Bokeh document.
        log: What to follow; each visitor has its own.
        window: Seconds shown [s].
        period: Between two looks [s].
    """

    def __init__(self, document: Any, log: LiveLog, window: float, period: float) -> None:
        self._document = document
        self._log = log
        self._window = window
        self._status: Any = Div(text=f"waiting for {html.escape(str(log.path))} ...", name="status")
        self._time: Any = DataRange1d(follow="end", follow_interval=window, range_padding=0.0)
        self._sources: dict[str, Any] = {}
        self._timing: Any = ColumnDataSource({"time": [], "cycle_time": []})
        document.title = f"canhaptic scope: {log.path.name}"
        document.add_root(column(self._status, sizing_mode="stretch_width", name="root"))
        document.add_periodic_callback(self.update, max(50, round(1000 * period)))

    def update(self) -> None:
        """Takes what is new into the page."""
        news = self._log.look()
        if news is None:
            return
        if news.restarted or not self._sources:
            self._build(news)
        if len(news.time):
            keep = news.time >= news.time[-1] - self._window
            for name, rows in news.ports.items():
                self._stream(self._sources[name], news.time[keep], {key: rows[key][keep] for key in _LINES})
            self._stream(self._timing, news.time[keep], {"cycle_time": news.cycle_time[keep] * 1e6})
        self._status.text = _status(news)

    def _stream(self, source: Any, time: Any, columns: dict[str, Any]) -> None:
        shown = np.unique(np.concatenate([decimate(values, _BUCKETS) for values in columns.values()]))
        rows = {name: values[shown] for name, values in columns.items()}
        source.stream({"time": time[shown], **rows}, rollover=_POINTS)

    def _build(self, news: News) -> None:
        self._sources = {name: ColumnDataSource({key: [] for key in ("time", *_LINES)}) for name in news.ports}
        self._timing.data = {"time": [], "cycle_time": []}
        panels = []
        for name, source in self._sources.items():
            unit = news.units[name]
            if name not in news.groups:
                panels.append(self._panel(f"{name}: position", unit, source, {"position": BLUE}))
            torques = {"torque_command": ORANGE, "torque_applied": BLUE}
            panels.append(self._panel(f"{name}: torque", effort_unit(unit), source, torques))
            if name not in news.group_of:
                panels.append(self._energy(source))
        panels.append(self._panel("cycle time", "us", self._timing, {"cycle_time": GREY}))
        self._document.roots[0].children = [self._status, *panels]

    def _panel(self, title: str, unit: str, source: Any, lines: dict[str, str]) -> Any:
        panel = figure(x_range=self._time, height=170, tools="xpan,xwheel_zoom,reset", sizing_mode="stretch_width")
        panel.toolbar.logo = None
        panel.min_border_left = 80
        panel.yaxis.axis_label = f"{title} [{unit}]"
        for name, colour in lines.items():
            panel.line("time", name, source=source, color=colour, line_width=1.5, legend_label=_LABELS.get(name, name))
        tooltips = [(_LABELS.get(name, name), f"@{name} {unit}") for name in lines]
        panel.add_tools(HoverTool(mode="vline", tooltips=[("time", "@time{0.000} s"), *tooltips]))
        legend = panel.legend[0]
        legend.orientation, legend.location, legend.border_line_alpha = "horizontal", "right", 0.0
        legend.padding = legend.margin = 0
        panel.add_layout(legend, "above")
        return panel

    def _energy(self, source: Any) -> Any:
        panel = self._panel("energy", "J", source, {"taken_in": BLUE, "dissipated": VERMILION, "h_dis": ORANGE})
        panel.varea("time", "dissipated", "taken_in", source=source, fill_color=GREEN, fill_alpha=0.2)
        return panel


def _status(news: News) -> str:
    facts = [
        f"<b>{html.escape(news.status)}</b>",
        f"{news.rows} cycles",
        f"{news.time[-1]:.2f} s" if len(news.time) else "",
        f"link {100.0 * news.fresh_share:.4g} %",
    ]
    for name, rows in news.ports.items():
        if len(rows["margin"]) and name not in news.group_of:
            state = drive_state(int(rows["statusword"][-1])).value
            margin = si(float(rows["margin"][-1]), "J")
            facts.append(f"{html.escape(name)}: {state.lower()}, margin {margin}, surplus {si(rows['h_dis'][-1], 'J')}")
    events = [f"SYNC {e.sync_index} {e.kind} {e.port}: {e.text}" for e in news.events[-_EVENTS_SHOWN:]]
    lines = [" &nbsp; ".join(fact for fact in facts if fact), *map(html.escape, events)]
    return "<br>".join(lines)
