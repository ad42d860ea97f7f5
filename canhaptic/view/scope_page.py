"""Page of `canhaptic scope`, the last seconds of a run while its log is being written; and the panels of live pages.

The data of a page are in SI units. The browser chooses the prefix of an axis from its ticks, so that the prefix follows
zoom and new data.
"""

import html
from collections.abc import Iterable, Mapping, Sequence
from itertools import cycle
from pathlib import Path
from typing import Any, Final

import numpy as np
from bokeh import models
from bokeh.document import Document
from bokeh.layouts import column, row
from bokeh.plotting import figure
from bokeh.themes import Theme

from canhaptic.axis_units import counted, prefixes_of, si
from canhaptic.logs.decoder import state_text
from canhaptic.logs.hdf5 import Array
from canhaptic.quantities import ACCOUNT
from canhaptic.result import with_groups
from canhaptic.view.drawn_handle import (
    MIDDLE,
    SI_VALUE,
    WIDE,
    five_bar,
    new_knob,
    new_plane,
    reach_of,
    shade_of,
    si_ticks,
)
from canhaptic.view.html_page import STYLE, verdict_bar
from canhaptic.view.picture_style import ALARM, BLUE, GREEN, GREY, ORANGE, PURPLE, SKY
from canhaptic.view.scope_states import StatePanels
from canhaptic.view.series import FAULTS, LiveLog, News, Plane, PortFacts, decimate_together

_TOOLS: Final = "xpan,xwheel_zoom,xbox_zoom,reset,save"
_LIVE: Final = Path(__file__).with_suffix(".css").read_text(encoding="utf-8")
_REPAINT: Final = """
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
  for (const model of cb_obj._all_models.values()) if (model.type == "Figure") model.change.emit();
});
"""
_BACK: Final = """
if (cb_obj === back && back.value > 0) pause.active = true;
if (cb_obj === pause && !pause.active) back.value = 0;
for (const range of ranges) {
  if (pause.active) {
    if (!range.tags.length) range.tags = [range.end];
    const end = range.tags[0] - back.value;
    range.have_updated_interactively = true;  // rows that are still on their way move nothing
    range.setv({follow: null, end, start: end - window});
  } else if (range.tags.length) {
    range.tags = [];
    range.reset();
  }
}
"""


def _new_panel(title: str, unit: str, time: models.Range, height: int) -> figure:
    panel = figure(
        x_range=time, height=height, tools=_TOOLS, active_drag="xbox_zoom", active_scroll="xwheel_zoom", name=title,
        output_backend="canvas", window_axis="x", **WIDE,
    )  # fmt: skip
    panel.yaxis.axis_label = title
    panel.xaxis.formatter, panel.yaxis.formatter = si_ticks("s"), si_ticks(unit)
    panel.toolbar.logo = None
    return panel


class LivePage:
    """Root of a live page, light or dark as the browser, with a button that pauses and a slider that goes back in time.

    Args:
        document: The visitor's Bokeh document.
        title: Title of the page.
        ranges: Time ranges of the panels.
        window: Length of the shown time [s].
    """

    def __init__(self, document: Document, title: str, ranges: Sequence[models.Range], window: float) -> None:
        self._document, document.title = document, title
        self._pause = models.Toggle(label="pause", name="pause")
        back = models.Slider(title="back [s]", start=0.0, end=2.0 * window, value=0.0, step=window / 100.0, name="back")
        words = {"ranges": list(ranges), "pause": self._pause, "back": back, "window": window}
        moved = models.CustomJS(args=words, code=_BACK)
        self._pause.js_on_change("active", moved)
        back.js_on_change("value", moved)
        self.time = row(self._pause, back, name="time")
        page, widgets = _LIVE.split("/* widgets */")
        document.theme = Theme(json={"attrs": {"Widget": {"stylesheets": [widgets]}}})
        sheet = models.GlobalInlineStyleSheet(css=STYLE + page)
        self._root = column(sizing_mode="stretch_width", name="root", stylesheets=[sheet])
        document.add_root(self._root)
        document.js_on_event("document_ready", models.CustomJS(code=_REPAINT))

    @property
    def is_paused(self) -> bool:
        """Whether the visitor looks at what was."""
        return bool(self._pause.active)

    def show(self, children: Sequence[models.Model]) -> None:
        """Replace the contents of the page."""
        self._root.children = list(children)


