"""Page of `canhaptic touch`: two handles held by one pointer, their force, energy and verdict, and sliders."""

import html
from collections.abc import Callable
from contextlib import suppress
from typing import Any, Final

import numpy as np
from bokeh import models
from bokeh.document import Document
from bokeh.events import Pan, PanStart
from bokeh.layouts import column, row
from bokeh.plotting import figure

from canhaptic.axis_units import effort_unit, si
from canhaptic.control.verdict import PASSIVE_TOLERANCE, passive_verdict
from canhaptic.errors import CanHapticError
from canhaptic.files import scene_title
from canhaptic.lab.loop.axis_loop import Array
from canhaptic.lab.touch.hand_process import TouchHand, TouchNews, TouchStatus
from canhaptic.lab.touch.two_sides import TouchSlider
from canhaptic.view.drawn_handle import MATERIAL, MIDDLE, five_bar, new_knob, new_plane
from canhaptic.view.html_page import verdict_bar
from canhaptic.view.picture_style import BLUE, GREY, PALE, VERMILION
from canhaptic.view.scope_page import LivePage, line_of, panel_of, stream

_COLOURS: Final = (VERMILION, BLUE)
_SHOWN: Final = 3.0  # [s]
_OF_LINKS: Final = ("angle", "position")
_DELAYS: Final = {"event": "no delay", "synchronous": "one sample late"}
_SEND: Final = """
pointer.data = {x: [cb_obj.x], y: [cb_obj.y], token: [performance.now()]};
"""
_MEASURE: Final = """
const {token: [token], frame: [frame]} = cb_obj.data;
requestAnimationFrame(() => { drawn.data = {frame: [frame]}; });
if (token > 0 && token != window.last_token) {
  window.last_token = token;
  (window.answers ??= []).push(performance.now() - token);
  if (window.answers.length > 20000) window.answers.shift();
}
"""


class TouchPage:
    """Page of one visitor; a later visitor takes the hand over.

    Args:
        document: The visitor's Bokeh document.
        hand: Hand that holds both handles.
        period: Time between two updates [s].
    """

    def __init__(self, document: Document, hand: TouchHand, period: float) -> None:
        self._hand, self._document = hand, document
        touched = hand.touched
        self._pointer = models.ColumnDataSource({"x": [0.0], "y": [0.0], "token": [0.0]}, name="pointer")
        self._pointer.on_change("data", self._take_pointer)
        self._status = models.Div(text="the drives start ...", name="status", sizing_mode="stretch_width")
        self._sides = [_SideView(hand, number, self._pointer) for number in range(2)]
        self._drawn = models.ColumnDataSource({"frame": [0]}, name="drawn")
        self._sides[-1].handle.js_on_change("data", models.CustomJS(args={"drawn": self._drawn}, code=_MEASURE))
        self._frame = self._waited = 0
        for mine, other in zip(self._sides[0].panels, self._sides[1].panels, strict=True):  # one scale, to compare them
            other.y_range = mine.y_range
            mine.y_range.renderers = [*mine.renderers, *other.renderers]
        self._controls = _Controls(hand, self._begin)
        ranges = [panel.x_range for side in self._sides for panel in side.panels]
        self._page = LivePage(document, f"canhaptic touch: {scene_title(touched.scene.source)}", ranges, _SHOWN)
        sides = row(*(side.layout for side in self._sides), sizing_mode="stretch_width")
        room = "square" if touched.is_plane else "strip"
        hint = models.Div(text=f"Drag in a {room}: the pointer is the hand on both handles.")
        self._page.show([hint, self._controls.layout, sides, self._page.time, self._status])
        self._looking = document.add_periodic_callback(self.update, max(20, round(1000 * period)))

    def end(self, text: str) -> None:
        """Stop the updates, and show the reason."""
        with suppress(ValueError, AttributeError):  # the visitor has left: Bokeh took the document apart
            self._document.remove_periodic_callback(self._looking)
            self._document.add_next_tick_callback(lambda: setattr(self._status, "text", html.escape(text)))

    def update(self) -> None:
        """Draw new rows after the browser has drawn the last ones, so that a slow browser does not fall behind."""
        if self._page.is_paused:
            return
        self._waited += 1
        if self._drawn.data["frame"][0] != self._frame and self._waited < 60:  # after which the page is asked again
            return
        news = self._hand.look()
        if len(news.rows["time"]):
            self._frame, self._waited = self._frame + 1, 0
            for side in self._sides:
                side.take(news, self._frame)
        if news.status is not None:
            for side in self._sides if news.status.cycles else ():
                side.judge(news.status)
            self._status.text = _status(news.status, self._hand.touched.scene.bus.rate)

    def _take_pointer(self, _name: str, _old: object, new: dict[str, list[float]]) -> None:
        self._hand.move((new["x"][0], new["y"][0])[: len(self._hand.touched.shown)], new["token"][0])

    def _begin(self, changes: dict[str, str]) -> None:
        """Restart the run with the values of the controls."""
        try:
            self._hand.begin(changes)
        except CanHapticError as error:
            self._status.text = f"<b>refused, the run continues unchanged:</b> {html.escape(str(error))}"
            return
        for side in self._sides:
            side.clear()
            side.draw_notches(float(next((of for key, of in changes.items() if key.endswith(".pitch")), 0.0)))
        self._status.text = "the drives start ..."


