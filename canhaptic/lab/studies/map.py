"""Maps of a sweep: the largest stiffness that passes over rate, damping and any other varied key, and its accuracy.

`MapField` gives the figures of a sweep as arrays with one dimension per key.
`border_of` finds the Z-width: the largest stiffness that passes for all values of the keys that are not drawn, and the
largest that is also accurate. `panels_of` chooses the panels of a map. The first shows all algorithms together with
theory; there "passive" refers to the display with its device's dissipation, and to the hand of the scene.

`theory_of` computes limits in closed form. Colgate and Schenkel, "Passivity of a class of sampled-data systems",
Journal of Robotic Systems 14, 1997: with the damping b of the device, a sampled wall H(z) is passive for every user if
and only if, at every frequency,

    b > T / (2 - 2 cos wT) * Re{(1 - e^-jwT) H(e^jwT)}

For a spring k without delay that is b > k T / 2. Abbott and Okamura (IEEE Trans. Robotics 21, 2005) add the encoder:
the device's Coulomb friction f_c must satisfy k < 2 f_c / count. This holds for a wall without damper and delay, on a
device with such friction.
"""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import zip_longest
from typing import Any, Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from canhaptic.control.verdict import PASSIVE_TOLERANCE
from canhaptic.errors import InputError, ParameterError
from canhaptic.lab.batch.marching import spectral_radius
from canhaptic.lab.batch.varied import scene_with
from canhaptic.lab.figures.figures import NEAR, stiffest_walls
from canhaptic.lab.loop.axis_loop import Array, is_display, viscous_friction, with_algorithm
from canhaptic.lab.studies.chunk import BATCHED, COMPLETED, RADIUS, STATUS, UNRENDERED, UNTOUCHED, batch_key
from canhaptic.lab.studies.store import SweepTable
from canhaptic.lab.studies.vary import CONTROLLER
from canhaptic.quantities import FIGURES, figure_name
from canhaptic.scene.hints import quantisation_bound, stability_hints
from canhaptic.scene.load import scene_from_text
from canhaptic.scene.models import Scene
from canhaptic.units import Parameters

Mask = NDArray[np.bool_]


class MapField:
    """The figures of one axis of a sweep under one algorithm.

    Args:
        table: Results of the sweep.
        axis: Name of the axis.
        controller: Name of the algorithm; "" if the sweep did not vary it.
        allow_code: Whether program files that the scene names may run.

    Attributes:
        keys: Numeric keys with more than one value, in the order given.
        values: Values of each of these keys.
        scene: Scene with only this axis under this algorithm, without varied values.
        algorithm: Name of its algorithm.
        is_display: Whether the axis is an admittance display.
    """

    def __init__(self, table: SweepTable, axis: str, controller: str = "", *, allow_code: bool = False) -> None:
        self._table, self.axis = table, axis
        self.index, self._status = table.axes.index(axis), table.status(axis)
        varied = table.points.varied
        self._rows: Any = np.array(table.values(CONTROLLER)) == controller if controller else slice(None)
        self._levels = {one.key: len(one.values) for one in varied if one.key != CONTROLLER}
        numeric = [one for one in varied if one.is_number and len(one.values) > 1]
        self.keys = [one.key for one in numeric]
        self.values = {one.key: np.array(one.values) for one in numeric}
        self.scene = _scene(table, axis, controller, allow_code)
        self.algorithm = self.scene.axes[0].passivity.name
        self.unit = self.scene.axes[0].parameters.unit
        self.is_display = is_display(self.scene)

    def figure(self, metric: str) -> Array:
        """Return a figure, NaN for incomplete scenes: one dimension per numeric key, other keys last."""
        found = self._shaped(self._table.figure(self.axis, metric))
        return np.where(self.has_status(COMPLETED), found, np.nan)

    def judged(self) -> Mask:
        """Return which scenes were run and had a contact, in the shape of a figure."""
        return self.has_status(COMPLETED, UNRENDERED)

    def has_status(self, *status: int) -> Mask:
        """Return which scenes have one of the given statuses of `STATUS`, in the shape of a figure."""
        found: Mask = self._shaped(np.isin(self._status, status))
        return found

    def has(self, metric: str) -> bool:
        """Return whether the sweep computed a figure."""
        return figure_name(metric) in self._table.metrics

    def label(self, key: str) -> str:
        """Return a key with its unit, for an axis of a picture."""
        unit = _unit_of(self.scene, key)
        return f"{key} [{unit}]" if unit else key

    def levels(self, key: str | None) -> list[dict[str, float]]:
        """Return the values of a key in ascending order, each as {key: value}; [{}] for None."""
        return [{}] if key is None else [{key: value} for value in sorted(self.values[key].tolist())]

    def words(self, at: Mapping[str, float]) -> str:
        """Return values of keys as text, such as `, damping 5 N*s/m`."""
        said = (f"{key.rpartition('.')[2]} {at[key]:.3g} {_unit_of(self.scene, key)}" for key in at)
        return "".join(f", {words.rstrip()}" for words in said)

    def _shaped(self, column: NDArray[Any]) -> Any:
        """Return the rows of this algorithm, with one dimension per numeric key, all other keys last."""
        rows = column[self._rows]
        names = list(self._levels)
        order = [names.index(key) for key in self.keys]
        cube = np.moveaxis(rows.reshape(list(self._levels.values())), order, range(len(order)))
        return cube.reshape(*cube.shape[: len(self.keys)], -1)


