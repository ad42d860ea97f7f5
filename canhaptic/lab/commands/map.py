"""`canhaptic sweep --map FOLDER`: the largest wall stiffness, its rendered share, and borders from theory."""

import argparse
from math import isnan
from typing import Final

from canhaptic.files import scene_title
from canhaptic.lab.commands.results import check_files, write_files
from canhaptic.lab.render.map_picture import draw_map, write_map
from canhaptic.lab.studies.chunk import REFUSED, UNRENDERED, UNTOUCHED
from canhaptic.lab.studies.map import (
    JUDGEMENTS,
    Chosen,
    Lines,
    Panel,
    fields_of,
    panels_of,
    passing_share,
    usual_judgement,
)
from canhaptic.lab.studies.store import SweepTable
from canhaptic.view.terminal import write_json, write_line, write_note

_WALLS: Final = (
    " only the walls of this sweep, with the scene's hand, no reserve; `design` searches further, with a reserve;\n"
    " `check` gives the limits for any hand within your declarations"
)


def execute(arguments: argparse.Namespace) -> int:
    """Draw the maps and print the border; return 0.

    Raises:
        InputError: A file, key, figure or picture cannot be used.
    """
    check_files(arguments)
    with SweepTable(arguments.file) as table:
        fields = fields_of(table, arguments.axis, allow_code=arguments.allow_code)
        chosen = Chosen(arguments.x, arguments.y, arguments.metric, arguments.by)
        columns = panels_of(fields, chosen)
        caption = (
            f"{scene_title(table.note('source'))}   {'  '.join(entry['given'] for entry in table.identity['varied'])}"
        )
        for line in table.note("plant_errors").splitlines():
            write_note(f"  {line}")
        by = {one.algorithm: arguments.by or usual_judgement(one) for one in fields}
        remarks = [] if fields[0].is_display else [_WALLS]
        shares = {one.algorithm: passing_share(one, by[one.algorithm]) for one in fields}
        ran = {one.algorithm: max(1, int((~one.has_status(REFUSED)).sum())) for one in fields}
        left_out = {
            key: {one.algorithm: float(one.has_status(number).sum() / ran[one.algorithm]) for one in fields}
            for key, number in (("no_contact", UNTOUCHED), ("nothing_rendered", UNRENDERED))
        }
    if arguments.json:
        write_json({"file": str(arguments.file), "passing": shares, **left_out, "lines": _lines(columns)})
    else:
        parts = {name: [of[name] for of in left_out.values()] for name in shares}
        _print(columns, [*(_share(name, share, by[name], *parts[name]) for name, share in shares.items()), *remarks])
    write_files(
        arguments, png=lambda path: draw_map(columns, caption, path),
        html=lambda path: write_map(columns, caption, path),
    )  # fmt: skip
    return 0


def _lines(columns: list[list[Panel | None]]) -> list[dict[str, object]]:
    """Return every drawn line as plain values."""
    return [
        {"panel": panel.title, "line": line.label, "x": panel.x_label, "y": panel.y_label,
         "values": [[float(x), float(y)] for x, y in zip(line.x, line.y, strict=True)]}
        for column in columns for panel in column if isinstance(panel, Lines) for line in panel.lines
    ]  # fmt: skip


def _share(name: str, share: float, by: str, untouched: float, unrendered: float) -> str:
    passed = f"{100.0 * share:.3g} % of the scenes with a contact pass (judged by: {by}; {JUDGEMENTS[by].words})"
    words = [passed] if untouched < 1.0 else []
    words += [f"{100.0 * unrendered:.3g} % rendered nothing"] if unrendered else []
    words += [f"{100.0 * untouched:.3g} % had no contact"] if untouched else []
    return f" {name}: {', '.join(words)}"


def _value(value: float, floor: float | None) -> str:
    if isnan(value):
        return "none"
    return f"{'<= ' * bool(value == floor)}{value:.4g}"


def _print(columns: list[list[Panel | None]], first: list[str]) -> None:
    write_line("\n".join(first))
    for column in columns:
        for panel in column:
            if isinstance(panel, Lines):
                write_line(f" {panel.title}\n   {panel.note}\n   {panel.y_label} at each {panel.x_label}:")
                for line in panel.lines:
                    points = "  ".join(
                        f"{x:.4g}: {_value(y, panel.floor)}" for x, y in zip(line.x, line.y, strict=True)
                    )
                    write_line(f"   {line.label:<28} {points}")
