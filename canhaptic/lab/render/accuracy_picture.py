"""Picture and page of `canhaptic accuracy`.

For an impedance axis: error against computing time for each method of the plant, with the Pareto front ringed and the
tolerance as a dotted line, and a row for each changed setting of the loop. For an admittance display: a row for each
changed setting, with the errors against the ideal display, the mass felt and the energy given out.
"""

import math
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

from canhaptic.axis_units import mass_unit
from canhaptic.errors import InputError
from canhaptic.files import scene_title
from canhaptic.lab.render import sheet
from canhaptic.lab.studies import Row
from canhaptic.lab.studies.accuracy import accuracy_table
from canhaptic.lab.studies.accuracy.accuracy_table import display_accuracy_table, display_heading
from canhaptic.lab.studies.accuracy.plant_solvers import FLOOR, OURS
from canhaptic.view.html_page import picture, words, write_page
from canhaptic.view.picture_style import BLUE, GREEN, ORANGE, PALE, PURPLE, SKY, VERMILION

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_STYLES: Final[dict[str, tuple[str, str]]] = {
    OURS: (GREEN, "o"),
    "semi-implicit Euler": (PALE, "v"),
    "implicit midpoint": (ORANGE, "s"),
    "RK4": (VERMILION, "^"),
    "LSODA, located": (BLUE, "D"),
}
_NOTHING: Final = "nothing was measured, so there is nothing to draw; run the study for longer"
_WORK: Final = "evaluations_per_period"
_PRICES: Final = {
    "us_per_period": "wall time per period [us], least of interleaved repeats",
    _WORK: "evaluations of the equations of motion per period",
}
_COLOURS: Final[dict[str, str]] = {
    **dict.fromkeys(("as it is", "the scene"), "#000000"),
    **dict.fromkeys(("sample rate", "rate"), BLUE),
    "RPDO": VERMILION,
    "algorithm": GREEN,
    **dict.fromkeys(("velocity", "sampling"), ORANGE),
    **dict.fromkeys(("torque step", "sensor"), PURPLE),
    **dict.fromkeys(("encoder count", "encoder"), SKY),
    "effect": PALE,
}
"""Kind of a changed setting, of the loop of an axis or of an admittance display -> its colour."""


def draw_accuracy(result: Row, path: str | Path) -> None:
    """Draw a study into a file; its suffix gives the format (.png, .svg, .pdf).

    Raises:
        InputError: matplotlib is not installed, the file cannot be written, or nothing was measured.
    """
    if accuracy_table.is_of_display(result):
        _draw_display(result, path)
        return
    if not result["plant"]:
        raise InputError(_NOTHING)
    base = accuracy_table.base_loop(result)
    felt = base is None or base["largest_torque"] > 0.0
    loop = [row for row in result["loop"] if row["position_error"]] if felt else []
    effects = [row for row in (result["advice"] or {"effects": ()})["effects"] if row.get("position_error")]
    widths = [1.0, 1.0, *([1.05] if loop else []), *([0.6] if effects else [])]
    with sheet(path, 4.8 * sum(widths), max(6.4, 1.6 + 0.22 * len(loop)), _caption(result)) as figure:
        panels = figure.subplots(1, len(widths), width_ratios=widths)
        price = next(price for price in _PRICES if any(row.get(price) for row in result["plant"]) or price == _WORK)
        _draw_ladder(panels[0], result, price, "position_error")
        panels[0].set_title("plant: error against time, by method", fontweight="bold")
        panels[0].set_ylabel(f"largest error of the position [{result['unit']}]")
        _draw_ladder(panels[1], result, _WORK, "energy_error")
        panels[1].set_title("energy: error against work", fontweight="bold")
        panels[1].set_ylabel("largest error of an energy [J]")
        if loop:
            _draw_loop(panels[2], loop, result)
        if effects:
            _draw_effects(panels[-1], effects, result)
        figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower left", ncols=5, fontsize=8.5)