def fields_of(table: SweepTable, axis: str | None = None, *, allow_code: bool = False) -> list[MapField]:
    """Return the figures of an axis as one `MapField` for each algorithm of a sweep.

    Args:
        table: Results of the sweep.
        axis: Name of the axis; the first by default.
        allow_code: Whether program files that the scene names may run.

    Raises:
        InputError: There is no such axis, no chunk is finished, or no numeric key varies.
    """
    name = axis or table.axes[0]
    if name not in table.axes:
        raise InputError(f"{table.folder}: has no axis {name!r}, expected one of: {', '.join(table.axes)}")
    if not table.done().any():
        raise InputError(f"{table.folder}: no chunk is finished yet, so there is nothing to draw; resume the sweep")
    controllers = list(dict.fromkeys(table.values(CONTROLLER))) if CONTROLLER in table.keys else [""]
    fields = [MapField(table, name, str(controller), allow_code=allow_code) for controller in controllers]
    if not fields[0].keys:
        raise InputError(f"{table.folder}: has no axis to draw along; sweep again with --vary of a key with numbers")
    return fields


def _scene(table: SweepTable, axis: str, controller: str, allow_code: bool) -> Scene:
    """Return the scene of one axis under an algorithm, without varied values."""
    overrides = json.loads(table.note("overrides"))
    scene = scene_from_text(table.note("scene"), table.note("source"), overrides, allow_code=allow_code)
    chosen = next(one for one in scene.axes if axis in (one.parameters.name, one.port))
    if controller:
        scene = scene.with_port(with_algorithm(scene.port_of(chosen), controller))
    return replace(scene, axes=(scene.axis(chosen.parameters.name),))


def _unit_of(scene: Scene, key: str) -> str:
    """Return the unit of a varied key on the axis of a scene; "" for a pure number."""
    [axis] = scene.axes
    simulation = axis.simulation
    user = simulation and simulation.user
    section, _, name = ".".join(key.split(".")[-2:]).rpartition(".")
    owners: dict[str, tuple[object, ...]] = {
        "bus": (scene.bus,),
        "environment": (axis.environment.parameters,),
        "passivity": (axis.passivity.parameters, axis.loop),
        "plant": (simulation and simulation.plant,),
        "user": (user,),
        "motion": (user and user.motion,),
    }
    for owner in owners.get(section, (axis.parameters,)):
        field = type(owner).model_json_schema()["properties"].get(name) if isinstance(owner, Parameters) else None
        for part in (field, *field.get("anyOf", ())) if field else ():
            if "unit" in part:  # of a linear axis, and behind it of a rotary one where that differs
                linear, _, rotary = part["unit"].partition(" or ")
                unit = rotary or linear if axis.parameters.unit == "rad" else linear
                return "" if unit == "1" else unit
    return ""