_POINTS: Final = 6000  # kept per line
_BUCKETS: Final = 250  # per look; about twice as many rows
_LINES: Final = (
    "position", "command", "applied", "taken_in", "dissipated", "margin", "upper", "surplus", "deficit", "damping",
)  # fmt: skip
_EVENTS_SHOWN: Final = 4


_Glyph = tuple[str, dict[str, Any]]
"""Bokeh glyph method and its arguments."""
_OPTIONAL: Final[dict[str, tuple[str, ...]]] = {
    "energy": ("taken_in", "dissipated"),
    "surplus": ("surplus", "deficit"),
    "damping": ("damping",),
}
"""Panel -> data columns; the panel is hidden while all of them are zero."""


def panel_of(
    time: models.Range, source: models.ColumnDataSource, title: str, unit: str, height: int, glyphs: Iterable[_Glyph]
) -> figure:
    """Return a panel over time, with time and values at the pointer, with five digits and SI prefix.

    Args:
        time: Time range shared by all panels.
        source: Data source with a column `time` and the columns of the glyphs.
        title: Title.
        unit: SI unit of the values.
        height: Height [pixels].
        glyphs: Lines and areas, named by their data column; the pointer snaps to the last one.
    """
    panel, values = _new_panel(title, unit, time, height), {}
    for kind, style in glyphs:
        drawn = getattr(panel, kind)(x="time", source=source, **style)
        if drawn.name in source.data:
            values[style["legend_label"]] = f"@{{{drawn.name}}}"
    value = models.CustomJSHover(args={"prefixes": prefixes_of(unit), "unit": unit}, code=SI_VALUE)
    panel.add_tools(models.HoverTool(
        renderers=[drawn], mode="vline", line_policy="nearest", formatters=dict.fromkeys(values.values(), value),
        tooltips=[("time", "@time{0.0000} s"), *((label, f"{place}{{custom}}") for label, place in values.items())],
    ))  # fmt: skip
    legend = panel.legend[0]
    legend.update(
        orientation="horizontal", location="right", click_policy="hide", background_fill_alpha=0.0,
        border_line_alpha=0.0, label_text_color=MIDDLE, label_text_font_size="9pt", padding=0, margin=0, spacing=16,
    )  # fmt: skip
    panel.add_layout(legend, "above")  # where it cannot hide data
    return panel


def line_of(column: str, label: str, colour: str, width: float = 1.5, **style: Any) -> _Glyph:
    """Return the line of a data column, with its legend, for `panel_of`."""
    return "line", {
        "y": column, "name": column, "legend_label": label, "color": colour, "line_width": width, **style
    }  # fmt: skip


def _known(column: str, name: str, width: float = 1.5, **style: Any) -> _Glyph:
    """Return the line of a quantity, with its title and colour."""
    return line_of(column, ACCOUNT[name].title, ACCOUNT[name].colour, width, **style)


def _common_panel(
    title: str, unit: str, time: models.Range, names: Iterable[str], kind: str = "line", **look: Any
) -> tuple[models.ColumnDataSource, figure]:
    """Return a hidden panel of the whole run, with its source: of every column a line, or exact steps between rows."""
    source = models.ColumnDataSource({name: [] for name in ("time", *names)})
    lines = [
        (kind, line_of(name, name.replace("_", " "), colour, 1.0, **look)[1])
        for name, colour in zip(names, cycle((BLUE, GREEN, ORANGE, PURPLE, SKY, GREY)))
    ]
    panel = panel_of(time, source, title, unit, 140, lines)
    panel.visible = False
    return source, panel


def _port_panels(facts: PortFacts, time: models.Range, source: models.ColumnDataSource) -> dict[str, figure]:
    """Return the panels of one port, top to bottom, in the colours of the picture of a finished run.

    A group has no position panel, an axis in a group no energy panel, and only an admittance display a velocity panel.
    Lines are straight, not steps, because the values between decimated rows are unknown.
    """
    units, (of_command, name) = facts.units, facts.drawn
    panels: dict[str, tuple[str, int, Sequence[_Glyph]]] = {}  # unit, height and glyphs
    if facts.has_motion:
        panels["position"] = units["position"], 190, [line_of("position", "position", BLUE)]
    if of_command == "velocity":
        panels["velocity"] = units["command"], 190, [line_of("command", "commanded", ORANGE)]
    requested = [line_of("command", ACCOUNT["torque_command"].title, ORANGE, 2.5, alpha=0.8)] * (of_command == "torque")
    applied = line_of("applied", name, BLUE, 1.2)
    panels["torque" if units["applied"] == "N*m" else "force"] = units["applied"], 190, [*requested, applied]
    if facts.has_account:
        deficit = _known("deficit", "deficit", 1.0, line_dash=[6, 3])
        panels["energy"] = "J", 240, _ENERGY
        panels["surplus"] = "J", 150, [_known("surplus", "surplus"), deficit]
        panels["damping"] = units["damping"], 130, [_known("damping", "damping_rendered", 1.2)]
    made = {kind: panel_of(time, source, f"{facts.name}: {kind}", *panel) for kind, panel in panels.items()}
    if facts.has_motion:
        _add_surfaces(made["position"], facts)
    return made


