"""Page of `canhaptic scope`, the last seconds of a run while its log is being written; and the panels of live pages.

The data of a page are in SI units. The browser chooses the prefix of an axis from its ticks, so that the prefix follows
zoom and new data.
"""

import html
from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from itertools import cycle
from pathlib import Path
from typing import Any, Final

import numpy as np
from bokeh.document import Document
from bokeh.layouts import column, row
from bokeh.models import (
    BoxAnnotation,
    ColumnDataSource,
    CustomJS,
    CustomJSHover,
    CustomJSTickFormatter,
    DataRange1d,
    Div,
    GlobalInlineStyleSheet,
    HoverTool,
    Model,
    Range,
    Slider,
    Span,
    Toggle,
)
from bokeh.plotting import figure
from bokeh.themes import Theme

from canhaptic.axis_units import counted, prefixes_of, si
from canhaptic.logs.decoder import state_text
from canhaptic.logs.hdf5 import Array
from canhaptic.quantities import ACCOUNT
from canhaptic.result import with_groups
from canhaptic.view.drawn_handle import MIDDLE, draw_links, five_bar, new_knob, new_plane, reach_of, shade_of
from canhaptic.view.html_page import STYLE, verdict_bar
from canhaptic.view.picture_style import ALARM, BLUE, GREEN, GREY, ORANGE, PURPLE, SKY
from canhaptic.view.scope_states import StatePanels
from canhaptic.view.series import FAULTS, LiveLog, News, Plane, PortFacts, decimate_together

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
    return panel


class LivePage:
    """Root of a live page, light or dark as the browser, with a button that pauses and a slider that goes back in time.

    Args:
        document: The visitor's Bokeh document.
        title: Title of the page.
        ranges: Time ranges of the panels.
        window: Length of the shown time [s].
    """

    def __init__(self, document: Document, title: str, ranges: Sequence[Range], window: float) -> None:
        self._document, document.title = document, title
        self._pause = Toggle(label="pause", name="pause")
        back = Slider(title="back [s]", start=0.0, end=2.0 * window, value=0.0, step=window / 100.0, name="back")
        words = {"ranges": list(ranges), "pause": self._pause, "back": back, "window": window}
        moved = CustomJS(args=words, code=_BACK)
        self._pause.js_on_change("active", moved)
        back.js_on_change("value", moved)
        self.time = row(self._pause, back, name="time")
        page, widgets = _LIVE.split("/* widgets */")
        document.theme = Theme(json={"attrs": {"Widget": {"stylesheets": [widgets]}}})
        sheet = GlobalInlineStyleSheet(css=STYLE + page)
        self._root = column(sizing_mode="stretch_width", name="root", stylesheets=[sheet])
        document.add_root(self._root)
        document.js_on_event("document_ready", CustomJS(code=_REPAINT))

    @property
    def is_paused(self) -> bool:
        """Whether the visitor looks at what was."""
        return bool(self._pause.active)

    def show(self, children: Sequence[Model]) -> None:
        """Replace the contents of the page."""
        self._root.children = list(children)


def si_ticks(unit: str) -> CustomJSTickFormatter:
    """Return a formatter for the ticks of an axis; the largest tick decides on the SI prefix of all."""
    return CustomJSTickFormatter(args={"prefixes": prefixes_of(unit), "unit": unit}, code=_TICKS)


_POINTS: Final = 6000  # kept per line
_BUCKETS: Final = 250  # per look; about twice as many rows
_LINES: Final = (
    "position", "command", "applied", "taken_in", "dissipated", "margin", "upper", "surplus", "deficit", "damping",
)  # fmt: skip
_EVENTS_SHOWN: Final = 4
_REQUESTED: Final = ACCOUNT["torque_command"].title


_Glyph = tuple[str, dict[str, Any]]
"""Bokeh glyph method and its arguments."""
_OPTIONAL: Final[dict[str, tuple[str, ...]]] = {
    "energy": ("taken_in", "dissipated"),
    "surplus": ("surplus", "deficit"),
    "damping": ("damping",),
}
"""Panel -> data columns; the panel is hidden while all of them are zero."""