def write_accuracy_page(result: Row, path: Path) -> None:
    """Write a study as one self-contained page: advice, picture, tables.

    Raises:
        InputError: matplotlib is not installed, the page cannot be written, or nothing was measured.
    """
    title, shown = (
        f"{scene_title(result['scene'])} - accuracy",
        picture(lambda file: draw_accuracy(result, file), "accuracy"),
    )
    if accuracy_table.is_of_display(result):
        write_page(path, title, [words(*display_heading(result)), shown, display_accuracy_table(result)])
        return
    prices = [line.replace("\t", ": ") for line in accuracy_table.price_lines(result)]
    said = words(*accuracy_table.advice_lines(result)), words(*prices), words(*accuracy_table.heading(result))
    write_page(path, title, [*said, shown, *accuracy_table.accuracy_tables(result, wide=True)])


def _caption(result: Row) -> str:
    witness = result["reference"]["witness"]
    apart = "" if witness is None else f", LSODA at 1e-9 is {witness['apart']:.1e} {result['unit']} away from it"
    return (
        f"{scene_title(result['scene'])}, {accuracy_table.part_of(result)}: "
        f"{result['holds']} periods at {result['rate']:g} Hz;   reference: {result['reference']['method']}{apart}"
    )


def _draw_ladder(panel: "Axes", result: Row, price: str, error: str) -> None:
    rows = [row for row in result["plant"] if row.get(price) is not None]
    stable = [row for row in rows if row["status"] == "ok"]
    floor = FLOOR * result["reference"]["travel" if error == "position_error" else "energy"]
    for method in dict.fromkeys(row["method"] for row in result["plant"]):
        colour, marker = _STYLES[method]
        lines = _lines([row for row in stable if row["method"] == method])
        ends = (row["status"].partition(":")[0] for row in result["plant"] if row["method"] == method)
        lost = ", ".join(f"{number} {status}" for status, number in Counter(ends).items() if status != "ok")
        label = f"{method} ({lost})" if lost else method
        for number, own in enumerate(lines or [[]]):
            panel.plot(
                [row[price] for row in own], [max(row[error], floor) for row in own], marker=marker, color=colour,
                label="_" * bool(number) + label, markersize=6.0, linewidth=1.0, alpha=0.85,
            )  # fmt: skip
    edge = sorted(accuracy_table.front([(row[price], max(row[error], floor)) for row in stable]))
    panel.plot(
        [x for x, _ in edge], [y for _, y in edge], color="black", linewidth=0.9, linestyle=(0, (4, 2)), marker="o",
        markersize=11.0, markerfacecolor="none", markeredgecolor="black", label="Pareto front", zorder=1.5,
    )  # fmt: skip
    if error == "position_error":
        panel.axhline(result["tolerance"], color="#CC0000", linewidth=1.0, linestyle=":", label="tolerance")
    panel.set(xscale="log", yscale="log", xlabel=_PRICES[price])
    panel.margins(0.08)


def _lines(own: Sequence[Row]) -> list[list[Row]]:
    """Return the rows of one method as lines to draw; the package's own solver has a line per number of event bits."""
    if not own or own[0]["accuracy"] is None or len({row["accuracy"]["substeps"] for row in own}) < 2:
        return [list(own)] if own else []
    bits = sorted({row["accuracy"]["event_bits"] for row in own})
    return [[row for row in own if row["accuracy"]["event_bits"] == b] for b in bits]


def _draw_rows(
    panel: "Axes", names: Sequence[str], colours: Sequence[str], values: Sequence[float], mark: str = "o"
) -> None:
    """Draw a row with a mark for each name, from top to bottom."""
    look: Row = {"markersize": 6.0} if mark == "o" else {"markersize": 9.0, "markeredgewidth": 1.6}
    for place, (colour, value) in enumerate(zip(colours, values, strict=True)):
        panel.plot([value], [place], mark, color=colour, **look)
    panel.set_yticks(range(len(names)), names, fontsize=8.0)
    panel.set_ylim(len(names) - 0.2, -0.8)


