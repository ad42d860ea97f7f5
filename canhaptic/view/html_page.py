"""Self-contained HTML pages that need no network: text, pictures, sortable tables and verdicts, light and dark.

`write_html` is the page of `inspect --html`: the verdicts, pictures of a run and its worst moments, and all tables.
"""

import html
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from itertools import cycle
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Final, Literal
from urllib.parse import quote

import numpy as np

from canhaptic.audit.inspection import rows_to_draw
from canhaptic.axis_units import counted, si
from canhaptic.control.verdict import Headline, PortResult
from canhaptic.errors import InputError
from canhaptic.files import replacing
from canhaptic.logs.columns import PHASE
from canhaptic.logs.energy_reader import EnergyLog
from canhaptic.logs.hdf5 import Array
from canhaptic.signals import CycleTiming
from canhaptic.view.buzz_lines import why_lines
from canhaptic.view.energy_table import energy_table, inspection_tables
from canhaptic.view.picture_style import ALARM, BLUE, GREEN, ORANGE, PURPLE, drawing, save_picture, scale_of
from canhaptic.view.run_lines import advice_lines, failure_text, first_active, headline_text
from canhaptic.view.run_picture import draw_energy
from canhaptic.view.series import FAULTS, decimate, losses
from canhaptic.view.state_lanes import draw_buzz
from canhaptic.view.table import Table
from canhaptic.view.terminal import visible

if TYPE_CHECKING:
    from canhaptic.audit.inspection import Inspection

STYLE, _SCRIPT = (Path(__file__).with_suffix(suffix).read_text(encoding="utf-8") for suffix in (".css", ".js"))
_LEAST_SIZE: Final = 0.6
"""Least size of a picture as a fraction of its full size; in a narrower window it scrolls."""
_GREY: Final = re.compile(r"(?<=: )#([0-9a-f]{2})\1\1\b")
_PROLOGUE: Final = re.compile(r"^.*?<svg |<metadata>.*?</metadata>", re.DOTALL)
_WIDTH: Final = re.compile(r'width="([\d.]+)pt"')


def words(*lines: str) -> str:
    """Return one HTML paragraph with the given lines."""
    return f"<p>{'<br>'.join(map(html.escape, lines))}</p>"


def picture(draw: Callable[[Path], object], title: str, *, folded: bool = False) -> str:
    """Return a picture as HTML that suits light and dark pages.

    Its greys become mixtures of the page's text and background colours, and its blue the page's blue.

    Args:
        draw: Function that draws the picture into the given SVG file.
        title: Title of the picture.
        folded: Whether only the title is shown until it is clicked.
    """
    with TemporaryDirectory(prefix="canhaptic-page-") as folder:
        file = Path(folder) / "picture.svg"
        draw(file)
        drawn = _PROLOGUE.sub("", file.read_text(encoding="utf-8"))
    found = _WIDTH.search(drawn)
    least = f"min-width: {_LEAST_SIZE * float(found.group(1)):.0f}pt" if found else ""
    mixed = "color-mix(in srgb, var(--ink) {:.3g}%, var(--paper))".format
    shaded = _GREY.sub(lambda grey: mixed(100.0 * (1.0 - int(grey.group(1), 16) / 255.0)), drawn)
    shaded = shaded.replace(BLUE.lower(), "var(--blue)")
    name = html.escape(title, quote=True)
    shown = f'<figure><svg role="img" aria-label="{name}" style="{least}" {shaded}</figure>'
    return f"<details><summary>{name}</summary>{shown}</details>" if folded else shown


