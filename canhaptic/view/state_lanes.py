"""Lanes of states over time, and spectra: what a page shows of a run that buzzes, and `scope` of every run."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from canhaptic.audit.why.ripple import motion_of, spectrum
from canhaptic.axis_units import effort_unit
from canhaptic.control.balance import OUT_OF_CONTACT, Branch, Certificate
from canhaptic.logs.energy_reader import EnergyLog
from canhaptic.logs.hdf5 import Array
from canhaptic.view.picture_style import ALARM, BLUE, GREEN, GREY, ORANGE, PURPLE, SKY, drawing, save_picture, scale_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from canhaptic.audit.why.causes import Why

LANES: Final = ("contact", "branch", "certificate", "at the limit", "SYNCs skipped")
_COLOURS: Final = (BLUE, GREEN, ORANGE, PURPLE, SKY, GREY)
_MOST: Final = 4000
"""Spans of a lane; of more, only the longest are drawn."""
_LEAST_SHOWN: Final = 1.0  # [Hz]


class Span(NamedTuple):
    """A time in which a state did not change."""

    lane: str
    start: float  # [s]
    end: float
    state: str  # in words
    colour: str


def spans(time: Array, period: float, codes: Mapping[str, Array]) -> list[Span]:
    """Return the spans of all lanes, without those in which nothing is to be shown.

    Args:
        time: Time of each row [s], shape (n_rows,).
        period: Sample time [s].
        codes: Lane -> state of each row: 0 nothing, else a branch or a certificate plus 1, or 1.
    """
    found: list[Span] = []
    for lane, values in codes.items():
        if not len(values):
            continue
        first = np.flatnonzero(np.diff(values, prepend=-1))
        last = np.append(first[1:] - 1, len(values) - 1)
        shown = np.flatnonzero(values[first] > 0)
        shown = np.sort(shown[np.argsort(first[shown] - last[shown], kind="stable")[:_MOST]])
        for place in shown.tolist():
            code = int(values[first[place]])
            start, end = float(time[first[place]]) - period, float(time[last[place]])
            found.append(Span(lane, start, end, _words(lane, code), _colour(lane, code)))
    return found


def _words(lane: str, code: int) -> str:
    names: dict[str, Any] = {"branch": Branch, "certificate": Certificate}
    return names[lane](code - 1).name.lower().replace("_", " ") if lane in names else lane


def _colour(lane: str, code: int) -> str:
    if lane in {"at the limit", "SYNCs skipped"}:
        return ALARM
    return GREY if lane == "contact" else _COLOURS[(code - 1) % len(_COLOURS)]


def codes_of(branch: Array, certificate: Array, command: Array, limit: float, gaps: Array) -> dict[str, Array]:
    """Return the states of each row, for `spans`: 0 where a lane has nothing to show."""
    touches = ~np.isin(branch, (*OUT_OF_CONTACT, Branch.FREE))
    at_limit = np.abs(command) >= 0.99 * limit
    values = touches, branch + 1, np.where(command != 0.0, certificate + 1, 0), at_limit, gaps > 1
    codes = dict(zip(LANES, (of.astype(np.int64) for of in values), strict=True))
    codes["branch"][branch == Branch.FREE] = 0
    return codes


def draw_buzz(log: EnergyLog, whys: "Mapping[str, Why]", rows: slice, path: Path) -> None:
    """Draw spectrum and lanes of each axis that buzzes.

    Raises:
        InputError: matplotlib is not installed, or the file cannot be written.
    """
    with drawing() as figure_type:
        figure = figure_type(figsize=(8.5, 4.2 * len(whys)), layout="constrained")
        places = figure.subplots(2 * len(whys), squeeze=False, height_ratios=(1.2, 1.0) * len(whys))[:, 0]
        for number, (name, why) in enumerate(whys.items()):
            _draw_spectrum(places[2 * number], log, name, why, rows)
            _draw_lanes(places[2 * number + 1], log, name, rows)
        save_picture(figure, path)


def _draw_spectrum(axes: "Axes", log: EnergyLog, name: str, why: "Why", rows: slice) -> None:
    motion, unit = motion_of(log, name, rows), log.ports[name].unit("position")
    second: Any = axes.twinx()
    drawn = (
        (axes, motion.torque, BLUE, effort_unit(unit), "torque"),
        (second, motion.position, ORANGE, unit, "motion"),
    )
    for place, values, colour, of, label in drawn:
        if values is None:
            continue
        lines, sizes = spectrum(motion.period, values)
        shown = lines >= _LEAST_SHOWN
        scale, prefix = scale_of(float(sizes[shown].max(initial=0.0)))
        place.semilogx(lines[shown], sizes[shown] / scale, color=colour, linewidth=1.1, label=label)
        place.set_ylabel(f"{label} [{prefix}{of}]", color=colour)
    axes.axvline(why["frequency"], color=ALARM, linewidth=0.9, linestyle=":")
    axes.set_title(f"{name}: amplitude over frequency, {why['frequency']:.3g} Hz", fontweight="bold")
    axes.set_xlabel("[Hz]")
    second.grid(visible=False)


def _draw_lanes(axes: "Axes", log: EnergyLog, name: str, rows: slice) -> None:
    port = log.ports[name]
    branch, certificate, command = (
        port.read(column, rows.start, rows.stop) for column in ("branch", "certificate", "torque_command")
    )
    deadlines = log.deadlines(rows.start, rows.stop)
    gaps = np.diff(deadlines, prepend=deadlines[:1] - 1)
    named: dict[tuple[str, str], str] = {}
    codes = codes_of(branch, certificate, command, log.number(f"{name}.torque_limit", np.inf), gaps)
    for span in spans(deadlines * log.sample_time, log.sample_time, codes):
        place = len(LANES) - 1 - LANES.index(span.lane)
        axes.broken_barh([(span.start, span.end - span.start)], (place - 0.4, 0.8), color=span.colour, linewidth=0)
        if span.lane in {"branch", "certificate"}:
            named.setdefault((span.lane, span.state), span.colour)
    for (lane, state), colour in named.items():
        axes.plot([], [], color=colour, linewidth=4.0, label=f"{lane}: {state}")
    if named:
        axes.legend(loc="lower right", bbox_to_anchor=(1.0, 0.98), ncols=6, fontsize=8.0)
    axes.set_yticks(range(len(LANES)), LANES[::-1])
    axes.set_ylim(-0.6, len(LANES) - 0.4)
    axes.set_xlabel("time [s]")
    axes.set_title(f"{name}: states", fontweight="bold")
    axes.margins(x=0.0)
