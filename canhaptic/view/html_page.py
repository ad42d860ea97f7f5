"""Self-contained HTML pages that need no network: text, pictures, sortable tables and verdicts, light and dark."""

import html
import re
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final, Literal
from urllib.parse import quote

from canhaptic.control.verdict import Headline, PortResult
from canhaptic.errors import InputError
from canhaptic.host.output_files import replacing
from canhaptic.view.picture_style import BLUE, GREEN, ORANGE, VERMILION
from canhaptic.view.run_lines import headline_text
from canhaptic.view.table import Table
from canhaptic.view.terminal import visible

_STYLE, _SCRIPT = (Path(__file__).with_suffix(suffix).read_text(encoding="utf-8") for suffix in (".css", ".js"))
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
        f"<style>\n{_STYLE}</style></head><body><h1>{name}</h1>{body}<script>\n{_SCRIPT}</script></body></html>"
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
    "no": VERMILION,
    "nothing rendered": VERMILION,
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