class _SideView:
    """Handle, force, energy and verdict of one side."""

    def __init__(self, hand: TouchHand, number: int, pointer: models.ColumnDataSource) -> None:
        touched, colour = hand.touched, _COLOURS[number]
        self._touched, self._number, self._name = touched, number, touched.sides[number].name
        self._waiting: list[dict[str, Array]] = []
        self._is_touched = False
        x, y = ([at] for at in (*touched.start, 0.0)[:2])
        handle = {"x": x, "y": y, "hand_x": x, "hand_y": y, "token": [0.0], "frame": [0]} | five_bar()
        self.handle = models.ColumnDataSource(handle, name=f"handle {number}")
        every = ((vector, d) for vector in touched.readings.vectors for d in touched.directions)
        self._columns = {f"{vector} {d}": f"{number}.{vector}.{d}" for vector, d in every}
        self._columns["energy"] = f"{number}.energy"
        self._lines = models.ColumnDataSource({name: [] for name in ("time", *self._columns)}, name=f"lines {number}")
        self._verdict = models.Div(text="", name=f"verdict {number}", sizing_mode="stretch_width")
        self._notches = models.ColumnDataSource({"x": [], "y": []}, name=f"notches {number}")
        scene = self._new_scene(pointer)
        self.draw_notches(0.0)
        self.panels = [self._panel("force" if touched.unit == "m" else "torque", effort_unit(touched.unit), "force")]
        for vectors in touched.readings.beside:
            self.panels.append(self._panel(vectors[-1], f"{touched.unit}/s", *vectors))
        self.panels.append(self._panel("energy", "J", "energy"))
        self.panels[-1].add_layout(models.Span(location=0.0, dimension="width", line_color=GREY, line_dash="dashed"))
        title = models.Div(text=f"<b style='font-size:1.3em;color:{colour}'>{html.escape(self._name)}</b>")
        knob = []
        if not touched.is_plane and touched.unit == "rad":
            first, pitch = touched.notches or (0.0, 7.0)
            around = (first + pitch * np.arange(min(200, round(2.0 * np.pi / pitch)))).tolist()
            knob = [new_knob(self.handle, colour, f"knob {number}", touched.solid, around)]
        self.layout = column(*(title, self._verdict, scene, *knob, *self.panels), sizing_mode="stretch_width")

    def _new_scene(self, pointer: models.ColumnDataSource) -> figure:
        """Return the panel in which the handle is dragged."""
        touched, colour = self._touched, _COLOURS[self._number]
        look: Any = {"height": 330 if touched.is_plane else 105, "equal": touched.is_plane, "unit": touched.unit}
        across, along, *_ = *touched.shown, (-1.0, 1.0)
        plane = new_plane(self.handle, colour, across, along, touched.links, name=f"scene {self._number}", **look)
        plane.grid.grid_line_color, plane.yaxis.visible = None, touched.is_plane
        self._draw_solid(plane)
        plane.varea("x", -1.0, "y", source=self._notches, fill_color=MIDDLE, fill_alpha=0.3, level="underlay")
        for event in (PanStart, Pan):
            plane.js_on_event(event, models.CustomJS(args={"pointer": pointer}, code=_SEND))
        return plane

    def draw_notches(self, pitch: float) -> None:
        """Draw detents as hills between notches.

        Args:
            pitch: Distance of the notches [m or rad]; 0: that of the scene.
        """
        if self._touched.notches:
            place, pitch = self._touched.notches[0], pitch or self._touched.notches[1]
            across = np.linspace(*self._touched.shown[0], 2001)
            self._notches.data = {"x": across, "y": 0.8 * np.sin(np.pi * (across - place) / pitch) ** 2 - 0.9}

    def _draw_solid(self, plane: figure) -> None:
        touched, (low, high) = self._touched, self._touched.shown[0]
        if touched.path:
            x, y = zip(*touched.path, strict=True)
            plane.line(x, y, line_color=PALE, line_width=8, line_alpha=0.5, level="underlay")
        for across, along, radius in touched.discs:
            plane.circle(across, along, radius=radius, **MATERIAL)
        edges: list[dict[str, float]] = []
        if touched.is_plane:
            for (left, right), (bottom, top) in zip(touched.solid[::2], touched.solid[1::2], strict=True):
                between = {"left": left, "right": right}
                edges += [{"right": left}, {"left": right}, between | {"top": bottom}, between | {"bottom": top}]
        else:
            for start, end in touched.solid:
                edges.append(({"left": start} if start > low else {}) | ({"right": end} if end < high else {}))
        for edge in edges:
            plane.add_layout(models.BoxAnnotation(**edge, **MATERIAL))

    def _panel(self, title: str, unit: str, *vectors: str) -> figure:
        # A range of its own: a shared one stands still while any of its panels is scrolled out of sight.
        time = models.DataRange1d(follow="end", follow_interval=_SHOWN, range_padding=0.0)
        lines = []
        for name in (name for vector in vectors for name in self._columns if name.split()[0] == vector):
            vector, *direction = name.split()
            look: Any = (_COLOURS[self._number], 1.5) if vector == vectors[-1] else (GREY, 1.0)
            dash = "dashed" if direction == ["y"] else "solid"
            lines.append(line_of(name, self._label(vector, *direction), *look, line_dash=dash))
        panel = panel_of(time, self._lines, title, unit, 150, lines)
        panel.toolbar_location, panel.window_axis, panel.xaxis[0].ticker.desired_num_ticks = None, "none", 4
        return panel

    def _label(self, vector: str, direction: str = "") -> str:
        """Return the legend of a line."""
        text = self._touched.readings.labels.get(vector, vector)
        return f"{text} {direction}".rstrip() if self._touched.is_plane else text

    def take(self, news: TouchNews, frame: int) -> None:
        """Draw rows; the browser returns `frame` once they are drawn."""
        rows, number = news.rows, self._number
        self._is_touched = self._is_touched or bool(rows[f"{number}.energy"].any())
        links = self._touched.links
        angles, place = (
            [rows[f"{number}.{of}.{d}"][-1] for d in self._touched.directions if links] for of in _OF_LINKS
        )
        last: dict[str, object] = {"token": rows["token"][-1:], "frame": [frame], **five_bar(links, angles, place)}
        for name, prefix in (("", f"{number}.position."), ("hand_", "hand.")):
            for d in ("x", "y"):
                last[name + d] = rows[prefix + d][-1:] if d in self._touched.directions else np.zeros(1)
        self.handle.data = last
        self._waiting.append(rows)
        lasted = rows["time"][-1] - self._waiting[0]["time"][0]
        if lasted < 0.2:  # [s]: handles move at every look, lines grow more slowly
            return
        parts, self._waiting = self._waiting, []
        rows = {name: np.concatenate([part[name] for part in parts]) for name in rows}
        columns = {name: rows[column] for name, column in self._columns.items()}
        stream(self._lines, rows["time"], columns, max(2, round(120 * lasted)))

    def judge(self, status: TouchStatus) -> None:
        """Show whether the side has given out more energy than it received so far."""
        if not self._is_touched:
            self._verdict.text = "not touched yet"
            return
        least, allowance = status.least[self._number], self._touched.sides[self._number].allowance
        passive, _ = passive_verdict(least + allowance + PASSIVE_TOLERANCE)
        of: Any = {self._touched.readings.verdict: passive}
        verdict = verdict_bar({self._name: of})
        allowed = f", it may {si(allowance, 'J')}" if allowance else ""
        self._verdict.text = f"{verdict}<div>gave out {si(max(0.0, -least), 'J')} more than it took in{allowed}</div>"

    def clear(self) -> None:
        """Remove the lines and the verdict of the last run."""
        self._lines.data = {name: [] for name in self._lines.data}
        self._waiting, self._is_touched = [], False


