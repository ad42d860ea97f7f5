"""An arena as one page that any browser opens without a network: its pictures, and tables sorted by a click."""

import base64
import html
from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

from canhaptic.errors import InputError
from canhaptic.host.output_file import replacing
from canhaptic.lab.figures.field_figures import FIELD_FIGURES
from canhaptic.lab.render.arena_picture import Found, pictures_of
from canhaptic.lab.studies.arena.standings import COLUMNS

_STYLE: Final = """
body { font: 15px/1.45 system-ui, sans-serif; margin: 1.5em auto; max-width: 80em; padding: 0 1em; color: #202020; }
table { border-collapse: collapse; font-size: 13px; margin-bottom: 2em; }
th, td { border-bottom: 1px solid #ddd; padding: 0.25em 0.6em; text-align: right; }
th { cursor: pointer; vertical-align: bottom; background: #f4f4f4; position: sticky; top: 0; }
td:first-child, th:first-child { text-align: left; }
tr.ours { font-weight: bold; }
small { color: #606060; font-weight: normal; }
img { max-width: 100%; }
"""
_SCRIPT: Final = """
for (const head of document.querySelectorAll("th")) head.addEventListener("click", () => {
  const table = head.closest("table"), body = table.tBodies[0], column = head.cellIndex;
  const down = head.dataset.down !== "1";
  head.dataset.down = down ? "1" : "0";
  const key = (row) => { const text = row.cells[column].dataset.value; return text === "" ? null : text; };
  const order = (a, b) => {
    const x = key(a), y = key(b);
    if (x === null || y === null) return (x === null) - (y === null);
    const numbers = !isNaN(x) && !isNaN(y);
    return (down ? 1 : -1) * (numbers ? x - y : x.localeCompare(y));
  };
  for (const row of [...body.rows].sort(order)) body.append(row);
});
"""
_OURS: Final = "guarded"
_CASE: Final = (
    "scene", "rate", "delay", "algorithm", "status", "certificate", "energy_given_out", "energy_beyond_device",
    "position_error", "force_variation", "stiffness_error", "rate_hardness", "limit_cycle", "drag",
)  # fmt: skip


def write_arena_page(found: Found, path: Path) -> None:
    """Writes an arena as one self-contained page.

    Raises:
        InputError: matplotlib is not installed, or the page cannot be written.
    """
    title = f"Arena: {len(found['algorithms'])} algorithms, {len(found['scenes'])} scenes"
    parts = [
        f"<h1>{html.escape(title)}</h1>",
        f"<p>{html.escape(_about(found))}</p>",
        "<p>A click on a heading sorts by it. In small print: the rank, 1 is best.</p>",
        _standings(found),
        *_pictures(found),
        "<h2>M-width of the rig</h2>" + _plain(found["m_width"]) if "m_width" in found else "",
        "<h2>Every case</h2>",
        _table(_CASE, [[case.get(key) for key in _CASE] for case in found["cases"]]),
        "<h2>Definitions</h2>",
        _table(
            ("figure", "what it is", "unit", "source"),
            [[name, one.what, one.unit, one.source] for name, one in FIELD_FIGURES.items()],
        ),
    ]
    text = (
        f'<!DOCTYPE html><html lang="en"><head><meta charset="utf-8"><title>{html.escape(title)}</title>'
        f"<style>{_STYLE}</style></head><body>{''.join(parts)}<script>{_SCRIPT}</script></body></html>"
    )
    try:
        with replacing(path) as page:
            page.write_text(text, encoding="utf-8")
    except OSError as error:
        raise InputError(f"{path}: the page cannot be written ({error.strerror}); name another --out") from error


def _about(found: Found) -> str:
    rates = ", ".join(f"{rate:g} Hz" for rate in found["rates"])
    delays = " and ".join("one sample late" if delay else "no delay" for delay in found["delays"])
    return (
        f"canhaptic {found['canhaptic']}, code {found['code'][:12]}. {len(found['cases'])} cases: {rates}; {delays}; "
        f"up to {found['longest']:g} s each. The simulated plant judges the energy."
    )


def _standings(found: Found) -> str:
    times = found.get("time_of_step", {})
    heads = ["algorithm", "cases", *(f"{c.what} [{c.unit}]" for c in COLUMNS.values()), "time of a step [us]"]
    rows, small = [], []
    for row in found["standings"]:
        name = row["algorithm"]
        rows.append([name, row["cases"], *(row[key] for key in COLUMNS), times.get(name)])
        small.append(["", "", *(found["ranks"][name].get(key, "") for key in COLUMNS), ""])
    return _table(heads, rows, small)


def _pictures(found: Found) -> list[str]:
    parts = []
    with TemporaryDirectory(prefix="canhaptic-arena-") as folder:
        for name, title, draw in pictures_of(found):
            picture = Path(folder) / name
            draw(found, picture)
            content = base64.b64encode(picture.read_bytes()).decode()
            parts.append(f'<h2>{title}</h2><img alt="{title}" src="data:image/png;base64,{content}">')
    return parts


def _plain(rows: Sequence[Mapping[str, object]]) -> str:
    heads = list(rows[0]) if rows else []
    return _table(heads, [[row[key] for key in heads] for row in rows])


def _table(heads: Sequence[str], rows: Sequence[Sequence[object]], small: Sequence[Sequence[object]] = ()) -> str:
    """Returns a table; its cells carry their plain values, by which they are sorted."""
    head = "".join(f"<th>{html.escape(text.replace('_', ' '))}</th>" for text in heads)
    lines = []
    for number, row in enumerate(rows):
        noted = small[number] if small else [""] * len(row)
        cells = "".join(_cell_of(value, note) for value, note in zip(row, noted, strict=True))
        ours = ' class="ours"' if small and row[0] == _OURS else ""
        lines.append(f"<tr{ours}>{cells}</tr>")
    return f"<table><thead><tr>{head}</tr></thead><tbody>{''.join(lines)}</tbody></table>"


def _cell_of(value: object, note: object) -> str:
    plain = "" if value is None else str(value)
    shown = f"{value:.4g}" if isinstance(value, float) else plain
    rank = f" <small>{note}</small>" if note != "" else ""
    return f'<td data-value="{html.escape(plain, quote=True)}">{html.escape(shown)}{rank}</td>'
