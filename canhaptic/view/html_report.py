"""`inspect --html`: one page with the verdicts, pictures of the run and its worst moments, and all tables."""

import html
from collections.abc import Iterator, Sequence
from functools import partial
from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from canhaptic.audit.inspection import rows_to_draw
from canhaptic.axis_units import counted, si
from canhaptic.logs.energy_reader import EnergyLog
from canhaptic.logs.hdf5 import Array
from canhaptic.signals import CycleTiming
from canhaptic.view.energy_table import energy_table, inspection_tables
from canhaptic.view.html_page import picture, verdict_bar, words, write_page
from canhaptic.view.picture_style import BLUE, GREEN, PURPLE, VERMILION, drawing, save_picture, scale_of
from canhaptic.view.run_lines import failure_text, first_active
from canhaptic.view.run_picture import draw_energy
from canhaptic.view.series import FAULTS, decimate, losses
from canhaptic.view.table import Table

if TYPE_CHECKING:
    from canhaptic.audit.inspection import Inspection

_BUCKETS: Final = 1000
_COLOURS: Final = (BLUE, GREEN, VERMILION, PURPLE)
_SPAN: Final = 0.25  # [s] shown on either side of a moment
_MOST_FAULTS: Final = 3
_FIRST_BELOW: Final = "first below zero at"
_BUTTON: Final = """<p><button onclick="const near = document.getElementById('moment{}'); near.open = true;
near.scrollIntoView()">{}</button></p>"""
_S_PER_NS: Final = 1e-9
_Panels = dict[str, tuple[str, dict[str, tuple[Array, Array]]]]
"""Title of a panel -> its unit, and its lines by name: times [s] and values."""


def write_html(
    log: EnergyLog,
    path: Path,
    result: "Inspection",
    start: float | None = None,
    stop: float | None = None,
    others: Sequence[EnergyLog] = (),
) -> None:
    """Write a run as one self-contained page.

    Args:
        log: An open energy log.
        path: File to write.
        result: Result of `inspect` for the same rows.
        start: Time of the first SYNC to draw [s]; from the beginning by default.
        stop: Time of the first SYNC not to draw [s]; to the end by default.
        others: Further runs, drawn over the first in thin dashed lines.

    Raises:
        InputError: The log has no cycle in that time, matplotlib is not installed, or the page cannot be written.
    """
    rows = rows_to_draw(log, start, stop)
    whole = partial(draw_energy, log, start=start, stop=stop, others=others)
    parts: list[str | Table] = [words(_facts(result)), verdict_bar(result["ports"], failure_text(result))]
    for other in result.get("others", ()):
        parts += [words(f"{other['file']}: {_facts(other)}"), verdict_bar(other["ports"], failure_text(other))]
    moments = []
    for number, (title, moment) in enumerate(_moments(result)):
        near = partial(draw_energy, log, start=moment - _SPAN, stop=moment + _SPAN, others=others)
        moments.append(picture(near, title, folded=True).replace("<details", f'<details id="moment{number}"', 1))
        if _FIRST_BELOW in title:
            parts.append(_BUTTON.format(number, html.escape(title)))
    parts += [picture(whole, "the run"), *moments]
    panels, idle = _further(log, rows)
    if panels:
        parts.append(picture(partial(_draw_further, panels), "damping, timing, losses", folded=True))
    if idle:
        parts.append(words(f"zero throughout, not drawn: {', '.join(idle)}"))
    tables = [energy_table(result, *result.get("others", ())), *inspection_tables(result)]
    write_page(path, log.path.name, [*parts, *tables])


def _facts(result: "Inspection") -> str:
    return (
        f"{result['status']}   {counted(result['cycles'], 'cycle')} at {si(result['rate'], 'Hz', 3)}   configuration "
        f"{result['config_hash'][:12]}   TPDOs received {100.0 * result['link']['success_rate']:.6g} %"
    )


def _moments(result: "Inspection") -> Iterator[tuple[str, float]]:
    """Yield title and time [s] of each moment that gets an enlarged picture."""
    if result["to"] - result["from"] <= 2.0 * _SPAN:
        return

    def within(time: float) -> float:
        return min(max(time, result["from"]), result["to"])

    for name, port in result["ports"].items():
        if "first_active" in port:
            yield f"{name}: {_FIRST_BELOW} {first_active(port).strip()}", within(port["first_active"])
        if "margin" in port:
            time = within(port["margin"]["time"])
            yield f"{name}: around the smallest margin, {si(port['margin']['value'], 'J')} at {time:.4g} s", time
    for event in [event for event in result["events"] if event["kind"] in FAULTS][:_MOST_FAULTS]:
        yield f"around {event['kind']} {event['text']} at {event['time']:.4g} s", within(event["time"])


def _further(log: EnergyLog, rows: slice) -> tuple[_Panels, list[str]]:
    """Return the panels that the main picture lacks, and the titles of those left out because they are all zero."""
    span = rows.start, rows.stop
    time = log.deadlines(*span) * log.sample_time

    def thinned(values: Array) -> tuple[Array, Array]:
        shown = decimate(values, _BUCKETS)
        return time[shown], values[shown].astype(np.float64)

    panels: _Panels = {}
    for name, port in log.ports.items():
        if name not in log.group_of:
            lines = {"damping": thinned(port.read("damping_rendered", *span))}
            panels[f"{name}: damping rendered"] = port.unit("damping_rendered"), lines
    timing = {name.replace("_", " "): thinned(log.timing.read(name, *span)) for name in CycleTiming._fields}
    panels["timing"] = "s", {name: (at, values * _S_PER_NS) for name, (at, values) in timing.items()}
    panels["lost"] = "", {name: thinned(np.cumsum(of)) for name, of in losses(log, *span).items() if of.any()}
    shown = {title: panel for title, panel in panels.items() if any(line.any() for _, line in panel[1].values())}
    return shown, [title for title in panels if title not in shown]


def _draw_further(panels: _Panels, path: Path) -> None:
    with drawing() as figure_type:
        figure = figure_type(figsize=(8.5, 0.4 + 1.6 * len(panels)), layout="constrained")
        places = figure.subplots(len(panels), sharex=True, squeeze=False)[:, 0]
        for place, (title, (unit, lines)) in zip(places, panels.items(), strict=True):
            largest = max(float(np.abs(line).max()) for _, line in lines.values())
            scale, prefix = scale_of(largest) if unit else (1.0, "")
            stair = "default" if title == "timing" else "steps-post"
            for (name, (time, line)), colour in zip(lines.items(), cycle(_COLOURS)):
                place.plot(time, line / scale, color=colour, linewidth=1.0, drawstyle=stair, label=name)
            place.set_title(title, fontweight="bold")
            place.set_ylabel(f"[{prefix}{unit}]" if unit else "")
            place.legend(loc="best", fontsize=8.0)
        places[-1].set_xlabel("time [s]")
        save_picture(figure, path)