class _Controls:
    """Sliders and buttons for environment, rate and delay; a change restarts the run."""

    def __init__(self, hand: TouchHand, begin: Callable[[dict[str, str]], object]) -> None:
        self._begin = begin
        bus, touched = hand.touched.scene.bus, hand.touched
        self._sliders: list[tuple[TouchSlider, models.Slider]] = [(one, _slider(one)) for one in touched.sliders]
        rate = f"{bus.rate:g}"
        self._rates = sorted({"200", "500", "1000", "2000", rate}, key=float)
        self._rate = models.RadioButtonGroup(
            labels=[f"{rate} Hz" for rate in self._rates], active=self._rates.index(rate), name="rate"
        )
        self._delay = models.RadioButtonGroup(
            labels=list(_DELAYS.values()), active=list(_DELAYS).index(bus.rpdo), name="delay",
            disabled=not touched.readings.has_delay,
        )  # fmt: skip
        again = models.Button(label="start again", name="again")
        again.on_click(lambda: self._moved("", None, None))
        widgets = [widget for _, widget in self._sliders]
        for slider in widgets:
            slider.on_change("value_throttled", self._moved)
        for group in (self._rate, self._delay):
            group.on_change("active", self._moved)
        wrapped: Any = {"sizing_mode": "stretch_width", "styles": {"flex-wrap": "wrap"}}
        self.layout = row(*widgets, self._rate, self._delay, again, **wrapped)

    def _moved(self, _name: str, _old: object, _new: object) -> None:
        changes = {"bus.rate": self._rates[self._rate.active], "bus.rpdo": list(_DELAYS)[self._delay.active]}
        for one, widget in self._sliders:
            changes[one.key] = repr(float(10.0**widget.value if one.decades else widget.value))
        self._begin(changes)


def _slider(one: TouchSlider) -> models.Slider:
    """Return the slider widget for a value of the scene."""
    value = np.log10(max(one.value, 1e-6)) if one.decades else one.value
    most = one.decades or (5.0 * one.value or 20.0) - value
    code = "return `${Number((decades ? Math.pow(10, tick) : tick).toPrecision(3))} ${unit}`"
    shown = models.CustomJSTickFormatter(args={"unit": one.unit, "decades": one.decades}, code=code)
    return models.Slider(
        start=value - one.decades if one.decades else 0.0, end=value + most, step=(most or 1.0) / 40.0, value=value,
        title=one.title, format=shown, name=one.title,
    )  # fmt: skip


def _status(status: TouchStatus, rate: float) -> str:
    if status.ended:
        return f"<b>ended:</b> {html.escape(status.ended)}"
    facts = [
        f"{status.cycles} cycles",
        f"<b>this computer is too slow for {rate:g} Hz: shown in slow motion</b>" if status.given_up else "",
        f"{status.skipped} SYNCs skipped",
        f"pointer to cycle {si(status.answered[0], 's')}, 99 % {si(status.answered[1], 's')}",
    ]
    return " &nbsp; ".join(fact for fact in facts if fact)
