"""A study of the accuracy of an admittance display as a picture, and as a page with its table.

One row for each change of the scene: how far position and energy are from the ideal display, the mass that is felt, and
the energy that was given out.
"""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Final, NamedTuple

from canhaptic.axis_units import mass_unit
from canhaptic.errors import InputError
from canhaptic.lab.studies.accuracy.display_accuracy_table import (
    ChangeRow,
    DisplayStudy,
    display_accuracy_table,
    heading,
)
from canhaptic.view.html_page import picture, words, write_page
from canhaptic.view.palette import BLUE, GREEN, ORANGE, PURPLE, SKY, VERMILION
from canhaptic.view.picture_style import drawing, save_picture

_COLOURS: Final = {
    "the scene": "#000000", "rate": BLUE, "algorithm": GREEN, "sampling": ORANGE, "sensor": PURPLE, "encoder": SKY,
}  # fmt: skip
_LEAST: Final = 1e-12
"""Drawn for zero on an axis of powers of ten."""


class _Figure(NamedTuple):
    """One column of the picture."""

    title: str
    value: Callable[[ChangeRow], float]
    is_steep: bool


def _figures(unit: str) -> tuple[_Figure, ...]:
    return (
        _Figure(f"largest error of the position [{unit}]", lambda row: row["position_error"], True),
        _Figure("largest error of the energy [J]", lambda row: row["energy_error"], True),
        _Figure(f"mass felt [{mass_unit(unit)}]", lambda row: row["mass_felt"], False),
        _Figure("energy given out [J]", lambda row: max(0.0, row["given_out"]), False),
    )


def _drawn(result: DisplayStudy) -> list[ChangeRow]:
    """Return the rows that have figures.

    Raises:
        InputError: None has.
    """
    rows = [row for row in result["loop"] if "position_error" in row]
    if not rows:
        raise InputError("nothing was measured, there is nothing to draw")
    return rows


def _name(row: ChangeRow) -> str:
    ended = "" if row["status"] == "ok" else " (ended early)"
    return f"{row['changed']}: {row['to']}".rstrip(": ").replace("_", " ") + ended


def draw_display_accuracy(result: DisplayStudy, path: str | Path) -> None:
    """Draw a study into a file; its suffix says how (.png, .svg, .pdf).

    Raises:
        InputError: matplotlib is not installed, the file cannot be written, or nothing was measured.
    """
    rows, columns = _drawn(result), _figures(result["unit"])
    places = list(range(len(rows)))[::-1]
    with drawing() as figure_type:
        figure = figure_type(figsize=(14.5, 2.2 + 0.3 * len(rows)), dpi=110, layout="constrained")
        for panel, column in zip(figure.subplots(1, len(columns), sharey=True), columns, strict=True):
            values = [column.value(row) for row in rows]
            for place, row, value in zip(places, rows, values, strict=True):
                shown = max(value, _LEAST) if column.is_steep else value
                panel.plot([shown], [place], "o", color=_COLOURS.get(row["changed"], VERMILION), markersize=6.0)
            panel.set_xlabel(column.title)
            if column.is_steep:
                panel.set_xscale("log")
                panel.margins(x=0.15)
            elif not any(values):
                panel.set_xticks([0.0])
            if not math.isnan(values[0]):
                panel.axvline(max(values[0], _LEAST), color="black", linewidth=0.8, linestyle=":")
            panel.set_yticks(places, [_name(row) for row in rows], fontsize=8.5)
        figure.suptitle("\n".join(heading(result)), x=0.01, ha="left", fontsize=9.0, color="#404040")
        save_picture(figure, path)


def write_display_accuracy_page(result: DisplayStudy, path: Path) -> None:
    """Write a study as one self-contained page: the picture and the table.

    Raises:
        InputError: Nothing was measured, matplotlib is not installed, or the page cannot be written.
    """
    shown = picture(lambda file: draw_display_accuracy(result, file), "errors of the loop and of the plant")
    write_page(path, f"{result['scene']} - accuracy", [words(*heading(result)), shown, display_accuracy_table(result)])