_ANGLES: Final = 4096
_TRIED: Final = np.geomspace(1.0, 1e8, 801)
"""Stiffnesses at which the loop's eigenvalues are computed [N/m or N*m/rad]."""


def colgate_stiffness(damping: float, wall_damping: float, sample_time: float, delay: int) -> float:
    """Return the largest stiffness [N/m or N*m/rad] that is passive by the condition of Colgate and Schenkel.

    Args:
        damping: b of the device [N*s/m or N*m*s/rad].
        wall_damping: Damping of the wall, on the backward difference of the position [N*s/m or N*m*s/rad].
        sample_time: T [s].
        delay: Delay of the loop in whole holds.
    """
    angle = np.linspace(math.pi / _ANGLES, math.pi, _ANGLES)
    forward = 1.0 - np.exp(-1j * angle)
    common = forward * np.exp(-1j * delay * angle) / (2.0 * (1.0 - np.cos(angle)))
    of_spring, of_damper = sample_time * common.real, (common * forward).real
    left = damping - wall_damping * of_damper
    if float(left.min()) <= 0.0:
        return 0.0
    asked = of_spring > 0.0
    return float((left[asked] / of_spring[asked]).min())


class Theory(NamedTuple):
    """Largest stiffness by each theory [N/m or N*m/rad]; None where a theory does not apply."""

    colgate: float | None  # passive for every hand
    abbott_okamura: float | None  # passive for every hand, with encoder counts and dry friction
    eigenvalues: float | None  # plain wall in permanent contact is stable, with the hand of the scene
    certificate: float | None  # largest stiffness that the scene's own algorithm certifies


def theory_at(field: MapField, values: Mapping[str, float]) -> Theory:
    """Return the theoretical limits at the given values of a field's keys.

    Args:
        field: Field of the axis and algorithm.
        values: Key -> value; keys that no formula uses are ignored.
    """
    names = {batch_key(key, field.index, field.axis) or "": value for key, value in values.items()}
    return theory_of(scene_with(field.scene, {name: value for name, value in names.items() if name in BATCHED}))


def theory_of(scene: Scene) -> Theory:
    """Return the theoretical limits for the wall of a scene with one simulated axis, for any stiffness."""
    [axis] = scene.axes
    simulation, environment, delay = axis.simulation, axis.environment.parameters, scene.bus.delay
    if simulation is None or not hasattr(environment, "stiffness"):
        return Theory(None, None, None, None)
    device = simulation.plant.damping + viscous_friction(simulation)
    wall = float(getattr(environment, "damping", 0.0))
    friction = quantisation_bound(axis) or math.inf
    certified = [hint.limit for hint in stability_hints(axis) if hint.certificate and hint.limit is not None]
    return Theory(
        colgate_stiffness(device, wall, scene.bus.sample_time, delay),
        friction if delay == 0 and wall == 0.0 and math.isfinite(friction) else None,
        _stable_stiffness(scene),
        max(certified, default=None),
    )


def _stable_stiffness(scene: Scene) -> float | None:
    """Return the stiffness up to which the plain wall is stable by its eigenvalues; None if the loop is not linear."""
    try:
        radii = spectral_radius(scene, {"environment.stiffness": _TRIED})
    except (ParameterError, NotImplementedError):
        return None
    count = int(np.logical_and.accumulate(radii < 1.0).sum())
    return float(_TRIED[count - 1]) if count else 0.0


class Judgement(NamedTuple):
    """A condition for passing."""

    energy: str  # figure that must not be negative; "" for stability
    claim: str  # what a wall that passes is
    words: str


