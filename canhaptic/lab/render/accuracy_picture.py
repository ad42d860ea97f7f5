"""Picture and page of `canhaptic accuracy`.

Error against computing time for each method of the plant, with the Pareto front ringed and the tolerance as a dotted
line; a row for each changed setting of the loop, with its errors and what else is known of it; a row for each effect
that was left out. A study draws those of them that it has.
"""

from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

from canhaptic.errors import InputError
from canhaptic.files import scene_title
from canhaptic.lab.render import sheet
from canhaptic.lab.studies import Row
from canhaptic.lab.studies.accuracy import accuracy_table
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
_Draw = Callable[["Axes", Sequence[Row], Row], None]
"""Draws rows of a result into a panel: (panel, rows, result)."""
_WORK: Final = "evaluations_per_period"
_PRICES: Final = {
    "us_per_period": "processor time per period [us], least of interleaved repeats",
    _WORK: "evaluations of the equations of motion per period",
}
_COLOURS: Final[dict[str, str]] = {
    "as it is": "#000000",
    "sample rate": BLUE,
    "RPDO": VERMILION,
    "algorithm": GREEN,
    **dict.fromkeys(("velocity", "sampling"), ORANGE),
    **dict.fromkeys(("torque step", "sensor"), PURPLE),
    "encoder count": SKY,
    "effect": PALE,
}
"""Kind of a changed setting, of the loop of an axis or of an admittance display -> its colour."""


def draw_accuracy(result: Row, path: str | Path) -> None:
    """Draw a study into a file; its suffix gives the format (.png, .svg, .pdf).

    Raises:
        InputError: matplotlib is not installed, the file cannot be written, or nothing was measured.
    """
    base = accuracy_table.base_loop(result)
    felt = base is None or base.get("largest_torque") != 0.0
    loop = [row for row in result["loop"] if row.get("position_error")] if felt else []
    plant = [row for row in result["plant"] if "method" in row]
    effects = [row for row in accuracy_table.effects_of(result) if row.get("position_error")]
    parts: list[tuple[float, Sequence[Row], _Draw]] = [  # width, rows, what draws them
        (1.0, plant, _draw_positions), (1.0, plant, _draw_energies), (1.05, loop, _draw_loop),
        (0.6, effects, _draw_effects),
    ]  # fmt: skip
    drawn = [part for part in parts if part[1]]
    if not drawn:
        raise InputError("nothing was measured, so there is nothing to draw; run the study for longer")
    widths = [width for width, _, _ in drawn]
    caption = "\n".join(accuracy_table.heading(result)[:2])
    with sheet(path, max(7.0, 4.8 * sum(widths)), max(6.4, 1.6 + 0.22 * len(loop)), caption) as figure:
        panels = figure.subplots(1, len(widths), width_ratios=widths, squeeze=False)[0]
        for panel, (_, rows, draw) in zip(panels, drawn, strict=True):
            draw(panel, rows, result)
        handles, labels = panels[0].get_legend_handles_labels()
        if labels:
            figure.legend(handles, labels, loc="outside lower left", ncols=5, fontsize=8.5)


def write_accuracy_page(result: Row, path: Path) -> None:
    """Write a study as one self-contained page: advice, picture, tables.

    Raises:
        InputError: matplotlib is not installed, the page cannot be written, or nothing was measured.
    """
    said = (words(*map(accuracy_table.plain, lines)) for lines in accuracy_table.sections(result).values())
    shown = picture(lambda file: draw_accuracy(result, file), "accuracy")
    title = f"{scene_title(result['scene'])} - accuracy"
    write_page(path, title, [*said, shown, *accuracy_table.accuracy_tables(result, wide=True)])


def _draw_positions(panel: "Axes", rows: Sequence[Row], result: Row) -> None:
    price = next(price for price in _PRICES if any(row.get(price) for row in rows) or price == _WORK)
    _draw_ladder(panel, result, price, "position_error")
    panel.set_title("plant: error against time, by method", fontweight="bold")
    panel.set_ylabel(f"largest error of the position [{result['unit']}]")


def _draw_energies(panel: "Axes", _rows: Sequence[Row], result: Row) -> None:
    _draw_ladder(panel, result, _WORK, "energy_error")
    panel.set_title("energy: error against work", fontweight="bold")
    panel.set_ylabel("largest error of an energy [J]")


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
    """Draw a row for each changed setting: the errors of position and energy, and other columns as text."""
    names = [": ".join(filter(None, accuracy_table.change(row))).replace("_", " ") for row in loop]
    colours = [_COLOURS[accuracy_table.change(row)[0]] for row in loop]
    _draw_rows(panel, names, colours, [row["position_error"] for row in loop])
    _draw_rows(panel, names, colours, [row["energy_error"] for row in loop], "|")
    if (base := accuracy_table.base_loop(result)) is not None:
        panel.axvline(base["position_error"], color="black", linewidth=0.8, linestyle=":")
    for label, colour in zip(panel.get_yticklabels(), colours, strict=True):
        label.set_color(colour)
    panel.grid(axis="y", visible=False)
    panel.set_title("loop: one setting changed", fontweight="bold")
    panel.set_xlabel(f"largest error:  o position [{result['unit']}],  | energy [J]")
    panel.set_xscale("log")
    head, texts = accuracy_table.beside_errors(loop, result["unit"])
    for place, text in ((-0.9, head), *enumerate(texts)):
        _write_right(panel, place, text)


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
