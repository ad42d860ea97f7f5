"""An arena as one page that any browser opens without a network: its pictures, and sortable tables."""

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Final

from canhaptic.lab.figures.field_figures import FIELD_FIGURES
from canhaptic.lab.render.arena_picture import Found, pictures_of
from canhaptic.lab.studies.arena import COLUMNS
from canhaptic.view.html_page import picture, words, write_page
from canhaptic.view.table import Cell, Styled, Table, shown

_CASE: Final = (
    "scene", "rate", "delay", "algorithm", "status", "certificate", "energy_given_out", "energy_beyond_device",
    "position_error", "force_variation", "stiffness_error", "rate_hardness", "limit_cycle", "drag",
)  # fmt: skip


def write_arena_page(found: Found, path: Path) -> None:
    """Write an arena as one self-contained page.

    Raises:
        InputError: matplotlib is not installed, or the page cannot be written.
    """
    parts: list[str | Table] = [
        words(_about(found), "In brackets: the rank, 1 is best."),
        _standings(found),
        *(picture(partial(draw, found), title) for _, title, draw in pictures_of(found)),
        *([_plain(found["m_width"])] if "m_width" in found else ()),
        _table("Every case", _CASE, [[case.get(key) for key in _CASE] for case in found["cases"]]),
        _table(
            "Definitions",
            ("figure", "what it is", "unit", "source"),
            [[name, one.what, one.unit, one.source] for name, one in FIELD_FIGURES.items()],
        ),
    ]
    write_page(path, f"Arena: {len(found['algorithms'])} algorithms, {len(found['scenes'])} scenes", parts)


def _about(found: Found) -> str:
    rates = ", ".join(f"{rate:g} Hz" for rate in found["rates"])
    delays = " and ".join("one sample late" if delay else "no delay" for delay in found["delays"])
    return (
        f"canhaptic {found['canhaptic']}, code {found['code'][:12]}. {len(found['cases'])} cases: {rates}; {delays}; "
        f"up to {found['longest']:g} s each. The simulated plant judges the energy."
    )


def _standings(found: Found) -> Table:
    times = found.get("time_of_step", {})
    heads = ["algorithm", "cases", *(f"{c.what} [{c.unit}]" for c in COLUMNS.values()), "time of a step [us]"]
    rows = [_standing(row, found["ranks"][row["algorithm"]], times) for row in found["standings"]]
    return _table("Standings", heads, rows)


def _standing(row: Mapping[str, Any], ranks: Mapping[str, int], times: Mapping[str, float]) -> list[Cell]:
    name = row["algorithm"]
    figures = (row[key] if None in (row[key], ranks.get(key)) else f"{row[key]:.4g} ({ranks[key]})" for key in COLUMNS)
    cells = [name, row["cases"], *figures, times.get(name)]
    return [Styled(shown(cell), "bold") for cell in cells] if name == "guarded" else cells


def _plain(rows: Sequence[Mapping[str, Any]]) -> Table:
    heads = list(rows[0]) if rows else []
    return _table("M-width of the rig", heads, [[row[key] for key in heads] for row in rows])


def _table(title: str, heads: Sequence[str], rows: Sequence[Sequence[Cell]]) -> Table:
    return Table(title, [head.replace("_", " ") for head in heads], rows, keys=1)