_ENERGY: Final = "net energy into the plant >= 0, to 1 uJ,"
JUDGEMENTS: Final = {
    "stable": Judgement("", "stable, not passive",
                        "eigenvalues of a linear loop, else no divergence; promises no passivity"),
    "passive": Judgement("least_interaction", "passive at the motor", f"{_ENERGY} at the motor, as `run` judges it"),
    "margin": Judgement("margin", "within its margin", "margin of (4) >= 0, to 1 uJ"),
    "settled": Judgement("interaction", "passive at the end", f"{_ENERGY} at the end"),
    "covered": Judgement("least_covered", "passive at the handle", f"{_ENERGY} at the handle, friction and damping of "
                         "the device included (`run` judges the motor alone unless they are declared: --by passive)"),
}  # fmt: skip
SHARE: Final = "stiffness_rendered.share"


class _Border(NamedTuple):
    """Border of a field along one key; the arrays have the shape of the other keys."""

    value: Array  # largest value up to which all pass; 0: not even the least passes; NaN: scenes are missing
    open: Mask  # whether the largest value passes, so that the border is beyond the range


def usual_judgement(field: MapField) -> str:
    """Return the default judgement of an algorithm: the property that it promises.

    `unprotected` does not promise a passive port. It is judged by the eigenvalues of the loop, also while none of its
    scenes is finished; where the loop is not linear, damping and dry friction of the device must at any moment cover
    the energy that the port gave out, as Abbott and Okamura require.
    """
    if field.algorithm == "unprotected":
        is_finished = field.has_status(COMPLETED).any()
        if field.has(RADIUS) and (np.isfinite(field.figure(RADIUS)).any() or not is_finished):
            return "stable"
        return next((name for name in ("covered", "settled") if field.has(JUDGEMENTS[name].energy)), "passive")
    return "passive" if field.has("least_interaction") else "margin"


def _passes(field: MapField, judgement: str) -> Mask:
    """Return which scenes pass a judgement, in the shape of a figure."""
    if judgement != "stable":
        return np.asarray(field.figure(JUDGEMENTS[judgement].energy) >= -PASSIVE_TOLERANCE)
    passed = field.has_status(COMPLETED)
    if field.has("diverged"):
        passed &= field.figure("diverged") == 0.0
    if field.has(RADIUS) and field.algorithm == "unprotected":
        radius = field.figure(RADIUS)
        passed &= ~(radius >= 1.0)
    return passed


def passing_share(field: MapField, judgement: str) -> float:
    """Return the share of the scenes with a contact that pass a judgement."""
    judged = field.judged()
    return float((_passes(field, judgement) & judged).sum() / max(1, judged.sum()))


def common_judgement(field: MapField) -> str:
    """Return the judgement for a panel with all algorithms: display with device, if the sweep has their energy."""
    return next((name for name in ("covered", "passive") if field.has(JUDGEMENTS[name].energy)), "margin")


def border_of(field: MapField, key: str, kept: list[str], judgement: str, *, near: bool = False) -> _Border:
    """Return the largest value of a key up to which all scenes pass, for all values of the keys that are not kept.

    Args:
        field: Field with a grid.
        key: Key whose border is searched, such as environment.stiffness.
        kept: Keys that remain as dimensions of the result, in this order.
        judgement: Name of a judgement, in `JUDGEMENTS`.
        near: Whether to return the largest of the passing values at which the stiffness is rendered within `NEAR`.
    """
    order, rank = [field.keys.index(name) for name in (key, *kept)], np.argsort(field.values[key])
    folded = tuple(range(1 + len(kept), len(field.keys) + 1))

    def arranged(figure: NDArray[Any]) -> Any:
        """Return a figure with dimensions key (ascending), kept keys, all others."""
        return np.moveaxis(figure, order, range(len(order)))[rank]

    judged = arranged(field.judged())
    passed = (arranged(_passes(field, judgement)) | ~judged).all(axis=folded)
    known = judged.any(axis=folded).all(axis=0)
    shares = np.ones(passed.shape)
    if near:
        apart = np.where(judged, np.abs(arranged(field.figure(SHARE)) - 1.0), 0.0)
        shares += apart.max(axis=folded)
    walls = stiffest_walls(np.sort(field.values[key]), passed, shares)
    return _Border(np.where(known, walls.near if near else walls.passive, np.nan), known & walls.is_open)


