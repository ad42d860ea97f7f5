"""One picture of a run: position and wall, torque, energy in against dissipated, surplus; one column per account.

An axis in a group has no column: its position and torque are drawn in that of the group.

matplotlib is imported when a picture is drawn, not before.
"""

from collections.abc import Sequence
from itertools import cycle
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from canhaptic.audit.extent import contacts, rows_between, rows_to_draw
from canhaptic.logs.energy_reader import EnergyLog, Quantities
from canhaptic.view.decimate import decimate
from canhaptic.view.palette import BLUE, GREEN, GREY, ORANGE, VERMILION
from canhaptic.view.picture_style import STYLE, axis_scale, matplotlib_figure, save_picture
from canhaptic.view.series import faults_of
from canhaptic.view.si import si

_OF_AXES: Final = (BLUE, VERMILION, GREEN, ORANGE)  # axes of a group in turn
_BUCKETS: Final = 2000  # about 4000 points a line, more than the picture has columns
_MAX_CONTACTS_SHADED: Final = 400  # more stripes than this are only grey
_MAX_FAULTS_NAMED: Final = 4
_LEGEND: Final[Any] = {
    "loc": "lower right",
    "bbox_to_anchor": (1.0, 0.985),
    "ncols": 5,
    "borderaxespad": 0.0,
    "columnspacing": 1.2,
}

_Array = NDArray[Any]


def draw_energy(
    log: EnergyLog,
    path: str | Path,
    start: float | None = None,
    stop: float | None = None,
    other: EnergyLog | None = None,
) -> None:
    """Draws a run into a file; its suffix says how (.png, .svg, .pdf).

    The wall is drawn where the log's attributes `NAME.wall_position` and `NAME.wall_side` say so.

    Args:
        log: An open energy log.
        path: The picture.
        start: Time of the first SYNC to draw [s]; from the beginning by default.
        stop: Time of the first SYNC not to draw [s]; to the end by default.
        other: A second run, drawn over the first in thin dashed lines where it has the same ports.

    Raises:
        InputError: The log holds no cycle there, matplotlib is not installed, or the file cannot be written.
    """
    mpl, _ = matplotlib_figure()
    with mpl.rc_context(STYLE):
        save_picture(energy_figure(log, start, stop, other), path)


def energy_figure(
    log: EnergyLog, start: float | None = None, stop: float | None = None, other: EnergyLog | None = None
) -> Any:
    """Returns the matplotlib figure of a run; the arguments are those of `draw_energy`."""
    rows = rows_to_draw(log, start, stop)
    mpl, figure_type = matplotlib_figure()
    with mpl.rc_context(STYLE):
        shown = {name: port for name, port in log.ports.items() if name not in log.group_of}
        figure: Any = figure_type(figsize=(2.0 + 6.5 * len(shown), 9.0), dpi=120, layout="constrained")
        figure.get_layout_engine().set(hspace=0.04, h_pad=0.06)
        panels: Any = figure.subplots(4, len(shown), sharex=True, squeeze=False, height_ratios=(3, 3, 4, 2))
        for column, (name, port) in enumerate(shown.items()):
            picture = _PortPicture(log, name, port, rows)
            picture.draw(panels[:, column])
            if other is not None and name in other.ports and other.rows:
                overlay = _PortPicture(other, name, other.ports[name], rows_between(other, start, stop))
                overlay.draw_over(panels[:, column], picture.scales)
            panels[-1, column].set_xlabel("time [s]" + picture.faults())
        figure.suptitle(_caption(log), x=0.995, ha="right", fontsize=8.0, color="#707070")
    return figure


def _caption(log: EnergyLog) -> str:
    parts = [log.path.name, f"{log.rows} cycles at {si(1.0 / log.sample_time, 'Hz', 3)}", log.status]
    if "config_hash" in log.attributes:
        parts.insert(1, f"configuration {str(log.attributes['config_hash'])[:12]}")
    return "   ".join(parts)


