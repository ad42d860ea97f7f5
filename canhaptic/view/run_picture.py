"""Picture of a run: one column of panels per account, with position, torque and energies over time.

A group has one column, with the positions and torques of all its axes. Panels that would show only zeros are left
out. matplotlib is imported only when a picture is drawn.
"""

from collections.abc import Iterable, Mapping, Sequence
from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from canhaptic.audit.inspection import contacts, in_degrees, rows_between, rows_to_draw, walls_of
from canhaptic.axis_units import DEGREE, counted, si
from canhaptic.control.ledger import without_dust
from canhaptic.control.verdict import PASSIVE_TOLERANCE
from canhaptic.errors import InputError
from canhaptic.logs.energy_reader import EnergyLog
from canhaptic.logs.hdf5 import Array
from canhaptic.quantities import ACCOUNT
from canhaptic.units import Unit
from canhaptic.view.picture_style import (
    ALARM,
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    SKY,
    drawing,
    overlaid,
    save_picture,
    scale_of,
)
from canhaptic.view.series import (
    TaskPlane,
    decimate,
    decimate_together,
    drawn_effort,
    faults_of,
    notches_of,
    task_plane,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_OF_AXES: Final = (BLUE, GREEN, ORANGE, SKY)  # axes of a group in turn
_BUCKETS: Final = 2000  # about 4000 points a line, more than the picture has columns
_MAX_CONTACTS_SHADED: Final = 400  # more stripes than this are only grey
_MAX_FAULTS_NAMED: Final = 4
_ROUNDING: Final = 1e-6  # part of the energy that flowed, below which a surplus is no line to look at
_ALWAYS: Final = ("position", "torque", "energy", "surplus", "motion")
"""Panels that every run has."""
_METRES_PER_INCH: Final = 0.0254
_COLUMNS: Final = {
    "position": "position", "velocity": "torque_command", "torque": "torque_applied",
    "energy": "interaction", "surplus": "surplus",
}  # fmt: skip
"""Title of a panel over time -> log column, with its unit."""
_LOOKS: Final[dict[str, dict[str, Any]]] = {
    "position": {"linewidth": 1.3},
    "velocity": {"linewidth": 1.2, "stair": "steps-post"},
    "torque": {"linewidth": 0.9, "stair": "steps-pre"},
}
_LETTERS: Final = 110  # of a row of the legend
_MARK: Final = 6  # letters as wide as the mark of an entry
_LEGEND: Final[Any] = {
    "loc": "lower right",
    "bbox_to_anchor": (1.0, 0.985),
    "ncols": 6,
    "borderaxespad": 0.0,
    "columnspacing": 0.9,
    "handlelength": 1.6,
}


class PortPicture:
    """Panels of one energy account: that of an axis; or that of a group, with positions and torques of its axes."""

    def __init__(self, log: EnergyLog, name: str, rows: slice) -> None:
        self._log = log
        self._name = name
        self._port = port = log.ports[name]
        self._rows = rows
        self._time = log.time[rows]
        self._axes = log.groups.get(name, ())
        self._movers = [log.ports[axis] for axis in self._axes] or [port]
        self._of_command, self._applied = drawn_effort(port)
        self.scales: dict[str, float] = {}  # of each panel over time
        self._units: dict[str, str] = {}  # of each panel over time, with the prefix of its scale
        self.plane = task_plane(log, name, rows)
        self._contacts = contacts(self._column("branch"))
        if len(self._contacts) > _MAX_CONTACTS_SHADED:
            self._contacts = []
        self._faults = faults_of(log, name, log.timing["sync_index"][rows])

    def draws(self) -> list[str]:
        """Return the names of the panels to draw: position and torque always, others only if they are not zero."""
        energy = self._column("interaction").any() or self._column("dissipated").any()
        least = _ROUNDING * float(np.abs(self._column("interaction")).sum())
        surplus = self._column("surplus").max(initial=0.0) > least or self._column("deficit").sum() > least
        shown = {
            "path": self.plane is not None,
            "position": True,
            "velocity": self._of_command == "velocity",
            "torque": True,
            "energy": energy,
            "surplus": surplus,
            "motion": any(of.any() for of in self._of_movers("torque_applied")),
        }
        return [name for name, is_shown in shown.items() if is_shown]

    def draw(self, panels: "Mapping[str, Axes]") -> None:
        """Draw the panels that `draws` named, each into its matplotlib axes."""
        for name, axes in panels.items():
            if name in _COLUMNS:
                self._draw_over_time(axes, name)
            elif name == "path" and self.plane is not None:
                self._draw_path(axes, self.plane)
        if "motion" in panels:
            self._draw_motion(panels["motion"], self.scales)
        first = "position" if "position" in panels else next(iter(panels))
        if first != "path" and (len(self._log.ports) > 1 or self._axes):
            title = panels[first].get_title(loc="left")
            panels[first].set_title(f"{self._name}: {title}", fontweight="bold")

    def draw_over(self, panels: "Mapping[str, Axes]", scales: Mapping[str, float], name: str, colour: str) -> None:
        """Draw this run over the panels of another one, with the scales of those panels."""
        for panel, scale in ((panel, scale) for panel, scale in scales.items() if panel in panels):
            for number, (line, _) in enumerate(self._lines(panel)):
                label = name if number == 0 else None
                self._line(panels[panel], line, scale, color=colour, linewidth=0.7, linestyle=(0, (3, 2)), label=label)
            _add_legend(panels[panel])
        if "motion" in panels:
            self._draw_motion(panels["motion"], scales, name, colour)

    def _column(self, name: str) -> Array:
        return self._port.read(name, self._rows.start, self._rows.stop)

    def _of_movers(self, name: str) -> list[Array]:
        """Return a quantity of the axis, or of each axis of the group."""
        return [port.read(name, self._rows.start, self._rows.stop) for port in self._movers]

    def _lines(self, panel: str) -> list[tuple[Array, dict[str, Any]]]:
        """Return values and style of those lines of a panel over time that are also drawn for an overlaid run."""
        if panel == "energy":
            return [(np.cumsum(self._column(name)), {}) for name in ("interaction", "dissipated")]
        if panel == "surplus":
            return [(self._column("surplus"), {**_look("surplus"), "linewidth": 1.3})]
        alone = {"velocity": "commanded", "torque": self._applied}.get(panel, panel)
        movers = zip(self._of_movers(_COLUMNS[panel]), self._axes or (alone,), cycle(_OF_AXES))
        return [(values, {"color": colour, "label": label, **_LOOKS[panel]}) for values, label, colour in movers]

    def _own_lines(self, panel: str) -> list[tuple[Array, dict[str, Any]]]:
        """Return values and style of the lines not drawn for an overlaid run: deficit and requested torques."""
        look: dict[str, Any] = {**_look("deficit"), "linewidth": 1.0, "linestyle": "--"}
        if panel == "surplus":
            return [(np.cumsum(self._column("deficit")), look)]
        if panel != "torque" or self._of_command != panel:
            return []
        label = {"label": ACCOUNT["torque_command"].title}
        look = {"linewidth": 2.4, "alpha": 0.3} if self._axes else {"linewidth": 2.2, "alpha": 0.8, **label}
        requests = zip(self._of_movers("torque_command"), cycle(_OF_AXES if self._axes else (ORANGE,)))
        return [(values, {"color": colour, "stair": "steps-post", **look}) for values, colour in requests]

    def _line(self, axes: "Axes", values: Array, scale: float, stair: str = "default", **style: Any) -> None:
        """Draw a line, as steps only if every row is drawn: between decimated rows the values are unknown."""
        shown = decimate(values, _BUCKETS)
        drawn = stair if len(shown) == len(values) else "default"
        axes.plot(self._time[shown], values[shown] / scale, drawstyle=drawn, **style)

    def _draw_over_time(self, axes: "Axes", panel: str) -> None:
        self._mark(axes, "in contact" if panel == "position" else "")
        common, own = self._lines(panel), self._own_lines(panel)
        lines = [*own, *common] if panel == "torque" else [*common, *own]
        scale = self._scaled(panel)
        if panel == "energy":
            self._draw_energy(axes, scale, *(values for values, _ in common))
        else:
            for values, look in lines:
                self._line(axes, values, scale, **look)
        if panel == "position":
            self._draw_wall(axes, scale)
        _finish(
            axes, self._title(panel) + " commanded" * (panel == "velocity" and bool(self._axes)), self._units[panel]
        )
        axes.margins(x=0.0)

    def _title(self, panel: str) -> str:
        return "force" if panel == "torque" and self._movers[0].unit(_COLUMNS[panel]) == "N" else panel

    def _scaled(self, panel: str) -> float:
        """Choose the scale and the unit of a panel over time, and return the scale."""
        lines = [line for line, _ in (*self._lines(panel), *self._own_lines(panel))]
        largest = max(abs(float(limit(line, initial=0.0))) for line in lines for limit in (np.nanmin, np.nanmax))
        if panel == "position":
            largest = max(largest, *(abs(wall) for wall, _ in walls_of(self._log, self._name)), 0.0)
        self.scales[panel], prefix = scale_of(largest)
        self._units[panel] = f"{prefix}{self._movers[0].unit(_COLUMNS[panel])}"
        if panel == "position" and in_degrees(self._log, self._name):
            self.scales[panel], self._units[panel] = DEGREE, "deg"
        return self.scales[panel]

    def _draw_wall(self, axes: "Axes", scale: float) -> None:
        """Mark the notches of detents, or shade the inside of a wall."""
        low, high = (scale * end for end in axes.get_ylim())
        notches = notches_of(self._log, self._name, low, high)
        for place in notches:
            label = "notch" if place == notches[0] else "_notch"
            axes.axhline(place / scale, color=GREY, linewidth=0.7, linestyle="--", alpha=0.6, label=label)
        for wall, side in (walls := walls_of(self._log, self._name)):
            label = "wall" if wall == walls[0][0] else "_wall"
            axes.axhline(wall / scale, color=GREY, linewidth=1.0, linestyle="--", label=label)
            low, high = axes.get_ylim()
            axes.axhspan(low if side == "below" else high, wall / scale, color=GREY, alpha=0.10, linewidth=0)
            axes.set_ylim(low, high)

    def _draw_path(self, axes: "Axes", plane: TaskPlane) -> None:
        """Draw the path of the handle and the surface, with the material shaded and equal scales."""
        scale, prefix = scale_of(float(np.nanmax(np.abs(plane.path))))
        _draw_material(axes, plane, scale)
        axes.plot(*(plane.path / scale).T, color=BLUE, linewidth=1.0, label="path")
        axes.set_aspect("equal")
        axes.set_xlabel(f"[{prefix}{plane.unit}]")
        _finish(axes, f"{self._name}: path", f"{prefix}{plane.unit}")

    def _draw_motion(self, axes: "Axes", scales: Mapping[str, float], other: str = "", colour: str = "") -> None:
        """Draw applied torque over position for each axis: the slope is the stiffness felt."""
        for name in () if other else ("position", "torque"):
            self._scaled(name)
        places, efforts = self._of_movers("position"), self._of_movers("torque_applied")
        labels = self._axes or ("applied",)
        for place, effort, label, own in zip(places, efforts, labels, cycle(_OF_AXES)):
            shown = decimate_together((place, effort), _BUCKETS)
            across, along = place[shown] / scales["position"], effort[shown] / scales["torque"]
            axes.plot(across, along, color=colour or own, linewidth=0.9, label=other or label)
        if not other:
            axes.set_xlabel(f"position [{self._units['position']}]")
            axes.set_ylabel(f"[{self._units['torque']}]")
            axes.set_title(f"{self._title('torque')} over position", fontweight="bold")
        _add_legend(axes)

    def _draw_energy(self, axes: "Axes", scale: float, taken_in: Array, dissipated: Array) -> None:
        margin = taken_in - dissipated
        worst, flowed = int(margin.argmin()), float(np.abs(np.diff(taken_in, prepend=0.0)).sum())
        least = without_dust(min(0.0, float(margin[worst])), flowed)
        shown = decimate_together((taken_in, dissipated, margin), _BUCKETS)
        time, upper, lower = self._time[shown], taken_in[shown] / scale, dissipated[shown] / scale
        area: Any = {"alpha": 0.22, "linewidth": 0, "label": "margin", "color": ACCOUNT["margin"].colour}
        axes.fill_between(time, lower, upper, upper >= lower, **area)
        if least < 0.0:
            axes.fill_between(time, lower, upper, upper < lower, **area | {"color": GREY, "label": "margin below 0"})
        axes.plot(time, upper, linewidth=1.3, **_look("interaction"))
        axes.plot(time, lower, linewidth=1.3, linestyle=(0, (4, 1.5)), **_look("dissipated"))
        label = f"smallest margin {si(least, 'J', 3)}"
        axes.plot(self._time[worst], taken_in[worst] / scale, "ko", markersize=4, zorder=5, label=label)
        below = taken_in < -PASSIVE_TOLERANCE
        if below.any():
            first = float(self._time[int(below.argmax())])
            axes.axvline(first, color=ALARM, linewidth=1.0, linestyle=":", label=f"below zero from {first:.4g} s")

    def _mark(self, axes: "Axes", label: str) -> None:
        """Shade the contacts, with a label in the legend unless it is empty, and mark the faults."""
        look: Any = {"color": GREY, "alpha": 0.05, "linewidth": 0, "zorder": 0}
        for number, (start, end) in enumerate(self._contacts):
            axes.axvspan(self._time[start], self._time[end], label="_" * bool(number) + label, **look)
        for fault in self._faults:
            axes.axvline(fault.time, color=ALARM, linewidth=0.9, linestyle=":")

    def faults(self) -> str:
        """Return one line of text per marked fault, for the label of the time axis."""
        return "".join(
            f"\n{time:.4g} s: {event.kind} {event.text[:60]}" for time, event in self._faults[:_MAX_FAULTS_NAMED]
        )


def _look(name: str) -> dict[str, Any]:
    return {"color": ACCOUNT[name].colour, "label": ACCOUNT[name].title}


def _draw_material(axes: "Axes", plane: TaskPlane, scale: float) -> None:
    across, along = plane.across / scale, plane.along / scale
    deepest = max(float(plane.depth.max()), plane.surface) * (1.0 + 1e-9) + 1e-12
    axes.contourf(across, along, plane.depth, levels=[plane.surface, deepest], colors=[GREY], alpha=0.15)
    axes.contour(across, along, plane.depth, levels=[plane.surface], colors=[GREY], linewidths=1.0)
    for depth, surface in plane.further:
        axes.contour(across, along, depth, levels=[surface], colors=[GREY], linewidths=1.0)
    axes.plot([], [], color=GREY, linewidth=1.0, label="surface")


def _finish(axes: "Axes", title: str, unit: str) -> None:
    """Put the title at the left and the legend at the right above the panel, where neither covers data."""
    axes.set_title(title, fontweight="bold")
    axes.set_ylabel(f"[{unit}]")
    _add_legend(axes)


def _add_legend(axes: "Axes") -> None:
    """Add the legend above the panel, in rows that are no wider; in a figure for a paper inside, where it fits best."""
    if axes.figure.bbox.width / axes.figure.dpi < _NARROW:
        axes.legend(loc="best", frameon=True, framealpha=0.8, edgecolor="none", borderpad=0.2, labelspacing=0.2)
        return
    letters = sum(_MARK + len(label) for label in axes.get_legend_handles_labels()[1])
    axes.legend(**_LEGEND | ({"ncols": 3} if letters > _LETTERS else {}))


_HEIGHTS: Final = {
    "path": 5.0, "position": 3.0, "velocity": 2.0, "torque": 3.0, "energy": 4.0, "surplus": 2.0, "motion": 4.0
}  # fmt: skip
"""Heights of the panels, in units of `_INCH`."""
_INCH: Final = 0.75  # per unit of height
_NARROW: Final = 8.0  # [inch] width below which panels are lower, and letters smaller
_WIDTHS: Final = (0.04, 1.0)  # [m] that a figure may have
_ACROSS: Final = 2  # accounts next to each other; more continue below


def draw_energy(
    log: EnergyLog,
    path: str | Path,
    start: float | None = None,
    stop: float | None = None,
    others: Sequence[EnergyLog] = (),
    panels: Sequence[str] = (),
    width: float | str | None = None,
) -> None:
    """Draw a run into a file; its suffix gives the format (.png, .svg, .pdf).

    Walls are drawn from the log's attributes `NAME.wall_position` and `NAME.wall_side`, those of a sum from
    `NAME.wall_low` and `NAME.wall_high`.

    Args:
        log: An open energy log.
        path: File to write.
        start: Time of the first SYNC to draw [s]; from the beginning by default.
        stop: Time of the first SYNC not to draw [s]; to the end by default.
        others: Further runs, whose ports are drawn over those of the same name in thin dashed lines.
        panels: Panels to draw, among path, position, velocity, torque, energy, surplus and motion; by default those
            that are not zero.
        width: Width of the figure [m], or a text with a unit ("88 mm"), for a paper: letters of 7 points, no caption.

    Raises:
        InputError: The log has no cycle in that time or no such panel, the width is none, matplotlib is not installed,
            or the file cannot be written.
    """
    save_picture(energy_figure(log, start, stop, others, panels=panels, width=width), path)


def energy_figure(
    log: EnergyLog,
    start: float | None = None,
    stop: float | None = None,
    others: Sequence[EnergyLog] = (),
    labels: Sequence[str] = (),
    panels: Sequence[str] = (),
    width: float | str | None = None,
) -> "Figure":
    """Return the matplotlib figure of a run; arguments and errors as for `draw_energy`.

    Args:
        log: An open energy log.
        start: As for `draw_energy`.
        stop: As for `draw_energy`.
        others: As for `draw_energy`.
        labels: Labels of the other runs; by default the names of their files.
        panels: As for `draw_energy`.
        width: As for `draw_energy`.
    """
    names = list(labels) or [other.path.name for other in others]
    rows, inches = rows_to_draw(log, start, stop), _inches(width)
    with drawing(is_small=inches is not None) as figure_type:
        pictures = {name: PortPicture(log, name, rows) for name in log.accounts}
        wanted = {name: _chosen(picture.draws(), panels) for name, picture in pictures.items()}
        figure, columns = _layout(figure_type, wanted, inches)
        for name, picture in pictures.items():
            picture.draw(columns[name])
            for other, label, colour in zip(others, names, overlaid(len(others)), strict=True):
                if name in other.ports and other.rows:
                    overlay = PortPicture(other, name, rows_between(other, start, stop))
                    overlay.draw_over(columns[name], picture.scales, label, colour)
            if last := _last_over_time(columns[name]):
                columns[name][last].set_xlabel("time [s]" + picture.faults() * (inches is None))
        if inches is None:
            figure.suptitle(_caption(log), x=0.995, ha="right", fontsize=8.0, color="#707070")
    return figure


def _inches(width: float | str | None) -> float | None:
    """Return the width of a figure [inch]; None for the usual one.

    Raises:
        InputError: It is no length, or out of range.
    """
    if width is None:
        return None
    try:
        metres = float(str(Unit("m", "m").read(width)))
    except ValueError as error:
        raise InputError(f"width: got {width!r}, {error}, as in '88 mm'") from error
    if not _WIDTHS[0] <= metres <= _WIDTHS[1]:
        raise InputError(f"width: got {metres:g} m, expected {_WIDTHS[0]:g} to {_WIDTHS[1]:g} m; 88 mm is one column")
    return metres / _METRES_PER_INCH


def _chosen(drawn: Sequence[str], panels: Sequence[str]) -> list[str]:
    """Return the panels to draw, in the order of the picture.

    Raises:
        InputError: The run has no such panel.
    """
    possible = [name for name in _HEIGHTS if name in drawn or name in _ALWAYS]
    if missing := [name for name in panels if name not in possible]:
        raise InputError(f"panels: got {missing[0]!r}, expected names among {', '.join(possible)}")
    return [name for name in possible if name in (panels or drawn)]


def _last_over_time(names: Iterable[str]) -> str:
    return next((name for name in reversed(list(names)) if name in _COLUMNS), "")


def _layout(
    figure_type: "type[Figure]", wanted: Mapping[str, Sequence[str]], width: float | None
) -> "tuple[Figure, dict[str, dict[str, Axes]]]":
    """Return an empty figure and the panels of each port by name; panels over time share one time axis."""
    rows = [row for row in _HEIGHTS if any(row in names for names in wanted.values())]
    heights = [_HEIGHTS[row] for row in rows]
    across = min(len(wanted), _ACROSS)
    bands = -(-len(wanted) // _ACROSS)
    usual = 2.0 + 6.5 * across
    inch = _INCH if width is None else _INCH * max(0.5, min(1.0, width / usual))
    figure = figure_type(figsize=(width or usual, inch * sum(heights) * bands), dpi=120 if width is None else 600)
    pad = 0.06 if width is None else 0.02
    figure.set_layout_engine("constrained", hspace=0.04, h_pad=pad)
    grid = figure.add_gridspec(len(rows) * bands, across, height_ratios=heights * bands)
    columns: dict[str, dict[str, Axes]] = {}
    first = None
    for number, (name, names) in enumerate(wanted.items()):
        columns[name] = {}
        for row in names:
            over_time = row in _COLUMNS
            band, column = divmod(number, across)
            place = grid[band * len(rows) + rows.index(row), column]
            axes = figure.add_subplot(place, sharex=first if over_time else None)
            axes.tick_params(labelbottom=not over_time or row == _last_over_time(names))
            first = axes if over_time and first is None else first
            columns[name][row] = axes
    return figure, columns


def _caption(log: EnergyLog) -> str:
    status = log.status.partition(":")[0]  # the reason of a failure is longer than the picture is wide
    parts = [log.path.name, f"{counted(log.rows, 'cycle')} at {si(1.0 / log.sample_time, 'Hz', 3)}", status]
    if "config_hash" in log.attributes:
        parts.insert(1, f"scene checksum {str(log.attributes['config_hash'])[:12]}")
    return "   ".join(parts)