_LOG_SPAN: Final = 8.0
"""Ratio of largest to least value from which an axis is logarithmic."""
CurveStyle = Literal["measured", "ours", "colgate", "abbott_okamura", "eigenvalues", "certificate"]
"""Kind of a line: measured, measured under `guarded`, or a theory."""
Kind = Literal["border", "share", "energy", "error", "plain"]
"""Kind of a figure in coloured cells: a border, a share of the requested value, a fault, or anything else."""


@dataclass(frozen=True, slots=True)
class PanelCurve:
    """One line of a panel; `number` chooses its colour, and lines for the same value of a key share it."""

    label: str
    x: Array
    y: Array
    style: CurveStyle
    number: int = 0


@dataclass(frozen=True, slots=True)
class Lines:
    """A panel of a map with lines, such as borders over a varied key."""

    title: str
    x_label: str
    y_label: str
    lines: tuple[PanelCurve, ...]
    y_log: bool
    note: str = ""
    y_range: tuple[float, float] | None = None  # values of y that were tried, where y is a varied key
    floor: float | None = None  # y by which all that is smaller is drawn

    @property
    def x(self) -> Array:
        """Places of all lines."""
        return np.concatenate([line.x for line in self.lines] or [np.empty(0)])


@dataclass(frozen=True, slots=True)
class Cells:
    """A panel of coloured cells."""

    title: str
    x_label: str
    y_label: str
    x: Array  # of the columns, (nx,)
    y: Array  # of the rows, (ny,)
    values: Array  # (ny, nx); NaN is blank
    value_label: str
    kind: Kind
    marked: Mapping[str, Mask] = field(default_factory=dict)  # status -> its scenes, of the shape of `values`

    @property
    def y_log(self) -> bool:
        """Whether the y axis is logarithmic."""
        return is_log(self.y)


Panel = Lines | Cells


def _has_something(panel: Panel) -> bool:
    marked = isinstance(panel, Cells) and any(mask.any() for mask in panel.marked.values())
    return isinstance(panel, Lines) or marked or bool(np.isfinite(panel.values).any())


def is_log(values: Array) -> bool:
    """Return whether an axis with these values should be logarithmic."""
    return bool(values.size and values.min() > 0.0 and values.max() / values.min() >= _LOG_SPAN)


def positive(values: Array) -> Array:
    """Return values with NaN in place of those that are not positive, for a logarithmic axis."""
    return np.where(values > 0.0, values, np.nan)


_OURS: Final = "guarded"
_MOST_PANELS: Final = 3
_OF_PLAIN_WALL: Final[dict[CurveStyle, str]] = {
    "colgate": "Colgate, plain wall",
    "abbott_okamura": "Abbott-Okamura, plain wall",
    "eigenvalues": "stable without algorithm (eigenvalues)",
}