def _margin(name: str, label: str, base: str, colour: str) -> _Glyph:
    look = {"fill_color": colour, "fill_alpha": 0.22, "legend_label": label, "name": name}
    return "varea", {"y1": base, "y2": "upper", **look}


_ENERGY: Final = (
    _margin("margin", "margin", "dissipated", ACCOUNT["margin"].colour),
    _margin("negative margin", "margin below 0", "taken_in", GREY),
    _known("taken_in", "interaction"),
    _known("dissipated", "dissipated", line_dash=[6, 3]),
)


def _add_surfaces(panel: figure, facts: PortFacts) -> None:
    for wall, side in facts.walls:
        panel.hspan(y=[wall], line_color=MIDDLE, line_dash="dashed", legend_label="wall", name="wall")
        edge = {"top" if side == "below" else "bottom": wall}
        panel.add_layout(
            models.BoxAnnotation(**edge, fill_color=MIDDLE, fill_alpha=0.2, line_alpha=0.0, level="underlay")
        )
    if facts.notches:
        look: dict[str, Any] = {"line_color": GREY, "line_dash": "dashed", "line_alpha": 0.6}
        panel.hspan(y=facts.notches, legend_label="notch", name="notches", **look)
        panel.y_range = models.DataRange1d(renderers=panel.select({"name": "position"}))


class ScopePage:
    """Page of one visitor on a log that is being written.

    Args:
        document: The visitor's Bokeh document.
        log: Reader of the log; each visitor needs a separate one.
        window: Length of the shown time [s].
        period: Time between two polls of the log [s].
    """

    def __init__(self, document: Document, log: LiveLog, window: float, period: float) -> None:
        self._log = log
        self._window = window
        self._status = models.Div(text=f"waiting for {html.escape(str(log.path))} ...", name="status")
        self._time = models.DataRange1d(follow="end", follow_interval=window, range_padding=0.02)
        self._ports: dict[str, _LivePort] = {}
        self._common: dict[str, tuple[models.ColumnDataSource, figure]] = {}
        self._last: News | None = None  # look that found rows
        self._page = LivePage(document, f"canhaptic scope: {log.path.name}", [self._time], window)
        self._page.show([self._status])
        document.add_periodic_callback(self.update, max(50, round(1000 * period)))

    def update(self) -> None:
        """Add new data to the page."""
        news = None if self._page.is_paused else self._log.look()
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
            for name, columns in (("timing", news.timing), ("lost", news.lost)):
                source, panel = self._common[name]
                stream(source, news.time[keep], {key: values[keep] for key, values in columns.items()})
                panel.visible = panel.visible or any(values.any() for values in columns.values())
        self._status.text = _status(news, self._last or news)

    def _build(self, news: News) -> None:
        groups_first = sorted(news.facts, key=lambda name: news.facts[name].has_motion)
        self._ports = {name: _LivePort(news, name, self._time, self._window) for name in groups_first}
        timing = _common_panel("timing", "s", self._time, news.timing)
        lost = _common_panel("lost", "", self._time, news.lost, "step", mode="after")
        due = models.Span(location=news.sample_time, dimension="width", line_color=GREY, line_dash="dashed")
        timing[1].add_layout(due)
        lost[1].y_range = models.DataRange1d(start=-0.05, min_interval=1.0)
        self._common = {"timing": timing, "lost": lost}
        panels = [panel for port in self._ports.values() for panel in port.layout]
        self._page.show([self._status, self._page.time, *panels, timing[1], lost[1]])


