"""The figures of consecutive scenes, wherever they are computed: a pure function of the recipe and their values.

Scenes of one kind run together by the batch engine, or one by one where that cannot take them, with the reason kept.
How scenes are dealt into chunks changes nothing, because no scene knows of its neighbours.
"""

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from canhaptic.errors import CanHapticError, ParameterError
from canhaptic.lab.batch import (
    ALL,
    BATCH_KEYS,
    METRICS,
    NotBatchableError,
    run_batch,
    run_scalar,
    spectral_radius,
    why_not_batchable,
    why_not_compared,
)
from canhaptic.lab.batch.cases import not_in_loop
from canhaptic.lab.batch.group_case import group_case
from canhaptic.lab.batch.group_scalar import group_figures, group_meter
from canhaptic.lab.figures.display_figures import DISPLAY_METRICS, display_figures
from canhaptic.lab.loop.axis_loop import Array
from canhaptic.lab.loop.display_loop import is_display
from canhaptic.lab.loop.scenes import parts_of
from canhaptic.lab.studies.sweep.places import batch_key
from canhaptic.lab.studies.sweep.points import Column
from canhaptic.lab.studies.sweep.recipe import (
    RATE,
    Built,
    Recipe,
    Row,
    cycles_in,
    is_box_permitted,
    of_plant,
    scene_of,
    seeded,
    seeds_of,
)
from canhaptic.scene.models import Scene

RADIUS: Final = "spectral_radius"
"""Metric of the linear sampled loop, from its eigenvalues; NaN where the loop is not linear."""
FIGURES: Final = tuple(dict.fromkeys((*ALL, RADIUS, *DISPLAY_METRICS)))
USUAL: Final = (*METRICS, RADIUS)
"""Metrics that need no continuous run of each scene."""


def usual_figures(scene: Scene) -> tuple[str, ...]:
    """Return the metrics of a sweep that names none: of each kind of display that a scene has."""
    displays = [is_display(part) for part in parts_of(scene).values()]
    if not any(displays):
        return USUAL
    return tuple(DISPLAY_METRICS) if all(displays) else tuple(dict.fromkeys((*USUAL, *DISPLAY_METRICS)))


STATUS: Final = ("pending", "completed", "refused", "failed")
COMPLETED, REFUSED, _FAILED = (STATUS.index(name) for name in ("completed", "refused", "failed"))
ENGINES: Final = ("none", "closed form", "python", "numba", "scalar")
SLOTS: Final = 32
"""Different remarks that one chunk keeps."""
_MORE: Final = "more remarks than a chunk keeps; canhaptic check CONFIG --set with its values says which"

_CLOSED_FORM, _SCALAR = ENGINES.index("closed form"), ENGINES.index("scalar")
BATCHED: Final = frozenset(f"{section}.{name}" for section, names in BATCH_KEYS.items() for name in names)
"""Every key that may differ inside a batch."""
_Rows = NDArray[np.intp]


class ChunkResult(NamedTuple):
    """Results of a chunk, row by row; every array of shape (n_scenes,)."""

    figures: dict[str, Array]  # by "axis/metric", NaN where there is nothing
    status: NDArray[np.uint8]  # index in STATUS
    engine: NDArray[np.uint8]  # index in ENGINES
    remark: NDArray[np.uint8]  # 0 for none, else one more than the index in texts
    texts: tuple[str, ...]
    of_plant: str = ""  # which properties an algorithm took from the simulated plant, in words; "" for none


def run_chunk(recipe: Recipe, start: int, columns: Mapping[str, Column]) -> ChunkResult:
    """Return the figures of the scenes `start` and following.

    Args:
        recipe: Recipe of the sweep.
        start: Global index of the first.
        columns: Values by key, of one length.
    """
    return _Chunk(recipe, start, columns).run()


def is_batch_key(recipe: Recipe, key: str) -> bool:
    """Return whether scenes that differ in a key fit one batch, for every axis that it touches."""
    names = [batch_key(key, index, name) for index, name in enumerate(recipe.axes)]
    return all(name is None or name in BATCHED for name in names)


