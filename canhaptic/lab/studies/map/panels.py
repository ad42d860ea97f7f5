"""Which panels a map has: chosen by what was varied and asked for, filled from the figures of a sweep."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from canhaptic.errors import InputError
from canhaptic.lab.loop.axis_loop import Array
from canhaptic.lab.studies.map.field import MapField
from canhaptic.lab.studies.map.headline import headline
from canhaptic.lab.studies.map.panel import Cells, Lines, Panel, PanelCurve, is_log, positive
from canhaptic.lab.studies.map.theory import theory_at
from canhaptic.lab.studies.map.z_width import JUDGEMENTS, border_of, usual_judgement

_STIFFNESS: Final = "environment.stiffness"
_MASS: Final = "environment.mass"
_OF_DISPLAYS: Final = ("mass_felt.share", "least_interaction", "guard_acts")
_PREFERRED: Final = ("bus.rate", "environment.damping")
_MOST_LINES: Final = 5
_LEAST_ENERGY: Final = 1e-6  # [J]
_ERROR: Final = "position_error.rms"


@dataclass(frozen=True, slots=True)
class Chosen:
    """Which keys and figure a map is of; None: chosen by what was varied."""

    x: str | None = None
    y: str | None = None
    metric: str | None = None
    judgement: str | None = None


def panels_of(fields: list[MapField], chosen: Chosen) -> list[list[Panel | None]]:
    """Return the panels of a map, by columns: all algorithms together on top, then one column per algorithm.

    Raises:
        InputError: A key that was not varied or a figure that was not asked for.
    """
    _check(fields[0], chosen)
    if chosen.metric is not None or not fields[0].is_grid:
        return [[_metric_panel(one, chosen, chosen.metric or "margin")] for one in fields]
    if fields[0].is_display:
        return [list(_display_panels(one, chosen)) for one in fields]
    together = _together(fields, chosen)
    columns = [_usual_panels(one, chosen, beside=bool(together)) for one in fields]
    rows = [row for row in zip(*columns, strict=True) if any(panel.has_something() for panel in row)]
    return _below(together, [list(column) for column in zip(*rows, strict=True)] or columns)


def _display_panels(field: MapField, chosen: Chosen) -> list[Panel]:
    """Return the panels of an admittance display: the mass felt, the energy given out, how often a guard acts."""
    metrics = [metric for metric in _OF_DISPLAYS if field.has(metric)]
    if len(field.keys) == 1:
        return [_profile(field, field.keys[0], metric) for metric in metrics]
    x = chosen.x or next((key for key in field.keys if key == _MASS), None)
    return [_metric_panel(field, Chosen(x, chosen.y), metric) for metric in metrics]


def _below(together: list[Lines], columns: list[list[Panel]]) -> list[list[Panel | None]]:
    """Return columns with a further row on top, which may be longer or shorter than there are columns."""
    if not together:
        return [list(column) for column in columns]
    blank: list[Panel | None] = [None] * len(columns[0])
    count = max(len(together), len(columns))
    tops = [together[i] if i < len(together) else None for i in range(count)]
    return [[tops[i], *(columns[i] if i < len(columns) else blank)] for i in range(count)]


def _together(fields: list[MapField], chosen: Chosen) -> list[Lines]:
    """Return the panels of all algorithms, unless one judgement was asked for or one key varied."""
    if chosen.judgement is not None or len(fields[0].keys) == 1:
        return []
    return headline(fields, *_keys(fields[0], chosen))


def _keys(field: MapField, chosen: Chosen) -> tuple[str, str, str | None]:
    """Return what is searched, what is across and what has one line or panel each."""
    free = [key for key in field.keys if key != chosen.x] or field.keys
    z = _STIFFNESS if _STIFFNESS in free else free[-1]
    others = sorted((key for key in field.keys if key != z), key=_preference)
    x = chosen.x or others[0]
    return z, x, chosen.y if chosen.y not in (None, z) else next((key for key in others if key != x), None)


def _check(field: MapField, chosen: Chosen) -> None:
    for name in (chosen.x, chosen.y):
        if name is not None and name not in field.keys:
            raise InputError(f"--x, --y: {name!r} was not varied in numbers, expected of: {', '.join(field.keys)}")
    if chosen.x is not None and chosen.x == chosen.y:
        raise InputError(f"--x and --y: got {chosen.x} twice; give two keys")
    if chosen.metric is not None and not field.has(chosen.metric):
        raise InputError(f"--metric: {chosen.metric!r} is not in the file; sweep again with --metrics {chosen.metric}")


def _usual_panels(field: MapField, chosen: Chosen, *, beside: bool) -> list[Panel]:
    """Return the panels of one algorithm; its border only where no panel shows it with the others'."""
    if len(field.keys) == 1:
        profiles = ("margin", "stiffness_rendered.share", _ERROR)
        return [_profile(field, field.keys[0], metric) for metric in profiles if field.has(metric)]
    z, x, y = _keys(field, chosen)
    metrics = ("margin", "stiffness_rendered.share", "damping_rendered.mean", _ERROR)
    of_metrics = [_metric_panel(field, Chosen(x, z), metric) for metric in metrics if field.has(metric)]
    return of_metrics if beside else [_width(field, z, x, y, chosen.judgement or usual_judgement(field)), *of_metrics]