def panel_of(
    time: Range,
    source: ColumnDataSource,
    title: str,
    unit: str,
    height: int,
    glyphs: Iterable[_Glyph],
    under_pointer: Mapping[str, str],
) -> figure:
    """Return a panel over time, with time and values at the pointer, which snaps to the line of the first of these.

    Args:
        time: Time range shared by all panels.
        source: Data source with a column `time` and the columns of the glyphs.
        title: Title.
        unit: SI unit of the values.
        height: Height [pixels].
        glyphs: Lines and areas.
        under_pointer: Label -> data column of each value shown at the pointer, with five digits and SI prefix.
    """
    panel = new_panel(title, unit, time, height)
    for kind, style in glyphs:
        getattr(panel, kind)(x="time", source=source, **style)
    main = next(iter(under_pointer.values()))
    shown = [(label, f"@{{{name}}}{{custom}}") for label, name in under_pointer.items()]
    value = CustomJSHover(args={"prefixes": prefixes_of(unit), "unit": unit}, code=_VALUE)
    panel.add_tools(HoverTool(
        renderers=[renderer for renderer in panel.renderers if renderer.name == main], mode="vline",
        tooltips=[("time", "@time{0.0000} s"), *shown], line_policy="nearest",
        formatters={f"@{{{name}}}": value for name in under_pointer.values()},
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


def _common_panel(title: str, unit: str, time: Range, source: ColumnDataSource, kind: str, **look: Any) -> figure:
    """Return a panel of the whole run: of every column of its source a line, or exact steps between its rows."""
    names, colours = [name for name in source.data if name != "time"], (BLUE, GREEN, ORANGE, PURPLE, SKY, GREY)
    labels = {name.replace("_", " "): name for name in names}
    lines = [line_of(name, label, of, 1.0, **look)[1] for (label, name), of in zip(labels.items(), cycle(colours))]
    return panel_of(time, source, title, unit, 140, [(kind, line) for line in lines], labels)


def _port_panels(facts: PortFacts, time: Range, source: ColumnDataSource) -> dict[str, figure]:
    """Return the panels of one port, top to bottom, in the colours of the picture of a finished run.

    A group has no position panel, an axis in a group no energy panel, and only an admittance display a velocity panel.
    Lines are straight, not steps, because the values between decimated rows are unknown.
    """
    units, panel, name, panels = facts.units, partial(panel_of, time, source), facts.name, dict[str, figure]()
    if facts.has_motion:
        lines = [line_of("position", "position", BLUE)]
        panels["position"] = panel(f"{name}: position", units["position"], 190, lines, {"position": "position"})
        for wall, side in facts.walls:
            _add_wall(panels["position"], wall, side)
        if facts.notches:
            look: dict[str, Any] = {"line_color": GREY, "line_dash": "dashed", "line_alpha": 0.6}
            panels["position"].hspan(y=facts.notches, legend_label="notch", name="notches", **look)
            panels["position"].y_range = DataRange1d(renderers=panels["position"].select({"name": "position"}))
    label, effort = "on the hand" if facts.is_display else "applied", units["applied"]
    lines, labels = [line_of("applied", label, BLUE, 1.2)], {label: "applied"}
    if facts.is_display:
        velocity = [line_of("command", "commanded", ORANGE)]
        panels["velocity"] = panel(f"{name}: velocity", units["command"], 190, velocity, {"commanded": "command"})
    else:
        lines.insert(0, line_of("command", _REQUESTED, ORANGE, 2.5, alpha=0.8))
        labels[_REQUESTED] = "command"
    panels["torque"] = panel(f"{name}: {'torque' if effort == 'N*m' else 'force'}", effort, 190, lines, labels)
    if facts.has_account:
        lines = [_known("surplus", "surplus"), _known("deficit", "deficit", 1.0, line_dash=[6, 3])]
        damping = [_known("damping", "damping_rendered", 1.2)]
        panels |= {
            "energy": panel(f"{name}: energy", "J", 240, _ENERGY, _ENERGY_LABELS),
            "surplus": panel(f"{name}: surplus", "J", 150, lines, {"surplus": "surplus", "deficit": "deficit"}),
            "damping": panel(f"{name}: damping", units["damping"], 130, damping, {"damping": "damping"}),
        }
    return panels


def _margin(name: str, label: str, base: str, colour: str) -> _Glyph:
    look = {"fill_color": colour, "fill_alpha": 0.22, "legend_label": label, "name": name}
    return "varea", {"y1": base, "y2": "upper", **look}


_ENERGY: Final = (
    _margin("margin", "margin", "dissipated", ACCOUNT["margin"].colour),
    _margin("negative margin", "margin below 0", "taken_in", GREY),
    _known("taken_in", "interaction"),
    _known("dissipated", "dissipated", line_dash=[6, 3]),
)
_ENERGY_LABELS: Final = {
    ACCOUNT["interaction"].title: "taken_in", ACCOUNT["dissipated"].title: "dissipated", "margin": "margin"
}  # fmt: skip


def _add_wall(panel: figure, wall: float, side: str) -> None:
    panel.hspan(y=[wall], line_color=MIDDLE, line_dash="dashed", legend_label="wall", name="wall")
    edge = {"top" if side == "below" else "bottom": wall}
    panel.add_layout(BoxAnnotation(**edge, fill_color=MIDDLE, fill_alpha=0.2, line_alpha=0.0, level="underlay"))


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
        self._status = Div(text=f"waiting for {html.escape(str(log.path))} ...", name="status")
        self._time = DataRange1d(follow="end", follow_interval=window, range_padding=0.02)
        self._ports: dict[str, _LivePort] = {}
        self._common: dict[str, tuple[ColumnDataSource, figure]] = {}
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
                _stream(source, news.time[keep], {key: values[keep] for key, values in columns.items()})
                panel.visible = panel.visible or any(values.any() for values in columns.values())
        self._status.text = _status(news, self._last or news)

    def _build(self, news: News) -> None:
        groups_first = sorted(news.facts, key=lambda name: news.facts[name].has_motion)
        self._ports = {name: _LivePort(news, name, self._time, self._window) for name in groups_first}
        timing, lost = (ColumnDataSource({name: [] for name in ("time", *of)}) for of in (news.timing, news.lost))
        self._common = {
            "timing": (timing, _common_panel("timing", "s", self._time, timing, "line")),
            "lost": (lost, _common_panel("lost", "", self._time, lost, "step", mode="after")),
        }
        due = Span(location=news.sample_time, dimension="width", line_color=GREY, line_dash="dashed")
        self._common["timing"][1].add_layout(due)
        self._common["lost"][1].y_range = DataRange1d(start=-0.05, min_interval=1.0)
        common = [panel for _, panel in self._common.values()]
        for panel in common:
            panel.visible = False
        panels = [panel for port in self._ports.values() for panel in port.layout]
        self._page.show([self._status, self._page.time, *panels, *common])


class _LivePort:
    """Panels of one port; a panel is hidden as long as all its values are zero."""

    def __init__(self, news: News, name: str, time: Range, window: float) -> None:
        self._window, self._sample_time = window, news.sample_time
        self._source = ColumnDataSource({key: [] for key in ("time", *_LINES)})
        self._contacts = ColumnDataSource({"start": [], "end": []})
        self._faults = ColumnDataSource({"at": [], "text": []})
        self._in_contact: list[tuple[float, float]] = []
        self._name = name
        self._is_shaded = news.facts[name].has_account
        self.panels = _port_panels(news.facts[name], time, self._source)
        self._states = _states(news, name, time)
        over_time = list(self.panels.items())
        self.panels |= self._states.panels if self._states else {}
        self._handle = _LiveHandle(news.facts[name], self.panels.get("position"))
        beside = {"position": self._handle.drawing}
        self.layout = [
            row(panel, drawing, sizing_mode="stretch_width") if (drawing := beside.get(title)) else panel
            for title, panel in self.panels.items()
        ]
        if self._handle.drawing is not None and "position" not in self.panels:
            self.layout.insert(0, self._handle.drawing)
        for kind, panel in over_time:
            panel.visible = kind not in _OPTIONAL
            strip = panel.vstrip(
                x0="start", x1="end", source=self._contacts, fill_color=GREY, fill_alpha=0.07, line_alpha=0
            )
            strip.level, strip.name = "underlay", "contacts"
            mark = panel.vspan(x="at", source=self._faults, line_color=ALARM, line_width=1.5, line_dash="dotted")
            panel.add_tools(HoverTool(renderers=[mark], tooltips=[("", "@text"), ("at", "@at{0.0000} s")]))

    def take(self, news: News, keep: Array) -> None:
        """Draw the new rows selected by `keep`, their contacts, and all faults."""
        time, rows = news.time[keep], news.ports[self._name]
        columns = {key: rows[key][keep] for key in _LINES}
        faults = [e for e in news.events if e.event.kind in FAULTS and e.event.port in {"", self._name}]
        self._faults.data = {
            "at": [fault.time for fault in faults],
            "text": [f"{fault.event.kind}: {fault.event.text}" for fault in faults],
        }
        _stream(self._source, time, columns)
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
        self._contacts.data = {
            "start": [start for start, _ in self._in_contact],
            "end": [end for _, end in self._in_contact],
        }


class _LiveHandle:
    """The handle of a port as it was last: at the end of its line, as a knob, or in its plane with links and surfaces.

    Args:
        facts: Constants of the port.
        position: Panel of its position; None of a group.
    """

    def __init__(self, facts: PortFacts, position: figure | None) -> None:
        self._facts, self._looks = facts, 0
        self._source = ColumnDataSource({"x": [], "y": [], "link_x": [], "link_y": []}, name=f"{facts.name}: handle")
        self._trace, self._material = (
            ColumnDataSource({"x": [], "y": []}),
            ColumnDataSource({key: [] for key in _IMAGE}),
        )
        self.drawing: figure | None = None
        if facts.plane is not None:
            self.drawing = self._new_plane(facts.plane)
        elif position is not None and facts.units["position"] == "rad":
            ends = [(wall, wall + 0.5) if side == "above" else (wall - 0.5, wall) for wall, side in facts.walls]
            near = [notch for notch in facts.notches if abs(notch) <= np.pi]
            self.drawing = new_knob(self._source, BLUE, f"{facts.name}: knob", ends, near, 150)
        elif position is not None:
            position.scatter("y", "x", source=self._source, size=16, fill_color=BLUE, line_color="white")

    def _new_plane(self, plane: Plane) -> figure:
        look: Any = {"height": 260, "sizing_mode": "stretch_width", "min_border_left": 90, "min_border_right": 40}
        drawing = new_plane((-1.0, 1.0), (-1.0, 1.0), f"{self._facts.name}: plane", equal=True, **look)
        drawing.xaxis.formatter = drawing.yaxis.formatter = si_ticks(plane.unit)
        drawing.image_rgba(**{name: name for name in _IMAGE}, source=self._material)
        draw_links(drawing, self._source, plane.links)
        drawing.line("x", "y", source=self._trace, line_color=BLUE, line_width=1.0)
        drawing.scatter("x", "y", source=self._source, size=16, fill_color=BLUE, line_color="white")
        return drawing

    def take(self, news: News, keep: Array) -> None:
        """Draw the handle at the last row, and what it touches around its latest path."""
        plane = self._facts.plane
        if plane is None:
            place = news.ports[self._facts.name]["position"][-1:]
            self._source.data = {"x": place, "y": news.time[-1:]} | five_bar((), (), ())
            return
        motors = np.array([news.ports[axis]["position"][keep] for axis in plane.axes])
        path = plane.path(motors[:, decimate_together(motors, 50)])
        path = path[np.isfinite(path).all(axis=1)]
        if not len(path):
            return
        self._source.data = {"x": path[-1:, 0], "y": path[-1:, 1]} | five_bar(
            plane.links, motors[:, -1].tolist(), path[-1].tolist()
        )
        self._trace.stream({"x": path[:, 0], "y": path[:, 1]}, rollover=500)
        self._looks += 1
        if self._looks % _LOOKS_A_PLANE == 1:
            self._draw(plane)

    def _draw(self, plane: Plane) -> None:
        drawn = plane.drawn(np.column_stack([self._trace.data[axis] for axis in "xy"]))
        if drawn is None or self.drawing is None:
            return
        parts = ((drawn.depth, drawn.surface), *drawn.further)
        inside = np.any([depth <= at if at else depth > at for depth, at in parts], axis=0)  # a line has no inside
        spans = [(float(of[0]), float(of[-1])) for of in (drawn.across, drawn.along)]
        (left, right), (low, high) = spans
        image = (left, low, right - left, high - low, shade_of(inside))
        self._material.data = {name: [value] for name, value in zip(_IMAGE, image, strict=True)}
        self.drawing.tags = list(reach_of(plane.links, *spans))


_IMAGE: Final = ("x", "y", "dw", "dh", "image")
_LOOKS_A_PLANE: Final = 25
"""Looks between two drawings of what a handle may touch in its plane."""


def _states(news: News, name: str, time: Range) -> StatePanels | None:
    """Return lane and spectrum of an axis; None of a group, which has no torque of its own."""
    facts = news.facts[name]
    if not facts.has_motion:
        return None
    unit = facts.units["applied"]
    panel = new_panel(f"{name}: spectrum", unit, DataRange1d(range_padding=0.0), 150)
    panel.xaxis.formatter = si_ticks("Hz")
    return StatePanels(name, facts.torque_limit, unit, time, news.sample_time, panel)


def _stream(source: ColumnDataSource, time: Array, columns: Mapping[str, Array]) -> None:
    shown = decimate_together(columns.values(), _BUCKETS)
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
