"""The first row of a map: the stiffest wall that is passive and rendered near, all algorithms in one panel with theory.

Passive is meant of the display, what the device dissipates counted, and of the hand of the scene, at its worst over
every key that is not drawn.
"""

from typing import Final

import numpy as np

from canhaptic.lab.figures.field_figures import NEAR
from canhaptic.lab.loop.axis_loop import Array
from canhaptic.lab.studies.map.field import MapField
from canhaptic.lab.studies.map.panel import CurveStyle, Lines, PanelCurve, is_log, positive
from canhaptic.lab.studies.map.theory import Theory, theory_at
from canhaptic.lab.studies.map.z_width import JUDGEMENTS, SHARE, border_of, common_judgement

_OURS: Final = "guarded"
_MOST_PANELS: Final = 3
_OF_PLAIN_WALL: Final[dict[CurveStyle, str]] = {
    "colgate": "Colgate, plain wall",
    "abbott_okamura": "Abbott-Okamura, plain wall",
    "eigenvalues": "eigenvalues, plain wall",
}


def headline(fields: list[MapField], z: str, x: str, y: str | None) -> list[Lines]:
    """Return one panel for each value of y, of many the least, middle and largest; none where shares are not known.

    Args:
        fields: One an algorithm, of one grid.
        z: Key of the stiffness.
        x: Across.
        y: Another key; None where there is none.
    """
    if not all(one.has(SHARE) and common_judgement(one) != "margin" for one in fields):
        return []
    levels: list[float | None] = [None] if y is None else [*sorted(fields[0].values[y].tolist())]
    if len(levels) > _MOST_PANELS:
        levels = [levels[0], levels[len(levels) // 2], levels[-1]]
    return [_panel(fields, z, x, {} if level is None or y is None else {y: level}) for level in levels]


def _panel(fields: list[MapField], z: str, x: str, at: dict[str, float]) -> Lines:
    field = fields[0]
    order = np.argsort(field.values[x])
    places = field.values[x][order]
    curves: list[PanelCurve] = []
    for number, one in enumerate(fields):
        border = border_of(one, z, [x, *at], common_judgement(one), near=True).value[order]
        for key, level in at.items():
            border = border[:, int(np.flatnonzero(one.values[key] == level)[0])]
        style: CurveStyle = "ours" if one.algorithm == _OURS else "measured"
        curves.append(PanelCurve(one.algorithm, places, positive(border), style, number))
    curves += _theory(fields, x, places, at)
    where = "".join(f", {field.level(key, value)}" for key, value in at.items())
    note = f"{JUDGEMENTS[common_judgement(field)]}; worst of all else; no line: no wall tried passes"
    shown = tuple(curve for curve in curves if np.isfinite(curve.y).any())
    title = f"stiffest wall that is passive and within {100.0 * NEAR:g} %{where}"
    return Lines(title, field.label(x), field.label(z), shown, is_log(places), is_log(field.values[z]), note)


def _theory(fields: list[MapField], x: str, places: Array, at: dict[str, float]) -> list[PanelCurve]:
    """Return the lines of theory: of the plain wall, and what the certificates of `guarded` hold."""
    plain = next((one for one in fields if one.algorithm == "unprotected"), fields[0])
    found = [theory_at(plain, {**at, x: float(place)}) for place in places]
    lines = [PanelCurve(label, places, _column(found, name), name) for name, label in _OF_PLAIN_WALL.items()]
    ours = next((one for one in fields if one.algorithm == _OURS), None)
    if ours is not None:
        found = [theory_at(ours, {**at, x: float(place)}) for place in places]
        lines.append(PanelCurve("largest certificate of guarded", places, _column(found, "certificate"), "certificate"))
    return lines


def _column(found: list[Theory], name: str) -> Array:
    values = [getattr(one, name) for one in found]
    return positive(np.array([np.nan if value is None else value for value in values]))