def _preference(key: str) -> int:
    return _PREFERRED.index(key) if key in _PREFERRED else len(_PREFERRED)


def _width(field: MapField, z: str, x: str, y: str | None, judgement: str) -> Panel:
    """Return the largest z that passes over x (and y), the worst over every other key."""
    border = border_of(field, z, [x] if y is None else [x, y], judgement)
    order = np.argsort(field.values[x])
    places = field.values[x][order]
    title = f"{field.algorithm}: largest {z.rpartition('.')[2]}"
    note = f"{JUDGEMENTS[judgement]}, worst of all else"
    levels = [None] if y is None else sorted(field.values[y].tolist())
    if y is not None and len(levels) > _MOST_LINES:
        ranks = np.argsort(field.values[y])
        cells, rows = positive(border.value[order][:, ranks].T), field.values[y][ranks]
        return Cells(
            f"{title}, {note}", field.label(x), field.label(y), places, rows, cells, field.label(z),
            is_log(places), is_log(rows), value_log=True,
        )  # fmt: skip
    lines: list[PanelCurve] = []
    for colour, level in enumerate(levels):
        kept = (
            border.value if level is None else border.value[:, int(np.flatnonzero(field.values[y or ""] == level)[0])]
        )
        of_level = "" if level is None or y is None else f", {field.level(y, level)}"
        lines.append(PanelCurve(f"measured{of_level}", places, positive(kept[order]), "measured", colour))
        if z == _STIFFNESS and field.algorithm == "unprotected":
            lines += _theory(field, x, places, {} if level is None or y is None else {y: level}, of_level, colour)
    if border.open.any():
        note += f"; on top: all of the range, {field.values[z].max():.3g}, passes"
    for line in lines:
        if line.style != "measured" and not np.isfinite(line.y).any():
            why = ", no Coulomb friction" if line.style == "abbott_okamura" else ", the wall's damping is too large"
            note += f"; {line.label}: 0{why}"
    shown = tuple(line for line in lines if np.isfinite(line.y).any())
    return Lines(title, field.label(x), field.label(z), shown, is_log(places), is_log(field.values[z]), note)


def _theory(
    field: MapField, x: str, places: Array, at: dict[str, float], of_level: str, colour: int
) -> list[PanelCurve]:
    """Return the lines of theory; where a further key is worst of all, theory is taken at the scene's own value."""
    found = [theory_at(field, {**at, x: float(place)}) for place in places]
    lines = []
    if all(one.colgate is not None for one in found):
        values = np.array([one.colgate for one in found], dtype=float)
        lines.append(PanelCurve(f"Colgate{of_level}", places, positive(values), "colgate", colour))
    if colour == 0 and all(one.abbott_okamura is not None for one in found):
        values = np.array([one.abbott_okamura for one in found], dtype=float)
        lines.append(PanelCurve("Abbott-Okamura", places, positive(values), "abbott_okamura"))
    return lines