def _draw_loop(panel: "Axes", loop: Sequence[Row], result: Row) -> None:
    """Draw a row for each changed setting: position and energy error, computing time, bus load."""
    names = [f"{row['group']}: {row['setting'].replace('_', ' ')}" for row in loop]
    colours = [_COLOURS[row["group"]] for row in loop]
    _draw_rows(panel, names, colours, [row["position_error"] for row in loop])
    _draw_rows(panel, names, colours, [row["energy_error"] for row in loop], "|")
    base = next((row for row in loop if row["is_scene"]), None)
    if base is not None:
        panel.axvline(base["position_error"], color="black", linewidth=0.8, linestyle=":")
    for label, colour in zip(panel.get_yticklabels(), colours, strict=True):
        label.set_color(colour)
    panel.grid(axis="y", visible=False)
    panel.set_title("loop: one setting changed", fontweight="bold")
    panel.set_xlabel(f"error against the continuous axis:  o position [{result['unit']}],  | energy [J]")
    panel.set_xscale("log")
    _write_right(panel, -0.9, "control, bus load")
    for place, row in enumerate(loop):
        thread = row.get("control_thread_us")
        words = [] if thread is None else [f"{thread:.0f} us"]
        words.append(accuracy_table.bus_load(row, "") + ("" if row["bus_fits"] else " !"))
        _write_right(panel, place, ", ".join(filter(None, words)))


def _write_right(panel: "Axes", place: float, text: str) -> None:
    panel.text(
        1.02, place, text, transform=panel.get_yaxis_transform(), fontsize=8.0, va="center", color="#404040"
    )  # fmt: skip


def _draw_effects(panel: "Axes", effects: Sequence[Row], result: Row) -> None:
    """Draw a row for each simulated effect: the error if it is left out, and the computing time saved."""
    names = [row["effect"].replace("_", " ") for row in effects]
    _draw_rows(panel, names, [VERMILION] * len(names), [row["position_error"] for row in effects])
    for place, row in enumerate(effects):
        saved = row["us_saved_per_period"]
        price = f"{row['evaluations_saved_per_period']:.3g} evaluations" if saved is None else f"{saved:.3g} us"
        _write_right(panel, place, f"saves {price}")
    panel.axvline(result["tolerance"], color="#CC0000", linewidth=1.0, linestyle=":")
    panel.set(xscale="log", xlabel=f"error without it [{result['unit']}]")
    panel.margins(x=0.15)
    panel.grid(axis="y", visible=False)
    panel.set_title("an effect left out", fontweight="bold")


_LEAST: Final = 1e-12
"""Value drawn for zero on a logarithmic axis."""


def _name(row: Row) -> str:
    ended = "" if row["status"] == "ok" else " (ended early)"
    return f"{row['changed']}: {row['to']}".rstrip(": ").replace("_", " ") + ended


def _draw_display(result: Row, path: str | Path) -> None:
    """Draw the study of an admittance display; errors as for `draw_accuracy`."""
    unit, rows = result["unit"], [row for row in result["loop"] if "position_error" in row]
    columns: list[tuple[str, bool, list[float]]] = [  # title, whether on a logarithmic scale
        (f"largest error of the position [{unit}]", True, [max(row["position_error"], _LEAST) for row in rows]),
        ("largest error of the energy [J]", True, [max(row["energy_error"], _LEAST) for row in rows]),
        (f"mass felt [{mass_unit(unit)}]", False, [row["mass_felt"] for row in rows]),
        ("energy given out [J]", False, [max(0.0, row["given_out"]) for row in rows]),
    ]
    names, colours = [_name(row) for row in rows], [_COLOURS.get(row["changed"], VERMILION) for row in rows]
    if not rows:
        raise InputError(_NOTHING)
    with sheet(path, 14.5, 2.2 + 0.3 * len(rows), "\n".join(display_heading(result))) as figure:
        for panel, (title, is_log, values) in zip(figure.subplots(1, len(columns), sharey=True), columns, strict=True):
            _draw_rows(panel, names, colours, values)
            panel.set_xlabel(title)
            if is_log:
                panel.set_xscale("log")
                panel.margins(x=0.15)
            elif not any(values):
                panel.set_xticks([0.0])
            if not math.isnan(values[0]):
                panel.axvline(max(values[0], _LEAST), color="black", linewidth=0.8, linestyle=":")
