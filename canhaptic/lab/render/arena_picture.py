"""Pictures and page of `canhaptic arena`: stiffness over damping, impedance, energy given out, and sortable tables.

The line of `guarded` is thick and black in every picture.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal

import numpy as np

from canhaptic.lab.render import BLACK, MARKS, WHITE, sheet
from canhaptic.lab.studies import Row
from canhaptic.lab.studies.arena import COLUMNS
from canhaptic.quantities import ARENA, STANDING
from canhaptic.view.html_page import picture, words, write_page
from canhaptic.view.picture_style import BLUE, GREEN, GREY, ORANGE, PURPLE, SKY, VERMILION
from canhaptic.view.table import Cell, Styled, Table, shown

if TYPE_CHECKING:
    from matplotlib.axes import Axes


Found = Mapping[str, Any]
_COLOURS: Final = (BLUE, VERMILION, GREEN, ORANGE, PURPLE, SKY, GREY)
_THEORY: Final = {"C": ("--", "#404040"), "e": ("-.", "#404040"), "l": (":", "#000000")}
"""First letter of a theoretical border -> line style and colour: Colgate, eigenvalues, largest certificate."""
_OUR: Final = "guarded"
_PLAIN: Final = "unprotected"
_LEAST: Final = 1e-6
"""Least energy given out for which a cell is coloured [J]."""


def _draw_lines(
    found: Found, path: Path, part: str, x: tuple[str, str], labels: Mapping[str, str],
    compared: Callable[[Row], float], finish: Callable[["Axes", int, str], None], sharey: Literal["all", "row"],
) -> None:  # fmt: skip
    """Draw a line for each algorithm: a row of panels for each figure, a column for each delay.

    Args:
        found: Result of an arena.
        path: File of the picture.
        part: Key of the result with a row for each point.
        x: Key of the x axis, and its label.
        labels: Figure -> label of its y axis.
        compared: Function of a row, by whose mean the algorithms are compared.
        finish: Completes a panel: (panel, delay, figure).
        sharey: Panels with the same scale of the y axis.

    Raises:
        InputError: matplotlib is not installed, or the file cannot be written.
    """
    delays = sorted({row["delay"] for row in found[part]})
    with sheet(path, 5.3 * len(delays) + 2.6, 3.8 * len(labels)) as figure:
        panels = figure.subplots(len(labels), len(delays), sharex=True, sharey=sharey, squeeze=False)
        lines = _lines(found, part, compared)
        for (row, key), (column, delay) in product(enumerate(labels), enumerate(delays)):
            for name, line in lines.items():
                own = [of for of in found[part] if (of["algorithm"], of["delay"]) == (name, delay)]
                known = [np.nan if of[key] is None else of[key] for of in own]
                panels[row, column].plot([of[x[0]] for of in own], known, **line)
            finish(panels[row, column], delay, key)
        for first, label in zip(panels[:, 0], labels.values(), strict=True):
            first.set_ylabel(label)
        for top, bottom, delay in zip(panels[0], panels[-1], delays, strict=True):
            top.set_title("one sample late" if delay else "no delay", fontweight="bold")
            bottom.set_xlabel(x[1])
        figure.legend(*panels[0, 0].get_legend_handles_labels(), loc="outside right upper", fontsize=8.0)


def _draw_borders(found: Found, path: Path) -> None:
    """Draw the stiffest wall over its damping: passive, and also rendered within 5 %; see `_draw_lines`."""

    def finish(panel: "Axes", delay: int, key: str) -> None:
        for name, points in found["theory"][str(delay)].items():
            style, colour = _THEORY[name[0]]
            places = [p["damping"] for p in points], [p["stiffness"] for p in points]
            panel.plot(*places, linestyle=style, color=colour, linewidth=1.3, label=name)
        if key == "passive" and any(border["open"] and border["delay"] == delay for border in found["borders"]):
            most = max(border["passive"] for border in found["borders"])
            text = "passive up to the stiffest wall that was tried"
            panel.annotate(text, (0.0, most), xytext=(4, -12), textcoords="offset points", fontsize=7.0)
        panel.set_yscale("log", nonpositive="mask")  # 0: not even the least wall
        panel.set_xscale("symlog", linthresh=0.05)
        panel.set_xlim(left=-0.004)
        ticks = [d for d in sorted({b["damping"] for b in found["borders"]}) if d in (0.0, 0.1, 1.0, 10.0, 100.0)]
        panel.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
        panel.set_xticks([], minor=True)

    labels = {"passive": "stiffest wall that stays passive [N/m]", "near": "of these, rendered within 5 % [N/m]"}
    x = "damping", "damping of the wall [N*s/m]"
    _draw_lines(found, path, "borders", x, labels, lambda of: float(np.log(max(of["near"], 1.0))), finish, "all")


def _draw_impedance(found: Found, path: Path) -> None:
    """Draw magnitude and angle of the rendered over the requested impedance; see `_draw_lines`."""

    def finish(panel: "Axes", _delay: int, key: str) -> None:
        panel.axhline(1.0 if key == "size" else 0.0, color="#808080", linewidth=0.8)
        panel.set(xscale="log", yscale="log" if key == "size" else "linear")

    labels = {"size": "rendered / requested impedance", "angle": "angle to the requested one [rad]"}
    _draw_lines(found, path, "impedance", ("frequency", "frequency [Hz]"), labels, _size, finish, "row")


def _lines(found: Found, part: str, figure: Callable[[Row], float]) -> dict[str, Row]:
    """Return the style of each algorithm's line: those farthest from the median are coloured, the others grey.

    Args:
        found: Result of an arena.
        part: Key of the result with a row for each point.
        figure: Function of a row, by whose mean the algorithms are compared.
    """
    names = found["algorithms"]
    means = {name: float(np.mean([figure(row) for row in found[part] if row["algorithm"] == name])) for name in names}
    middle = float(np.median(list(means.values())))
    others = [name for name in names if name not in (_OUR, _PLAIN)]
    named = sorted(others, key=lambda name: -abs(means[name] - middle))[:3]
    rest = f"the other {len(others) - len(named)}"
    looks: dict[str, Row] = {}
    for name in sorted(names, key=lambda name: (name not in (*named, _PLAIN, _OUR), name != _OUR)):
        number = len(looks)
        if name == _OUR:
            looks[name] = {"color": "black", "linewidth": 2.6, "zorder": 5, "label": name}
        elif name in (*named, _PLAIN):
            mark = {"marker": MARKS[number], "markersize": 4.5, "fillstyle": "none", "zorder": 4}
            looks[name] = {**mark, "color": _COLOURS[number], "linewidth": 1.3, "label": name}
        else:
            looks[name] = {"color": "#B0B0B0", "linewidth": 0.9, "label": rest}
            rest = "_"  # one entry of the legend for all
    return looks


def _size(row: Row) -> float:
    """Return the deviation of an impedance from the request: octaves of its magnitude plus radians of its angle."""
    return 0.0 if row["size"] is None else abs(float(np.log2(row["size"]))) + abs(row["angle"])


def _draw_given_out(found: Found, path: Path) -> None:
    """Draw a cell for each algorithm and scene: the largest energy given out, and the number of such cases.

    Raises:
        InputError: matplotlib is not installed, or the file cannot be written.
    """
    names, scenes = found["algorithms"], found["scenes"]
    of_all = len(found["rates"]) * len(found["delays"])
    most = np.array([[_cell(found, name, scene, "most") for scene in scenes] for name in names])
    with sheet(path, 5.0 + 0.75 * len(scenes), 2.4 + 0.34 * len(names)) as figure:
        from matplotlib.colors import LogNorm

        panel = figure.subplots()
        norm = LogNorm(_LEAST, max(1e-5, float(np.nanmax(most, initial=1e-5))))
        drawn = panel.imshow(np.where(most > _LEAST, most, np.nan), norm=norm, cmap="magma_r", aspect="auto")
        for row, name in enumerate(names):
            for column, scene in enumerate(scenes):
                cases = _cell(found, name, scene, "cases")
                dark = cases > 0 and most[row, column] > 3e-3  # [J]
                text = "" if np.isnan(cases) else f"{cases:.0f}"
                colour = WHITE if dark else BLACK if most[row, column] > _LEAST else "black"
                panel.text(column, row, text, ha="center", va="center", color=colour)
        panel.set_xticks(range(len(scenes)), scenes, rotation=35, ha="right")
        panel.set_yticks(range(len(names)), names)
        panel.grid(visible=False)
        panel.set_title(f"cases of {of_all} that gave out\nenergy beyond the device", loc="left")
        figure.colorbar(drawn, ax=panel, label="the most of one case [J]")


def _cell(found: Found, name: str, scene: str, key: str) -> float:
    return float(found["given_out"].get(name, {}).get(scene, {}).get(key, np.nan))


def pictures_of(found: Found) -> Sequence[tuple[str, str, Callable[[Found, Path], None]]]:
    """Return (file name, title, drawing function) of every picture of an arena."""
    whole = [("arena_given_out.png", "Who gives out energy where", _draw_given_out)]
    if found.get("borders"):
        whole.insert(0, ("arena_kb.png", "Stiffness over damping", _draw_borders))
        whole.append(("arena_impedance.png", "Impedance", _draw_impedance))
    return whole


def write_arena_page(found: Found, path: Path) -> None:
    """Write an arena as one self-contained page.

    Raises:
        InputError: matplotlib is not installed, or the page cannot be written.
    """
    heads = [*dict.fromkeys(key for case in found["cases"] for key in case if key != "remark")]
    parts: list[str | Table] = [
        words(_about(found), "In brackets: the rank, 1 is best."),
        _standings(found),
        *(picture(partial(draw, found), title) for _, title, draw in pictures_of(found)),
        *([_plain(found["m_width"])] if "m_width" in found else ()),
        _table("Every case", heads, [[case.get(key) for key in heads] for case in found["cases"]]),
        _table(
            "Definitions",
            ("figure", "what it is", "unit", "source"),
            [[row.title, row.sentence, row.unit, row.source] for row in ARENA.values()],
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
    heads = ["algorithm", "cases", *(f"{STANDING[key].title} [{STANDING[key].unit}]" for key in COLUMNS)]
    heads.append(f"{ARENA['time of a step'].title} [us]")
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