def _metric_panel(field: MapField, chosen: Chosen, metric: str) -> Panel:
    if len(field.keys) == 1:
        return _profile(field, field.keys[0], metric)
    others = sorted(field.keys, key=_preference)
    x = chosen.x or next(key for key in others if key != chosen.y)
    y = chosen.y or (
        _STIFFNESS if _STIFFNESS in others and x != _STIFFNESS else next(key for key in others if key != x)
    )
    values, label, kind = _shown(field, metric)
    title = f"{field.algorithm}: {label}"
    if field.is_grid:
        keys = [field.keys.index(key) for key in (y, x)]
        rest = [i for i in range(values.ndim) if i not in keys]
        values = _worst(values.transpose(*keys, *rest), tuple(range(2, values.ndim)), kind)
        rows, columns = (np.argsort(field.values[key]) for key in (y, x))
        values = values[rows][:, columns]
        title += ", worst of all else" if any(np.array(field.figure(metric).shape)[rest] > 1) else ""
        places = field.values[x][columns], field.values[y][rows]
    else:
        places = field.values[x], field.values[y]
    limits = (0.0, 1.2) if kind == "share" else None
    return Cells(
        title, field.label(x), field.label(y), *places, values, label, is_log(places[0]), is_log(places[1]),
        value_log=kind in ("energy", "error"), limits=limits, contour=0.95 if kind == "share" else None,
        dots=not field.is_grid, more_is_worse=kind in ("energy", "error"),
    )  # fmt: skip


def _shown(field: MapField, metric: str) -> tuple[Array, str, str]:
    """Return a figure as it is drawn: energies below zero as what is missing, renderings as shares of the asked."""
    values = field.figure(metric)
    if metric in ("margin", "least_interaction", "believed_margin"):
        words = {"margin": "missing in the margin, eq. 4", "least_interaction": "given out beyond what came in"}
        return (
            np.where(np.isnan(values), np.nan, np.maximum(-values, _LEAST_ENERGY)),
            f"{words.get(metric, metric)} [J]",
            "energy",
        )
    if metric == "damping_rendered.mean":
        asked = _asked_damping(field, values)
        with np.errstate(all="ignore"):
            return np.where(asked > 0.0, values / asked, np.nan), "damping rendered over asked", "share"
    if metric.endswith(".share"):
        return values, f"{'mass felt' if metric == 'mass_felt.share' else 'stiffness rendered'} over asked", "share"
    if metric == _ERROR:
        return values, f"position error, rms [{field.scene.axes[0].parameters.unit}]", "error"
    return values, metric, "plain"


def _asked_damping(field: MapField, values: Array) -> Array:
    key = "environment.damping"
    if key not in field.keys:
        return np.full(values.shape, float(getattr(field.scene.axes[0].environment.parameters, "damping", 0.0)))
    if not field.is_grid:
        return field.values[key]
    shape = [1] * values.ndim
    shape[field.keys.index(key)] = -1
    return np.broadcast_to(field.values[key].reshape(shape), values.shape)


def _worst(values: Array, over: tuple[int, ...], kind: str) -> Array:
    """Return the worst: the most energy missing, the largest error, the share furthest from one, else the least."""
    if not over:
        return values
    flat = values.reshape(*values.shape[:2], -1)
    score = {"energy": flat, "error": flat, "share": np.abs(flat - 1.0), "plain": -flat}[kind]
    unknown = np.isnan(score)
    worst = np.where(unknown, -np.inf, score).argmax(axis=2)
    found: Array = np.take_along_axis(flat, worst[:, :, None], axis=2)[:, :, 0]
    return np.where(unknown.all(axis=2), np.nan, found)


def _profile(field: MapField, key: str, metric: str) -> Panel:
    """Return a figure along the only key that was varied."""
    values, label, kind = _shown(field, metric)
    order = np.argsort(field.values[key])
    flat = _worst(values.reshape(len(order), 1, -1), (2,), kind)[:, 0] if field.is_grid else values
    places = field.values[key][order]
    line = PanelCurve(field.algorithm, places, flat[order], "measured")
    log = kind in ("energy", "error")
    return Lines(f"{field.algorithm}: {label}", field.label(key), label, (line,), is_log(places), log)