def headline(fields: list[MapField], z: str, x: str, y: str | None) -> list[Lines]:
    """Return panels with all algorithms and theory: one per value of y, or for the least, middle and largest of many.

    Args:
        fields: Fields of one grid, one per algorithm.
        z: Key of the stiffness.
        x: Key along the x axis.
        y: Another key; None if there is no other.

    Returns:
        An empty list if the sweep lacks the rendered share of the stiffness.
    """
    if not all(one.has(SHARE) and common_judgement(one) != "margin" for one in fields):
        return []
    levels = fields[0].levels(y)
    if len(levels) > _MOST_PANELS:
        levels = [levels[0], levels[len(levels) // 2], levels[-1]]
    return [_panel(fields, z, x, at) for at in levels]


def _panel(fields: list[MapField], z: str, x: str, at: dict[str, float]) -> Lines:
    field = fields[0]
    places = np.sort(field.values[x])
    curves: list[PanelCurve] = []
    for number, one in enumerate(fields):
        style: CurveStyle = "ours" if one.algorithm == _OURS else "measured"
        border = _border_along(one, z, x, at, common_judgement(one), near=True)
        curves.append(PanelCurve(one.algorithm, places, border, style, number))
    plain = next((one for one in fields if one.algorithm == "unprotected"), field)
    curves += _theory(plain, _OF_PLAIN_WALL, x, at)
    for ours in (one for one in fields if one.algorithm == _OURS):
        curves += _theory(ours, {"certificate": "largest certificate of guarded"}, x, at)
    judgement = common_judgement(field)
    note = f"solid: simulated, broken: theory; {_judged(field, judgement)}; "
    note += "worst case over all other keys; none: no wall tried passes"
    if any(one.algorithm == "unprotected" for one in fields):
        note += "; unprotected passes for this hand alone: it promises no passivity"
    largest = "stiffest wall" if z == _STIFFNESS else f"largest {z.rpartition('.')[2]}"
    title = f"{largest} that is {JUDGEMENTS[judgement].claim} and within {100.0 * NEAR:g} %{field.words(at)}"
    return _lines(field, title, x, z, curves, note)


def _judged(field: MapField, judgement: str) -> str:
    """Return a note on the condition that a wall had to pass, and for which hand."""
    user: Any = field.scene.axes[0].simulation and field.scene.axes[0].simulation.user
    motion = getattr(getattr(user, "motion", None), "type", "own")
    return f"{JUDGEMENTS[judgement].words}; for the scene's hand alone ({motion} motion)"


def _border_along(
    field: MapField, z: str, x: str, at: Mapping[str, float], judgement: str, *, near: bool = False
) -> Array:
    """Return the border over ascending x, at given values of other keys; NaN where not even the least passes."""
    border = border_of(field, z, [x, *at], judgement, near=near).value[np.argsort(field.values[x])]
    for key, level in at.items():
        border = border[:, int(np.flatnonzero(field.values[key] == level)[0])]
    return positive(border)


def _lines(field: MapField, title: str, x: str, z: str, curves: Sequence[PanelCurve], note: str) -> Lines:
    """Return a panel with all curves that have at least one point."""
    shown = tuple(curve for curve in curves if np.isfinite(curve.y).any())
    tried = field.values[z]
    y_range = float(tried.min()), float(tried.max())
    return Lines(title, field.label(x), field.label(z), shown, is_log(tried), note, y_range)


def _theory(
    field: MapField, labels: Mapping[CurveStyle, str], x: str, at: Mapping[str, float], number: int = 0
) -> list[PanelCurve]:
    """Return lines of theory over ascending x; NaN where a limit is zero or does not apply.

    Keys that are not drawn have the value of the scene.
    """
    places = np.sort(field.values[x])
    found = [theory_at(field, {**at, x: float(place)}) for place in places]
    columns = {name: np.array([getattr(one, name) for one in found], dtype=float) for name in labels}
    return [PanelCurve(label, places, positive(columns[name]), name, number) for name, label in labels.items()]


_STIFFNESS: Final = "environment.stiffness"
_MASS: Final = "environment.mass"
_OF_DISPLAYS: Final = ("mass_felt.share", "least_interaction", "guard_acts")
_PREFERRED: Final = ("bus.rate", "environment.damping")
_MOST_LINES: Final = 5
LEAST_ENERGY: Final = 1e-6  # [J]
_ERROR: Final = "position_error.rms"
_SHARES: Final = tuple(name for name in FIGURES if name.partition(".")[2] == "share")
_DAMPING: Final = "damping_rendered.share"
_OF_WALLS: Final = ("margin", "stiffness_rendered.share", _DAMPING, _ERROR)


@dataclass(frozen=True, slots=True)
class Chosen:
    """Keys, figure and judgement that the user requests for a map; None: chosen automatically."""

    x: str | None = None
    y: str | None = None
    metric: str | None = None
    judgement: str | None = None


def panels_of(fields: list[MapField], chosen: Chosen) -> list[list[Panel | None]]:
    """Return the panels of a map by columns, one for each algorithm; on top, panels with all algorithms together.

    Raises:
        InputError: A requested key was not varied, or the sweep did not compute a requested figure.
    """
    _check(fields[0], chosen)
    if chosen.metric is not None:
        return [[_metric_panel(one, chosen, chosen.metric)] for one in fields]
    if fields[0].is_display:
        x = chosen.x or (_MASS if _MASS in fields[0].keys else None)
        known = [metric for metric in _OF_DISPLAYS if fields[0].has(metric)]
        return [[_metric_panel(one, Chosen(x, chosen.y), metric) for metric in known] for one in fields]
    is_shared = chosen.judgement is None and len(fields[0].keys) > 1
    together = headline(fields, *_keys(fields[0], chosen)) if is_shared else []
    columns = [_usual_panels(one, chosen, beside=bool(together)) for one in fields]
    rows = [row for row in zip(*columns, strict=True) if any(map(_has_something, row))]
    shown = [list(column) for column in zip(*rows, strict=True)] or columns
    if not together:
        return [[*column] for column in shown]
    blank = [None] * len(shown[0])
    return [[top, *(column or blank)] for top, column in zip_longest(together, shown)]


def _keys(field: MapField, chosen: Chosen) -> tuple[str, str, str | None]:
    """Return the key whose border is searched, the key of the x axis, and the key with one line or panel per value."""
    free = [key for key in field.keys if key != chosen.x] or field.keys
    z = _STIFFNESS if _STIFFNESS in free else max(reversed(free), key=_preference)
    others = sorted((key for key in field.keys if key != z), key=_preference)
    x = chosen.x or others[0]
    return z, x, chosen.y if chosen.y not in (None, z) else next((key for key in others if key != x), None)


def _check(field: MapField, chosen: Chosen) -> None:
    for name in (chosen.x, chosen.y):
        if name is not None and name not in field.keys:
            raise InputError(f"--x, --y: {name!r} was not varied in numbers, expected one of: {', '.join(field.keys)}")
    if chosen.x is not None and chosen.x == chosen.y:
        raise InputError(f"--x and --y: got {chosen.x} twice; give two keys")
    if chosen.metric is not None and not field.has(chosen.metric):
        raise InputError(f"--metric: {chosen.metric!r} is not in the sweep; repeat it with --metrics {chosen.metric}")


def _usual_panels(field: MapField, chosen: Chosen, *, beside: bool) -> list[Panel]:
    """Return the panels of one algorithm, with its border unless a panel with all algorithms shows it."""
    if len(field.keys) == 1:
        return [
            _metric_panel(field, chosen, metric) for metric in _OF_WALLS if field.has(metric) and metric != _DAMPING
        ]
    z, x, y = _keys(field, chosen)
    of_metrics = [_metric_panel(field, Chosen(x, z), metric) for metric in _OF_WALLS if field.has(metric)]
    return of_metrics if beside else [_width(field, z, x, y, chosen.judgement or usual_judgement(field)), *of_metrics]


def _preference(key: str) -> int:
    return _PREFERRED.index(key) if key in _PREFERRED else len(_PREFERRED)


def _width(field: MapField, z: str, x: str, y: str | None, judgement: str) -> Panel:
    """Return a panel of the largest passing z over x (and y), the worst case over all other keys."""
    border = border_of(field, z, [x] if y is None else [x, y], judgement)
    title = f"{field.algorithm}: largest {z.rpartition('.')[2]} that is {JUDGEMENTS[judgement].claim}"
    note = f"{_judged(field, judgement)}; worst case over all other keys"
    levels = field.levels(y)
    places = np.sort(field.values[x])
    if y is not None and len(levels) > _MOST_LINES:
        order, ranks = (np.argsort(field.values[key]) for key in (x, y))
        cells, rows = positive(border.value[order][:, ranks].T), field.values[y][ranks]
        return Cells(f"{title}, {note}", field.label(x), field.label(y), places, rows, cells, field.label(z), "border")
    lines: list[PanelCurve] = []
    for colour, at in enumerate(levels):
        measured = _border_along(field, z, x, at, judgement)
        lines.append(PanelCurve(f"measured{field.words(at)}", places, measured, "measured", colour))
        if z == _STIFFNESS and field.algorithm == "unprotected":
            labels: dict[CurveStyle, str] = {"colgate": f"Colgate{field.words(at)}"}
            labels |= {} if colour else {"abbott_okamura": "Abbott-Okamura"}
            applies = theory_at(field, {**at, x: float(places[-1])})
            known = {name: label for name, label in labels.items() if getattr(applies, name) is not None}
            lines += _theory(field, known, x, at, colour)
    if border.open.any():
        note += f"; on top: all of the range, {field.values[z].max():.3g}, passes"
    for line in lines:
        if line.style != "measured" and not np.isfinite(line.y).any():
            why = ", no Coulomb friction" if line.style == "abbott_okamura" else ", the wall's damping is too large"
            note += f"; {line.label}: 0{why}"
    return _lines(field, title, x, z, lines, note)


def _metric_panel(field: MapField, chosen: Chosen, metric: str) -> Panel:
    if len(field.keys) == 1:
        return _profile(field, field.keys[0], metric)
    others = sorted(field.keys, key=_preference)
    x = chosen.x or next(key for key in others if key != chosen.y)
    y = chosen.y or next(key for key in sorted(others, key=_STIFFNESS.__ne__) if key != x)
    values, label, kind = _shown(field, metric)
    title = f"{field.algorithm}: {label}"
    marked = {STATUS[number]: field.has_status(number) for number in (UNTOUCHED, UNRENDERED)}
    keys, (columns, rows) = [field.keys.index(key) for key in (y, x)], (np.argsort(field.values[key]) for key in (x, y))
    values = np.moveaxis(values, keys, [0, 1])
    title += ", worst case over all other keys" if any(size > 1 for size in values.shape[2:]) else ""
    values = _worst(values, kind)[rows][:, columns]
    for status, mask in marked.items():
        folded: Any = np.moveaxis(mask, keys, [0, 1]).any(axis=tuple(range(2, mask.ndim)))
        marked[status] = folded[rows][:, columns] & np.isnan(values)
    places = field.values[x][columns], field.values[y][rows]
    return Cells(title, field.label(x), field.label(y), *places, values, label, kind, marked)


def _shown(field: MapField, metric: str) -> tuple[Array, str, Kind]:
    """Return the values to draw for a figure, its label and kind; of an energy, the amount that is missing to zero."""
    values = field.figure(metric)
    row = FIGURES[metric]
    if row.better == "not negative" or metric == "accounted_margin":
        missing = np.where(np.isnan(values), np.nan, np.maximum(-values, LEAST_ENERGY))
        return missing, f"{row.title}, below zero by [{row.unit}]", "energy"
    if metric in _SHARES:
        return values, row.title, "share"
    if metric == _ERROR:
        return values, f"{row.title} [{field.unit}]", "error"
    return values, row.title, "plain"


def _worst(values: Array, kind: Kind) -> Array:
    """Return the worst value over all dimensions but the first two.

    The worst is the largest error or missing energy, the share furthest from one, or the least of any other figure.
    """
    flat = values.reshape(*values.shape[:2], -1)
    score = {"share": np.abs(flat - 1.0), "plain": -flat}.get(kind, flat)
    worst = np.where(np.isnan(score), -np.inf, score).argmax(axis=2)
    return np.asarray(np.take_along_axis(flat, worst[:, :, None], axis=2)[:, :, 0])


def _profile(field: MapField, key: str, metric: str) -> Panel:
    """Return a panel of a figure over the only key that was varied."""
    values, label, kind = _shown(field, metric)
    order = np.argsort(field.values[key])
    flat = _worst(values.reshape(len(order), 1, -1), kind)[:, 0]
    line = PanelCurve(field.algorithm, field.values[key][order], flat[order], "measured")
    title, floor = f"{field.algorithm}: {label}", LEAST_ENERGY if kind == "energy" else None
    return Lines(title, field.label(key), label, (line,), kind in ("energy", "error"), floor=floor)