def write_page(path: Path, title: str, parts: Iterable[str | Table]) -> None:
    """Write a page.

    Args:
        path: File to write.
        title: Title of the page, and its first heading.
        parts: HTML texts and tables, in their order.

    Raises:
        InputError: The page cannot be written.
    """
    body = "".join(_table(part) if isinstance(part, Table) else part for part in parts)
    name = html.escape(title)
    text = (
        f'<!DOCTYPE html><html lang="en"><head><meta charset="utf-8"><title>{name}</title>'
        f"<style>\n{STYLE}</style></head><body><h1>{name}</h1>{body}<script>\n{_SCRIPT}</script></body></html>"
    )
    try:
        with replacing(path) as page:
            page.write_text(visible(text), encoding="utf-8")
    except OSError as error:
        raise InputError(f"{path}: the page cannot be written ({error.strerror}); name another file") from error


def _table(table: Table) -> str:
    links = " ".join(
        f'<a download="table.{kind}" href="data:{media};charset=utf-8,{quote(text)}">{kind.upper()}</a>'
        for kind, media, text in (("csv", "text/csv", table.csv()), ("json", "application/json", table.json()))
    )
    return f'<div class="table">{table.html()}<small>click a heading to sort; download as {links}</small></div>'


_SUMS: Final[dict[Literal["passive", "passive_at_sensor", "passive_at_handle"], str]] = {
    "passive": "at the motor",
    "passive_at_sensor": "at the sensor",
    "passive_at_handle": "at the handle",
}
_COLOURS: Final[dict[Headline, str]] = {
    "yes": GREEN,
    "in doubt": ORANGE,
    "no": ALARM,
    "nothing rendered": ALARM,
    "no contact": BLUE,
    "dry run": BLUE,
}


def verdict_bar(ports: Mapping[str, PortResult], failure: str = "") -> str:
    """Return an HTML bar with the verdicts of every port, and its headline if that differs from a verdict.

    Args:
        ports: Accounts of the ports.
        failure: Text for a run that failed, first in the bar; "" for none.
    """
    said: list[tuple[str, Headline]] = [(f"{failure}:", "no")] if failure else []
    for name, port in ports.items():
        if "verdict" in port and any(port.get(key, port["verdict"]) != port["verdict"] for key in _SUMS):
            said.append((headline_text(name, port).plain.strip(), port["verdict"]))
        for key, sum_of in _SUMS.items():
            if key in port:
                word = port[key]
                why = f": {port['why']}" if word == "in doubt" and key == "passive_at_handle" and "why" in port else ""
                said.append((f"{name}: passive {sum_of}: {word if word != 'no' else 'NO'}{why}", word))
    style = "display:inline-block;color:white;font-weight:bold;padding:3px 14px;margin-right:6px;border-radius:3px"
    return "".join(
        f"<span class='verdict' style='{style};background:{_COLOURS[word]}'>{html.escape(text)}</span>"
        for text, word in said
    )


_BUCKETS: Final = 1000
_LINE_COLOURS: Final = (BLUE, GREEN, ORANGE, PURPLE)
_SPAN: Final = 0.25  # [s] shown on either side of a moment
_MOST_FAULTS: Final = 3
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
    parts += [
        words(f"{name}: {text}") for name, of in result["ports"].items() if "verdict" in of for text in advice_lines(of)
    ]
    for other in result.get("others", ()):
        parts += [words(f"{other['file']}: {_facts(other)}"), verdict_bar(other["ports"], failure_text(other))]
    moments = []
    for number, (title, moment, is_alarm) in enumerate(_moments(result)):
        near = partial(draw_energy, log, start=moment - _SPAN, stop=moment + _SPAN, others=others)
        moments.append(picture(near, title, folded=True).replace("<details", f'<details id="moment{number}"', 1))
        if is_alarm:
            parts.append(_BUTTON.format(number, html.escape(title)))
    parts += [picture(whole, "the run"), *_buzz(log, result, rows), *moments]
    panels, idle = _further(log, rows)
    if panels:
        parts.append(picture(partial(_draw_further, panels), "damping, timing, losses", folded=True))
    if idle:
        parts.append(words(f"zero throughout, not drawn: {', '.join(idle)}"))
    tables = [energy_table(result, *result.get("others", ())), *inspection_tables(result)]
    write_page(path, log.path.name, [*parts, *tables])