class _LivePort:
    """Panels of one port; a panel is hidden as long as all its values are zero."""

    def __init__(self, news: News, name: str, time: models.Range, window: float) -> None:
        self._window, self._sample_time = window, news.sample_time
        self._source = models.ColumnDataSource({key: [] for key in ("time", *_LINES)})
        self._contacts = models.ColumnDataSource({"start": [], "end": []})
        self._faults = models.ColumnDataSource({"at": [], "text": []})
        self._in_contact: list[tuple[float, float]] = []
        self._name = name
        facts = news.facts[name]
        self._is_shaded = facts.has_account
        self.panels = _port_panels(facts, time, self._source)
        self._states = _states(news, name, time)
        over_time = list(self.panels.items())
        self.panels |= self._states.panels if self._states else {}
        self._handle = _LiveHandle(facts, self.panels.get("position"))
        self.layout: list[Any] = list(self.panels.values())
        if self._handle.drawing is not None:
            beside = self.layout[: facts.has_motion]  # the panel of the position
            self.layout[: len(beside)] = [row(*beside, self._handle.drawing, sizing_mode="stretch_width")]
        for kind, panel in over_time:
            panel.visible = kind not in _OPTIONAL
            look: Any = {"fill_color": GREY, "fill_alpha": 0.07, "line_alpha": 0, "level": "underlay"}
            panel.vstrip(x0="start", x1="end", source=self._contacts, name="contacts", **look)
            mark = panel.vspan(x="at", source=self._faults, line_color=ALARM, line_width=1.5, line_dash="dotted")
            panel.add_tools(models.HoverTool(renderers=[mark], tooltips=[("", "@text"), ("at", "@at{0.0000} s")]))

    def take(self, news: News, keep: Array) -> None:
        """Draw the new rows selected by `keep`, their contacts, and all faults."""
        time, rows = news.time[keep], news.ports[self._name]
        columns = {key: rows[key][keep] for key in _LINES}
        faults = [(at, of) for at, of in news.events if of.kind in FAULTS and of.port in {"", self._name}]
        self._faults.data = {"at": [at for at, _ in faults], "text": [f"{of.kind}: {of.text}" for _, of in faults]}
        stream(self._source, time, columns)
        self._handle.take(news, keep)
        for title, panel in self.panels.items():
            panel.visible = panel.visible or any(columns[name].any() for name in _OPTIONAL.get(title, ()))
        if self._states is not None:
            self._states.take(news, rows, self._window)
        if not self._is_shaded:
            return
        for start, end in news.contacts[self._name]:
            if self._in_contact and start - self._in_contact[-1][1] < 1.5 * self._sample_time:
                start = self._in_contact.pop()[0]  # the contact of the last look goes on
            self._in_contact.append((start, end))
        self._in_contact = [span for span in self._in_contact if span[1] >= time[-1] - self._window]
        self._contacts.data = {key: [span[at] for span in self._in_contact] for at, key in enumerate(("start", "end"))}