class _Chunk:
    """Consecutive scenes on their way from values to figures."""

    def __init__(self, recipe: Recipe, start: int, columns: Mapping[str, Column]) -> None:
        self._recipe, self._start, self._columns = recipe, start, columns
        self._count = len(next(iter(columns.values())))
        self._free = _free_keys(recipe)
        names = [f"{axis}/{metric}" for axis in recipe.axes for metric in recipe.metrics]
        self._figures = {name: np.full(self._count, np.nan) for name in names}
        self._status = np.zeros(self._count, dtype=np.uint8)
        self._engine = np.zeros(self._count, dtype=np.uint8)
        self._remark = np.zeros(self._count, dtype=np.uint8)
        self._texts: list[str] = []
        self._of_plant = ""

    def run(self) -> ChunkResult:
        """Run every scene."""
        batched = {key for key in self._columns if is_batch_key(self._recipe, key)}
        apart = {key for key in self._columns if key not in batched}
        if RATE in self._columns and self._recipe.cycles is None:
            apart.add(RATE)  # scenes of one duration differ in their number of holds
        permitted = self._permitted()
        for rows in self._groups(apart, permitted):
            self._run_group(rows, tuple(sorted(batched)))
        return ChunkResult(self._figures, self._status, self._engine, self._remark, tuple(self._texts), self._of_plant)

    def _permitted(self) -> _Rows:
        """Return the rows whose values go together; the others are noted as refused."""
        refused = []
        for rows in self._groups({key for key in self._columns if key not in self._free}, np.arange(self._count)):
            if is_box_permitted(self._recipe, self._row(int(rows[0]), set(self._columns) - self._free)):
                continue
            for row in rows.tolist():
                built = scene_of(self._recipe, self._row(row))
                if built.scene is None:
                    refused.append(row)
                    self._note(row, REFUSED, 0, built.remark)
        return np.setdiff1d(np.arange(self._count), np.array(refused, dtype=np.intp))

    def _groups(self, keys: set[str], rows: _Rows) -> list[_Rows]:
        """Return the rows that share the values of some keys, in the order of their first."""
        kinds = np.zeros(len(rows), dtype=np.int64)
        for key in keys:
            numbers = _numbered(self._columns[key])[rows]
            kinds = np.unique(kinds * (numbers.max(initial=0) + 1) + numbers, return_inverse=True)[1]
        _, first, kinds = np.unique(kinds, return_index=True, return_inverse=True)
        together = np.split(rows[np.argsort(kinds, kind="stable")], np.cumsum(np.bincount(kinds))[:-1])
        return [together[number] for number in np.argsort(first).tolist()]

    def _row(self, row: int, keys: set[str] | None = None) -> Row:
        return tuple(
            (key, float(values[row]) if isinstance(values, np.ndarray) else values[row])
            for key, values in self._columns.items()
            if keys is None or key in keys
        )

    def _run_group(self, rows: _Rows, batched: Sequence[str]) -> None:
        built = scene_of(self._recipe, self._row(int(rows[0])))
        self._of_plant = built.remark if built.from_plant else self._of_plant
        not_linear = self._closed_form(built, rows, batched) if RADIUS in self._recipe.metrics else ""
        if self._recipe.metrics == (RADIUS,):
            self._note_all(rows, 0 if not_linear else _CLOSED_FORM, _joined(not_linear, _remark_of(built)))
            return
        reason = self._recipe.alone or self._in_arrays(built, rows, batched)
        if reason:
            self._one_by_one(rows, reason)

    def _closed_form(self, built: Built, rows: _Rows, batched: Sequence[str]) -> str:
        """Fill in the spectral radius where the loop is linear; return "" or why it is not."""
        reason = ""
        for index, name in enumerate(self._recipe.axes):
            scene = _alone(built, name)
            try:
                radii = spectral_radius(scene, self._varied(built, scene, index, rows, batched))
            except (ParameterError, NotImplementedError) as error:
                reason = f"no closed form: {error}".splitlines()[0]
                continue
            self._figures[f"{name}/{RADIUS}"][rows] = radii
        return reason

    def _in_arrays(self, built: Built, rows: _Rows, batched: Sequence[str]) -> str:
        """Run the rows as one batch per axis; return "" or the reason why that cannot be."""
        recipe, cycles = self._recipe, cycles_in(self._recipe, built.permitted())
        metrics = [metric for metric in recipe.metrics if metric != RADIUS]
        found: dict[str, Array] = {}
        stopped: dict[int, str] = {}
        seeds = seeds_of(recipe, built.permitted(), self._start + rows)
        for index, name in enumerate(recipe.axes):
            scene = _alone(built, name)
            reason = why_not_batchable(scene) or why_not_compared(scene, metrics)
            if reason:
                return reason
            varied = self._varied(built, scene, index, rows, batched)
            try:
                figures = run_batch(scene, varied, cycles, recipe.engine, metrics, seeds=seeds, stopped=stopped)
            except (ParameterError, NotBatchableError) as error:
                return f"the batch refused: {error}".splitlines()[0]
            found |= {f"{name}/{metric}": figures[metric] for metric in metrics}
        for path, values in found.items():
            self._figures[path][rows] = values
        engine = ENGINES.index(recipe.engine)
        self._note_all(rows, engine, _remark_of(built, is_batched=True))
        for row, text in stopped.items():
            self._note(int(rows[row]), _FAILED, engine, text)
        return ""

    def _varied(self, built: Built, scene: Scene, index: int, rows: _Rows, batched: Sequence[str]) -> dict[str, Array]:
        """Return what differs inside a batch of one axis, by the names of the batch."""
        follows = of_plant(built.from_plant)
        varied: dict[str, Array] = {}
        for key in batched:
            name = batch_key(key, index, self._recipe.axes[index])
            values = self._columns[key]
            if name is None or not isinstance(values, np.ndarray) or not _is_taken(scene, name):
                continue
            varied[name] = np.ascontiguousarray(values[rows])
            varied |= {own: varied[name] for own, plant in follows.items() if plant == name}
        if not varied:  # an axis that nothing touches: every scene of the batch is the same
            varied = {RATE: np.full(len(rows), scene.bus.rate)}
        return varied

    def _one_by_one(self, rows: _Rows, reason: str) -> None:
        asked = [metric for metric in self._recipe.metrics if metric != RADIUS]
        for row in rows.tolist():
            built = scene_of(self._recipe, self._row(row))
            if built.scene is None:
                self._note(row, REFUSED, 0, built.remark)
                continue
            failure, engine, remark = "", _SCALAR, _joined(reason, _remark_of(built))
            for name in self._recipe.axes:
                scene = seeded(self._recipe, _alone(built, name), self._start + row)
                try:
                    figures, is_compiled, why_not = _figures_alone(self._recipe, scene, asked)
                except CanHapticError as error:
                    failure = str(error).splitlines()[0]
                    continue
                if is_compiled:
                    engine, remark = ENGINES.index("numba"), _remark_of(built)
                elif why_not:
                    remark = _joined(f"not compiled: {why_not}", _remark_of(built))
                for metric in asked:
                    self._figures[f"{name}/{metric}"][row] = figures[metric]
            self._note(row, _FAILED if failure else COMPLETED, engine, failure or remark)

    def _note_all(self, rows: _Rows, engine: int, remark: str) -> None:
        self._status[rows], self._engine[rows], self._remark[rows] = COMPLETED, engine, self._slot(remark)

    def _note(self, row: int, status: int, engine: int, remark: str) -> None:
        self._status[row], self._engine[row], self._remark[row] = status, engine, self._slot(remark)

    def _slot(self, remark: str) -> int:
        """Return the number of a remark, 0 for none."""
        if not remark:
            return 0
        if remark not in self._texts:
            if len(self._texts) == SLOTS:
                return SLOTS
            self._texts.append(remark if len(self._texts) < SLOTS - 1 else _MORE)
        return self._texts.index(remark) + 1 if remark in self._texts else SLOTS