def _buzz(log: EnergyLog, result: "Inspection", rows: slice) -> Iterator[str]:
    """Yield what buzzes in words, and its spectrum and states; nothing of a calm run."""
    if whys := result.get("why"):
        units = {name: port["unit"] for name, port in result["ports"].items()}
        yield words(*(line.strip() for line in why_lines(whys, units)))
        yield picture(partial(draw_buzz, log, whys, rows), "spectrum and states")


def _facts(result: "Inspection") -> str:
    return (
        f"{result['status']}   {counted(result['cycles'], 'cycle')} at {si(result['rate'], 'Hz', 3)}   scene checksum "
        f"{result['config_hash'][:12]}   TPDOs received {100.0 * result['link']['success_rate']:.6g} %"
    )


def _moments(result: "Inspection") -> Iterator[tuple[str, float, bool]]:
    """Yield title and time [s] of each moment that gets an enlarged picture, and whether it gets a button too."""
    if result["to"] - result["from"] <= 2.0 * _SPAN:
        return

    def within(time: float) -> float:
        return min(max(time, result["from"]), result["to"])

    for name, port in result["ports"].items():
        if "first_active" in port:
            yield f"{name}: first below zero at {first_active(port)}", within(port["first_active"]), True
        if "margin" in port:
            time = within(port["margin"]["time"])
            yield f"{name}: around the smallest margin, {si(port['margin']['value'], 'J')} at {time:.4g} s", time, False
    for event in [event for event in result["events"] if event["kind"] in FAULTS][:_MOST_FAULTS]:
        yield f"around {event['kind']} {event['text']} at {event['time']:.4g} s", within(event["time"]), False


def _further(log: EnergyLog, rows: slice) -> tuple[_Panels, list[str]]:
    """Return the panels that the main picture lacks, and the titles of those left out because they are all zero."""
    span = rows.start, rows.stop
    time = log.deadlines(*span) * log.sample_time

    def thinned(values: Array) -> tuple[Array, Array]:
        shown = decimate(values, _BUCKETS)
        return time[shown], values[shown].astype(np.float64)

    panels: _Panels = {}
    for name in log.accounts:
        port = log.ports[name]
        lines = {"damping": thinned(port.read("damping_rendered", *span))}
        panels[f"{name}: damping rendered"] = port.unit("damping_rendered"), lines
    timing = {
        name.replace("_", " "): thinned(log.timing.read(name, *span))
        for name in (*CycleTiming._fields, PHASE)
        if name in log.timing
    }
    panels["timing"] = "s", {name: (at, values * _S_PER_NS) for name, (at, values) in timing.items()}
    panels["lost"] = "", {name: thinned(np.cumsum(of, out=of)) for name, of in losses(log, *span).items() if of.any()}
    shown = {name: panel for name, panel in panels.items() if any(line.any() for _, line in panel[1].values())}
    return shown, [name for name in panels if name not in shown]


def _draw_further(panels: _Panels, path: Path) -> None:
    with drawing() as figure_type:
        figure = figure_type(figsize=(8.5, 0.4 + 1.6 * len(panels)), layout="constrained")
        places = figure.subplots(len(panels), sharex=True, squeeze=False)[:, 0]
        for place, (title, (unit, lines)) in zip(places, panels.items(), strict=True):
            largest = max(float(np.abs(line).max()) for _, line in lines.values())
            scale, prefix = scale_of(largest) if unit else (1.0, "")
            stair = "default" if unit == "s" else "steps-post"
            for (name, (time, line)), colour in zip(lines.items(), cycle(_LINE_COLOURS)):
                place.plot(time, line / scale, color=colour, linewidth=1.0, drawstyle=stair, label=name)
            place.set_title(title, fontweight="bold")
            place.set_ylabel(f"[{prefix}{unit}]" if unit else "")
            place.legend(loc="best", fontsize=8.0)
        places[-1].set_xlabel("time [s]")
        save_picture(figure, path)