class _PortPicture:
    """The four panels of one account: of an axis, or of a group with the positions and torques of its axes."""

    def __init__(self, log: EnergyLog, name: str, port: Quantities, rows: slice) -> None:
        self._log = log
        self._name = name
        self._port = port
        self._rows = rows
        self._time = log.time[rows]
        self._axes = log.groups.get(name, ())
        self._movers = [log.ports[axis] for axis in self._axes] or [port]
        self.scales: list[float] = []  # of the panels, top to bottom
        self._contacts = contacts(self._column("branch"))
        if len(self._contacts) > _MAX_CONTACTS_SHADED:
            self._contacts = []
        self._faults = faults_of(log, name, log.timing["sync_index"][rows])

    def draw(self, panels: Any) -> None:
        """Draws into four axes, top to bottom."""
        position, torque, energy, surplus = panels
        self._draw_position(position)
        self._draw_torque(torque)
        self._draw_energy(energy)
        self._draw_surplus(surplus)
        for axes in panels:
            self._mark(axes)
            axes.margins(x=0.0)
        if len(self._log.ports) > 1 or self._axes:
            position.set_title(f"{self._name}: position", fontweight="bold")

    def draw_over(self, panels: Any, scales: Sequence[float]) -> None:
        """Draws the same quantities over the panels of another run, whose scales they take."""
        taken_in, dissipated = np.cumsum(self._column("h_i")), np.cumsum(self._column("h_r"))
        lines = self._of_movers("position"), self._of_movers("torque_applied"), (taken_in, dissipated)
        for axes, scale, values in zip(panels, scales, (*lines, (self._column("h_dis"),)), strict=True):
            for number, line in enumerate(values):
                label = self._log.path.name if number == 0 else None
                self._line(axes, line, scale, color="black", linewidth=0.7, linestyle=(0, (3, 2)), label=label)
            axes.legend(**_LEGEND)

    def _column(self, name: str) -> _Array:
        return self._port.read(name, self._rows.start, self._rows.stop)

    def _of_movers(self, name: str) -> list[_Array]:
        """Returns a quantity of the axis, or of each axis of the group."""
        return [port.read(name, self._rows.start, self._rows.stop) for port in self._movers]

    def _line(self, axes: Any, values: _Array, scale: float, **style: Any) -> None:
        shown = decimate(values, _BUCKETS)
        axes.plot(self._time[shown], values[shown] / scale, **style)

    def _draw_position(self, axes: Any) -> None:
        positions = self._of_movers("position")
        wall = self._log.attributes.get(f"{self._name}.wall_position")
        scale, prefix = self._prefix(*positions)
        for position, label, colour in zip(positions, self._axes or ("position",), cycle(_OF_AXES)):
            self._line(axes, position, scale, color=colour, linewidth=1.3, label=label)
        if isinstance(wall, int | float):
            axes.axhline(wall / scale, color=GREY, linewidth=1.0, linestyle="--", label="wall")
            low, high = axes.get_ylim()
            inside = low if self._log.attributes.get(f"{self._name}.wall_side", "below") == "below" else high
            axes.axhspan(inside, wall / scale, color=GREY, alpha=0.10, linewidth=0)
            axes.set_ylim(low, high)
        _finish(axes, "position", f"{prefix}{self._movers[0].unit('position')}")

    def _draw_torque(self, axes: Any) -> None:
        if self._axes:
            self._draw_torques_of_axes(axes)
            return
        command, applied = self._column("torque_command"), self._column("torque_applied")
        unit = self._port.unit("torque_applied")
        scale, prefix = self._prefix(command, applied)
        self._line(
            axes, command, scale, color=ORANGE, linewidth=2.2, alpha=0.8, drawstyle="steps-post", label="commanded"
        )
        self._line(axes, applied, scale, color=BLUE, linewidth=0.9, drawstyle="steps-pre", label="applied")
        _finish(axes, "torque" if unit == "N*m" else "force", f"{prefix}{unit}")

    def _draw_torques_of_axes(self, axes: Any) -> None:
        """Draws what each axis of a group applied; what was commanded is drawn wide and pale behind it."""
        commands, applied = self._of_movers("torque_command"), self._of_movers("torque_applied")
        unit = self._movers[0].unit("torque_applied")
        scale, prefix = self._prefix(*commands, *applied)
        pale: Any = {"linewidth": 2.4, "alpha": 0.3, "drawstyle": "steps-post"}
        thin: Any = {"linewidth": 0.9, "drawstyle": "steps-pre"}
        for command, held, name, colour in zip(commands, applied, self._axes, cycle(_OF_AXES)):
            self._line(axes, command, scale, color=colour, **pale)
            self._line(axes, held, scale, color=colour, label=name, **thin)
        _finish(axes, "torque" if unit == "N*m" else "force", f"{prefix}{unit}")

    def _draw_energy(self, axes: Any) -> None:
        taken_in, dissipated = np.cumsum(self._column("h_i")), np.cumsum(self._column("h_r"))
        margin = taken_in - dissipated
        scale, prefix = self._prefix(taken_in, dissipated)
        shown = np.unique(np.concatenate([decimate(values, _BUCKETS) for values in (taken_in, dissipated, margin)]))
        time, upper, lower = self._time[shown], taken_in[shown] / scale, dissipated[shown] / scale
        axes.fill_between(time, lower, upper, upper >= lower, color=GREEN, alpha=0.22, linewidth=0, label="margin")
        if (upper < lower).any():
            axes.fill_between(time, lower, upper, upper < lower, color=VERMILION, alpha=0.45, linewidth=0)
        axes.plot(time, upper, color=BLUE, linewidth=1.3, label="in")
        axes.plot(time, lower, color=VERMILION, linewidth=1.3, linestyle=(0, (4, 1.5)), label="dissipated")
        worst = int(margin.argmin())
        label = f"least {si(float(margin[worst]), 'J')} at {self._time[worst]:.4g} s"
        axes.plot(self._time[worst], taken_in[worst] / scale, "ko", markersize=4, zorder=5, label=label)
        _finish(axes, "energy", f"{prefix}J")

    def _draw_surplus(self, axes: Any) -> None:
        surplus, deficit = self._column("h_dis"), np.cumsum(self._column("deficit"))
        scale, prefix = self._prefix(surplus, deficit)
        self._line(axes, surplus, scale, color=ORANGE, linewidth=1.3, label="surplus to dissipate")
        self._line(axes, deficit, scale, color=VERMILION, linewidth=1.0, linestyle="--", label="deficit, summed")
        if not (surplus.any() or deficit.any()):
            axes.set_ylim(-0.05, 1.0)
        _finish(axes, "surplus", f"{prefix}J")

    def _prefix(self, *lines: _Array) -> tuple[float, str]:
        """Returns the scale and SI prefix of the panel that shows all of these lines."""
        largest = max(abs(float(limit(line, initial=0.0))) for line in lines for limit in (np.nanmin, np.nanmax))
        scale, prefix = axis_scale(largest)
        self.scales.append(scale)
        return scale, prefix

    def _mark(self, axes: Any) -> None:
        """Shades the contacts and marks faults."""
        for start, end in self._contacts:
            axes.axvspan(self._time[start], self._time[end], color=GREY, alpha=0.05, linewidth=0, zorder=0)
        for event in self._faults:
            axes.axvline(event.sync_index * self._log.sample_time, color=VERMILION, linewidth=0.9, linestyle=":")

    def faults(self) -> str:
        """Returns one line of words per marked fault, for below the time axis."""
        period = self._log.sample_time
        return "".join(
            f"\n{event.sync_index * period:.4g} s: {event.kind} {event.text[:60]}"
            for event in self._faults[:_MAX_FAULTS_NAMED]
        )


def _finish(axes: Any, title: str, unit: str) -> None:
    """Titles at the left, legend at the right of the same line: nothing can lie on the data."""
    axes.set_title(title, fontweight="bold")
    axes.set_ylabel(f"[{unit}]")
    axes.legend(**_LEGEND)