class _LiveHandle:
    """The handle of a port as it was last: at the end of its line, as a knob, or in its plane with links and surfaces.

    Args:
        facts: Constants of the port.
        position: Panel of its position; None of a group.
    """

    def __init__(self, facts: PortFacts, position: figure | None) -> None:
        self._facts = facts
        self._source = models.ColumnDataSource(
            {"x": [], "y": [], "link_x": [], "link_y": []}, name=f"{facts.name}: handle"
        )
        self._trace, self._material = (
            models.ColumnDataSource({name: [] for name in names}) for names in ("xy", _IMAGE)
        )
        self._spans = [(0.0, 0.0), (0.0, 0.0)]  # in both directions, of what is drawn
        self.drawing: figure | None = None
        if (plane := facts.plane) is not None:
            look: Any = {"height": 260, "name": f"{facts.name}: plane", "unit": plane.unit}
            self.drawing = new_plane(self._source, BLUE, (-1.0, 1.0), (-1.0, 1.0), plane.links, **look)
            self.drawing.image_rgba(**{name: name for name in _IMAGE}, source=self._material, level="underlay")
            self.drawing.line("x", "y", source=self._trace, line_color=BLUE, level="underlay")
        elif position is not None and facts.units["position"] == "rad":
            ends = [(wall, wall + 0.5) if side == "above" else (wall - 0.5, wall) for wall, side in facts.walls]
            near = [notch for notch in facts.notches if abs(notch) <= np.pi]
            self.drawing = new_knob(self._source, BLUE, f"{facts.name}: knob", ends, near, 150)
        elif position is not None:
            position.scatter("y", "x", source=self._source, size=16, fill_color=BLUE, line_color="white")

    def take(self, news: News, keep: Array) -> None:
        """Draw the handle at the last row, and what it touches around its latest path."""
        plane = self._facts.plane
        if plane is None:
            place = news.ports[self._facts.name]["position"][-1:]
            self._source.data = {"x": place, "y": news.time[-1:]} | five_bar()
            return
        motors = np.array([news.ports[axis]["position"][keep] for axis in plane.axes])
        path = plane.path(motors[:, decimate_together(motors, 50)])
        path = path[np.isfinite(path).all(axis=1)]
        if not len(path):
            return
        links = five_bar(plane.links, motors[:, -1].tolist(), path[-1].tolist())
        self._source.data = {"x": path[-1:, 0], "y": path[-1:, 1]} | links
        self._trace.stream({"x": path[:, 0], "y": path[:, 1]}, rollover=500)
        low, high = np.transpose(self._spans)
        if (path <= low).any() or (path >= high).any():  # beyond what is drawn
            self._draw(plane)

    def _draw(self, plane: Plane) -> None:
        path = np.column_stack([self._trace.data[axis] for axis in "xy"])
        room = 1e-3 + 0.2 * float(np.ptp(path, axis=0).max())
        spans: Any = [(float(of.min()) - room, float(of.max()) + room) for of in path.T]
        if (drawn := plane.drawn(path)) is not None:
            spans = across, along = drawn.across, drawn.along
            parts = ((drawn.depth, drawn.surface), *drawn.further)
            inside = np.any([depth <= at if at else depth > at for depth, at in parts], axis=0)  # a line has no inside
            image = (across[0], along[0], across[-1] - across[0], along[-1] - along[0], shade_of(inside))
            self._material.data = {name: [value] for name, value in zip(_IMAGE, image, strict=True)}
        self._spans = [(float(span[0]), float(span[-1])) for span in spans]
        if self.drawing is not None:
            self.drawing.tags = list(reach_of(plane.links, *self._spans))


_IMAGE: Final = ("x", "y", "dw", "dh", "image")


def _states(news: News, name: str, time: models.Range) -> StatePanels | None:
    """Return lane and spectrum of an axis; None of a group, which has no torque of its own."""
    facts = news.facts[name]
    if not facts.has_motion:
        return None
    unit = facts.units["applied"]
    panel = _new_panel(f"{name}: spectrum", unit, models.DataRange1d(range_padding=0.0), 150)
    panel.xaxis.formatter = si_ticks("Hz")
    return StatePanels(name, facts.torque_limit, unit, time, news.sample_time, panel)


def stream(source: models.ColumnDataSource, time: Array, columns: Mapping[str, Array], buckets: int = _BUCKETS) -> None:
    """Draw new rows of columns over time, of each bucket of rows the extremes; old rows go."""
    shown = decimate_together(columns.values(), buckets)
    source.stream({"time": time[shown]} | {name: values[shown] for name, values in columns.items()}, rollover=_POINTS)


def _status(news: News, last: News) -> str:
    """Return the status of the log as HTML, with the values of the last poll that found rows."""
    facts = [
        f"<b>{html.escape(news.status)}</b>",
        counted(news.rows, "cycle"),
        f"{last.time[-1]:.2f} s" if len(last.time) else "",
        f"TPDOs received {100.0 * news.fresh_share:.4g} %",
        *(f"{name} {last.lost[name][-1]}" for name in _COUNTED if len(last.time)),
    ]
    for name, rows in ((name, last.ports[name]) for name in news.accounts if name in last.ports):
        if len(rows["margin"]):
            state = state_text(int(rows["statusword"][-1]))
            margin, surplus = si(float(rows["margin"][-1]), "J"), si(float(rows["surplus"][-1]), "J")
            facts.append(f"{html.escape(name)}: {state.lower()}, margin {margin}, surplus {surplus}")
    events = [f"SYNC {e.sync_index} {e.kind} {e.port}: {e.text}" for _, e in news.events[-_EVENTS_SHOWN:]]
    bar, line = verdict_bar(with_groups(news.accounts, {})), " &nbsp; ".join(fact for fact in facts if fact)
    return "<br>".join([bar, line, *map(html.escape, events)])


_COUNTED: Final = ("SYNCs skipped", "cycles not in the log")
"""Losses that the status shows as counts; losses of TPDOs are shown as a share."""
