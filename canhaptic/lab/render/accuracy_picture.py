"""A study of accuracy as a picture and as a page: error against time, energy against evaluations, the loop as rows.

Pareto front ringed and joined; the tolerance as a dashed line; a method that is not stable is named in the legend.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

from canhaptic.errors import InputError
from canhaptic.lab.studies.accuracy.accuracy_choice import FLOOR
from canhaptic.lab.studies.accuracy.accuracy_table import Row, accuracy_tables, advice_lines, heading, part_of
from canhaptic.lab.studies.accuracy.advice import front
from canhaptic.lab.studies.accuracy.candidates import COMPILED, OURS
from canhaptic.view.html_page import picture, words, write_page
from canhaptic.view.palette import BLUE, GREEN, ORANGE, PALE, PURPLE, SKY, VERMILION
from canhaptic.view.picture_style import drawing, require_matplotlib, save_picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes


_STYLES: Final[dict[str, tuple[str, str]]] = {
    OURS: (GREEN, "o"),
    COMPILED: (GREEN, "*"),
    "semi-implicit Euler": (PALE, "v"),
    "implicit midpoint": (ORANGE, "s"),
    "RK4": (VERMILION, "^"),
    "LSODA, located": (BLUE, "D"),
    "MuJoCo Euler": (PURPLE, "P"),
    "MuJoCo RK4": (SKY, "X"),
}
_GROUPS: Final[dict[str, str]] = {
    "as it is": "#000000",
    "sample rate": BLUE,
    "RPDO": VERMILION,
    "algorithm": GREEN,
    "velocity": ORANGE,
    "torque step": PURPLE,
    "encoder count": SKY,
    "effect": PALE,
}


def draw_accuracy(result: Row, path: str | Path) -> None:
    """Draw a study into a file; its suffix says how (.png, .svg, .pdf).

    Raises:
        InputError: matplotlib is not installed, the file cannot be written, or nothing was measured.
    """
    require_matplotlib()
    if not result["plant"]:
        raise InputError("nothing was measured, there is nothing to draw")
    with drawing() as figure_type:
        loop = [row for row in result["loop"] if row["position_error"]]
        figure = figure_type(figsize=(14.5, max(6.4, 1.6 + 0.22 * len(loop))), dpi=110, layout="constrained")
        panels = figure.subplots(1, 3, width_ratios=(1.0, 1.0, 1.05))
        time = _price_of(result)
        _draw_ladder(panels[0], result, time[0], "position_error")
        panels[0].set_xlabel(time[1])
        panels[0].set_ylabel(f"largest error of the position [{result['unit']}]")
        _draw_ladder(panels[1], result, "evaluations_per_period", "energy_error")
        panels[1].set_xlabel("evaluations of the equations of motion per period")
        panels[1].set_ylabel("largest error of an energy [J]")
        _draw_loop(panels[2], loop, result)
        handles, labels = panels[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower left", ncols=5, fontsize=8.5)
        figure.suptitle(_caption(result), x=0.01, ha="left", fontsize=9.5, color="#404040")
        save_picture(figure, path)


def write_accuracy_page(result: Row, path: Path) -> None:
    """Write a study as one self-contained page: advice, picture, tables.

    Raises:
        InputError: matplotlib is not installed, the page cannot be written, or nothing was measured.
    """
    shown = picture(lambda file: draw_accuracy(result, file), "what accuracy costs")
    said = words(*advice_lines(result)), words(*heading(result))
    write_page(path, f"{result['scene']} - accuracy", [*said, shown, *accuracy_tables(result, wide=True)])


def _price_of(result: Row) -> tuple[str, str]:
    """Return the key and the name of the price to draw: time, or evaluations where nothing was timed."""
    if any(row.get("us_per_period") for row in result["plant"]):
        return "us_per_period", "wall time per period [us], least of interleaved repeats"
    return "evaluations_per_period", "evaluations of the equations of motion per period"


def _caption(result: Row) -> str:
    witness = result["reference"]["witness"]
    apart = "" if witness is None else f", LSODA at 1e-9 is {witness['apart']:.1e} {result['unit']} away from it"
    return (
        f"{result['scene']}, {part_of(result)}: {result['holds']} periods at {result['rate']:g} Hz;   "
        f"reference: {result['reference']['method']}{apart}"
    )


def _draw_ladder(panel: "Axes", result: Row, price: str, error: str) -> None:
    rows = [row for row in result["plant"] if row.get(price) is not None]
    stable = [row for row in rows if row["status"] == "ok"]
    floor = FLOOR * result["reference"]["travel" if error == "position_error" else "energy"]
    for method in dict.fromkeys(row["method"] for row in result["plant"]):
        colour, marker = _STYLES[method]
        lines = _lines([row for row in stable if row["method"] == method])
        lost = sum(row["method"] == method and row["status"] != "ok" for row in result["plant"])
        label = f"{method} ({lost} unstable)" if lost else method
        for number, own in enumerate(lines or [[]]):
            panel.plot(
                [row[price] for row in own], [max(row[error], floor) for row in own], marker=marker, color=colour,
                label="_" * bool(number) + label, markersize=6.0, linewidth=1.0, alpha=0.85,
            )  # fmt: skip
    edge = sorted(front([(row[price], max(row[error], floor)) for row in stable]))
    panel.plot(
        [x for x, _ in edge], [y for _, y in edge], color="black", linewidth=0.9, linestyle=(0, (4, 2)), marker="o",
        markersize=11.0, markerfacecolor="none", markeredgecolor="black", label="Pareto front", zorder=1.5,
    )  # fmt: skip
    if error == "position_error":
        panel.axhline(result["tolerance"], color="#CC0000", linewidth=1.0, linestyle=":", label="tolerance")
    panel.set_xscale("log")
    panel.set_yscale("log")
    panel.margins(0.08)


def _lines(own: Sequence[Row]) -> list[list[Row]]:
    """Return the rows of one method as lines along which one thing changes: for ours substeps, else event bits."""
    if not own or own[0]["accuracy"] is None or len({row["accuracy"]["substeps"] for row in own}) < 2:
        return [list(own)] if own else []
    bits = sorted({row["accuracy"]["event_bits"] for row in own})
    return [[row for row in own if row["accuracy"]["event_bits"] == b] for b in bits]


def _draw_loop(panel: "Axes", loop: Sequence[Row], result: Row) -> None:
    """Draw one row per variant: position error, with its price in words."""
    places = list(range(len(loop)))[::-1]
    for place, row in zip(places, loop, strict=True):
        colour = _GROUPS[row["group"]]
        panel.plot([row["position_error"]], [place], "o", color=colour, markersize=6.0)
        panel.plot([row["energy_error"]], [place], "|", color=colour, markersize=9.0, markeredgewidth=1.6)
    base = next((row for row in loop if row["is_scene"]), None)
    if base is not None:
        panel.axvline(base["position_error"], color="black", linewidth=0.8, linestyle=":")
    panel.set_yticks(places, [f"{row['group']}: {row['setting'].replace('_', ' ')}" for row in loop], fontsize=8.0)
    for label, row in zip(panel.get_yticklabels(), loop, strict=True):
        label.set_color(_GROUPS[row["group"]])
    panel.set_xscale("log")
    panel.set_ylim(-0.8, len(loop) + 0.2)
    panel.grid(axis="y", visible=False)
    panel.set_xlabel(f"from the continuous axis:  o position [{result['unit']}],  | energy [J]")
    across = panel.get_yaxis_transform()
    panel.text(1.02, len(loop) - 0.1, "control, bus load", transform=across, fontsize=8.0, va="center", color="#404040")
    for place, row in zip(places, loop, strict=True):
        thread = row.get("control_thread_us")
        words = [] if thread is None else [f"{thread:.0f} us"]
        words.append(f"{100.0 * row['bus_load']:.0f} %" + ("" if row["bus_fits"] else " !"))
        panel.text(1.02, place, ", ".join(words), transform=across, fontsize=8.0, va="center", color="#404040")