def _numbered(column: Column) -> NDArray[np.int64]:
    """Return a whole number for each value of a column, the same for the same value."""
    if isinstance(column, np.ndarray):
        return np.unique(column, return_inverse=True)[1]
    known = {value: number for number, value in enumerate(dict.fromkeys(column))}
    return np.array([known[value] for value in column], dtype=np.int64)


def _alone(built: Built, name: str) -> Scene:
    """Return the scene of one axis or group alone: they share nothing but the bus."""
    return parts_of(built.permitted())[name]


def _figures_alone(recipe: Recipe, scene: Scene, asked: Sequence[str]) -> tuple[Mapping[str, float], bool, str]:
    """Return the figures of one axis or group, whether its loop was compiled, and why a group's could not be."""
    cycles = cycles_in(recipe, scene)
    if is_display(scene):
        return display_figures(scene, cycles, asked), False, ""
    if not scene.groups:
        return run_scalar(scene, cycles, asked), False, ""
    case = group_case(scene)
    is_compiled = recipe.engine == "numba" and case.is_compilable
    return group_figures(group_meter(case, cycles, recipe.engine), asked), is_compiled, case.why_not


def _remark_of(built: Built, *, is_batched: bool = False) -> str:
    """Return what was given to an algorithm, and what of the scene is not in its loop."""
    return _joined(built.remark, not_in_loop(built.permitted(), is_batched=is_batched))


def _joined(*remarks: str) -> str:
    return "; ".join(remark for remark in remarks if remark)


def _is_taken(scene: Scene, name: str) -> bool:
    """Whether the algorithm has a property of its own that another of the sweep has."""
    section, _, key = name.rpartition(".")
    axis = scene.axes[0]
    own = type(axis.passivity.parameters).model_fields
    return section != "passivity" or key in own or key in type(axis.loop).model_fields


@lru_cache(maxsize=64)
def _free_keys(recipe: Recipe) -> frozenset[str]:
    """Return the keys with a range, whose ends decide for all values between."""
    return frozenset(v.key for v in recipe.varied if v.spacing != "list" and is_batch_key(recipe, v.key))
