"""The page of `canhaptic scope`: the panels of a finished run's page, for the last seconds, as data arrive."""

import html
from collections.abc import Mapping
from typing import Final

import numpy as np
from bokeh.document import Document
from bokeh.layouts import column
from bokeh.models import ColumnDataSource, DataRange1d, Div, Range
from bokeh.plotting import figure

from canhaptic.logs.decoder import state_text
from canhaptic.logs.hdf5 import Array
from canhaptic.result import with_groups
from canhaptic.view.html_page import verdict_bar
from canhaptic.view.live_log import LiveLog, News
from canhaptic.view.port_panels import OPTIONAL, PortPanels, fault_columns, is_empty, link_panel, timing_panel
from canhaptic.view.series import FAULTS, decimate
from canhaptic.view.si import counted, si

_POINTS: Final = 6000  # kept per line
_BUCKETS: Final = 250  # per look; about twice as many rows
_LINES: Final = (
    "position", "command", "applied", "taken_in", "dissipated", "margin", "upper", "surplus", "deficit", "damping",
)  # fmt: skip
_EVENTS_SHOWN: Final = 4


class ScopePage:
    """One visitor's view of a log that is being written.

    Args:
        document: The visitor's Bokeh document.
        log: Log to follow; each visitor has its own.
        window: Seconds shown [s].
        period: Time between two looks [s].
    """

    def __init__(self, document: Document, log: LiveLog, window: float, period: float) -> None:
        self._document = document
        self._log = log
        self._window = window
        self._status = Div(text=f"waiting for {html.escape(str(log.path))} ...", name="status")
        self._time = DataRange1d(follow="end", follow_interval=window, range_padding=0.0)
        self._ports: dict[str, _LivePort] = {}
        self._timing: ColumnDataSource | None = None
        self._lost: ColumnDataSource | None = None
        self._common: dict[str, figure] = {}
        self._last: News | None = None  # look that found rows
        document.title = f"canhaptic scope: {log.path.name}"
        document.add_root(column(self._status, sizing_mode="stretch_width", name="root"))
        document.add_periodic_callback(self.update, max(50, round(1000 * period)))

    def update(self) -> None:
        """Add new data to the page."""
        news = self._log.look()
        if news is None:
            if self._log.trouble:
                self._status.text = f"waiting for {html.escape(str(self._log.path))}: {html.escape(self._log.trouble)}"
            return
        if news.restarted or not self._ports:
            self._last = None
            self._build(news)
        if len(news.time):
            self._last = news
            keep = news.time >= news.time[-1] - self._window
            for port in self._ports.values():
                port.take(news, keep)
            for source, panel, columns in (
                (self._timing, self._common["timing"], news.timing),
                (self._lost, self._common["lost"], news.lost),
            ):
                _stream(source, news.time[keep], {name: values[keep] for name, values in columns.items()})
                panel.visible = panel.visible or any(values.any() for values in columns.values())
        self._status.text = _status(news, self._last or news)

    def _build(self, news: News) -> None:
        groups_first = sorted(news.facts, key=lambda name: name not in news.groups)
        self._ports = {name: _LivePort(news, name, self._time, self._window) for name in groups_first}
        self._timing = ColumnDataSource({name: [] for name in ("time", *news.timing)})
        self._lost = ColumnDataSource({name: [] for name in ("time", *news.lost)})
        self._common = {
            "timing": timing_panel(self._time, self._timing, news.sample_time),
            "lost": link_panel(self._time, self._lost),
        }
        for panel in self._common.values():
            panel.visible = False
        panels = [panel for port in self._ports.values() for panel in port.panels.values()]
        self._document.roots[0].children = [self._status, *panels, *self._common.values()]


class _LivePort:
    """The panels of one port; those that show nothing but zeros are hidden until they show more."""

    def __init__(self, news: News, name: str, time: Range, window: float) -> None:
        self._window, self._sample_time = window, news.sample_time
        self._source = ColumnDataSource({key: [] for key in ("time", *_LINES)})
        self._contacts = ColumnDataSource({"start": [], "end": []})
        self._faults = ColumnDataSource({"at": [], "text": []})
        self._in_contact: list[tuple[float, float]] = []
        self._name = name
        self._is_shaded = not news.facts[name].is_member
        self.panels = PortPanels(news.facts[name], time, self._source, self._contacts, self._faults).panels
        for title, panel in self.panels.items():
            panel.visible = title not in OPTIONAL

    def take(self, news: News, keep: Array) -> None:
        """Take the new rows that `keep` says, their contacts, and all faults."""
        time, rows = news.time[keep], news.ports[self._name]
        columns = {key: rows[key][keep] for key in _LINES}
        faults = [e for e in news.events if e.event.kind in FAULTS and e.event.port in {"", self._name}]
        self._faults.data = fault_columns(faults)
        _stream(self._source, time, columns)
        for title, panel in self.panels.items():
            panel.visible = panel.visible or not is_empty(title, columns)
        if not self._is_shaded:
            return
        for start, end in news.contacts[self._name]:
            if self._in_contact and start - self._in_contact[-1][1] < 1.5 * self._sample_time:
                start = self._in_contact.pop()[0]  # the contact of the last look goes on
            self._in_contact.append((start, end))
        self._in_contact = [span for span in self._in_contact if span[1] >= time[-1] - self._window]
        self._contacts.data = {
            "start": [start for start, _ in self._in_contact],
            "end": [end for _, end in self._in_contact],
        }


def _stream(source: ColumnDataSource, time: Array, columns: Mapping[str, Array]) -> None:
    shown = np.unique(np.concatenate([decimate(values, _BUCKETS) for values in columns.values()]))
    source.stream({"time": time[shown]} | {name: values[shown] for name, values in columns.items()}, rollover=_POINTS)


def _status(news: News, last: News) -> str:
    """Return the current status of the log, with the values of the last look that found rows."""
    facts = [
        f"<b>{html.escape(news.status)}</b>",
        counted(news.rows, "cycle"),
        f"{last.time[-1]:.2f} s" if len(last.time) else "",
        f"TPDOs received {100.0 * news.fresh_share:.4g} %",
        *(f"{name} {last.lost[name][-1]}" for name in _COUNTED if len(last.time)),
    ]
    for name, rows in last.ports.items():
        if len(rows["margin"]) and name not in news.group_of:
            state = state_text(int(rows["statusword"][-1]))
            margin, surplus = si(float(rows["margin"][-1]), "J"), si(float(rows["surplus"][-1]), "J")
            facts.append(f"{html.escape(name)}: {state.lower()}, margin {margin}, surplus {surplus}")
    events = [f"SYNC {e.sync_index} {e.kind} {e.port}: {e.text}" for _, e in news.events[-_EVENTS_SHOWN:]]
    accounts = {name: account for name, account in news.accounts.items() if name not in news.group_of}
    bar, line = verdict_bar(with_groups(accounts, {})), " &nbsp; ".join(fact for fact in facts if fact)
    return "<br>".join([bar, line, *map(html.escape, events)])


_COUNTED: Final = ("SYNCs skipped", "cycles not in the log")
"""Losses that the status counts; for losses of the ports it gives the share."""
