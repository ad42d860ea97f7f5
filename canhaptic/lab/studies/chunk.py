"""Compute the figures of consecutive scenes of a sweep (`run_chunk`), from its recipe and the values of each scene.

Scenes that fit the batch engine run together, others one by one, with the reason stored. No scene depends on another,
so that the size of a chunk changes no figure. A recipe is plain data, which workers receive by pickle.

A short key such as `environment.stiffness` applies to every axis, even one with its own `environment`. A key with a
full path (`axes.0.environment.stiffness`, `bus.rate`) applies to that entry only.

A value that is wrong by itself (`stiffness=abc`, an unknown key, a mass of -1) is an error before the sweep starts. If
valid values do not fit together (a rate that the bus cannot carry, an algorithm without a value that it needs), that
scene is stored as refused, with the reason, and the others run.
"""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from canhaptic.drive.profile.causality import IMPEDANCE
from canhaptic.errors import CanHapticError, InputError, ParameterError, SceneConflictError, SceneError
from canhaptic.lab.batch import ChosenEngine
from canhaptic.lab.batch.cases import NotBatchableError, not_in_loop, why_not_batchable, why_not_compared
from canhaptic.lab.batch.marching import run_batch, spectral_radius
from canhaptic.lab.batch.scalar import run_port
from canhaptic.lab.batch.varied import BATCH_KEYS
from canhaptic.lab.figures.figures import ALL, DISPLAY_METRICS, METRICS, OUTCOMES
from canhaptic.lab.loop import axis_loop
from canhaptic.lab.loop.axis_loop import Array, UnderAlgorithm
from canhaptic.lab.studies.vary import CONTROLLER, Column, Points, Value, Varied, scene_seeds
from canhaptic.scene.document import Diagnostics, MarkedList, MarkedMapping, parse_yaml
from canhaptic.scene.layout import OWN_SECTIONS
from canhaptic.scene.load import scene_from_text
from canhaptic.scene.models import SIMULATION_PARTS, Scene
from canhaptic.scene.overrides import apply_overrides
from canhaptic.scene.own_code import require_same_code


def places_of(scene: Scene, keys: tuple[str, ...]) -> dict[str, tuple[str, ...]]:
    """Return the paths at which each key must be overridden.

    Args:
        scene: Valid scene, loaded from text.
        keys: Keys as given to `--vary`.
    """
    faults = Diagnostics()
    document = parse_yaml(scene.text, scene.source, faults)
    apply_overrides(document, scene.overrides, faults)
    return {key: _places(document, key) for key in keys}


def batch_key(key: str, axis: int, name: str) -> str | None:
    """Return the name of a key in a scene with only one of the axes; None if the key does not affect that axis.

    Args:
        key: Key as given to `--vary`.
        axis: Index of the axis.
        name: Name of the axis.
    """
    head, _, rest = key.removeprefix("simulation.").partition(".")
    if head != "axes":
        return key
    which, _, below = rest.partition(".")
    if key != f"{head}.{rest}":
        return f"simulation.{below}" if which == name else None
    if which not in (str(axis), name):
        return None
    return below if below.partition(".")[0] in OWN_SECTIONS else f"axes.0.{below}"


def _places(document: MarkedMapping, key: str) -> tuple[str, ...]:
    """Return the path of a key in the common section, and its paths in axes with their own section."""
    head, _, rest = key.partition(".")
    part, owner = rest.partition(".")[0], document.get("simulation")
    if head in OWN_SECTIONS and rest:
        part, owner, entries = head, document, document.get("axes")
        every = enumerate(entries if isinstance(entries, MarkedList) else ())
        own = [f"axes.{i}.{key}" for i, entry in every if _has(entry, head)]
    elif head == "simulation" and part in SIMULATION_PARTS:
        axes = owner.get("axes") if isinstance(owner, MarkedMapping) else None
        named = axes.items() if isinstance(axes, MarkedMapping) else ()
        own = [f'simulation.axes."{name}".{rest}' for name, parts in named if _has(parts, part)]
    else:
        return (key,)
    return (*([key] if _has(owner, part) or not own else []), *own)


def _has(value: object, name: str) -> bool:
    return isinstance(value, MarkedMapping) and isinstance(value.get(name), MarkedMapping | MarkedList)


RATE: Final = "bus.rate"
_SEED: Final = "simulation.seed"
_MOST_CORNERS: Final = 6
"""Largest number of keys for which all corners of the ranges are tried; above, the neighbours of two opposite ones."""

Row = tuple[tuple[str, Value], ...]
"""(key, value) pairs of one scene, or pairs that several scenes share."""


@dataclass(frozen=True, slots=True)
class Recipe:
    """Data from which every scene of a sweep can be made.

    Attributes:
        source: File of the scene, the base of relative paths.
        text: Text of the scene.
        overrides: Overrides of the scene that apply to all of the sweep.
        varied: Varied keys; of a range only the ends.
        places: Paths at which each key is overridden, in the order of `varied`.
        axes: Names of the axes outside groups, and of the groups.
        seed: Seed from which the seed of each scene is derived.
        metrics: Requested metrics.
        engine: Engine for scenes that fit a batch; chosen once, so that all workers use the same.
        duration: Length of every run [s]; None: that of the scene.
        cycles: Number of SYNCs of every run; None: from the duration.
        beyond_bus: Whether rates that the bus could not carry are accepted.
        allow_code: Whether the program files that scenes name may run, here and in workers.
        own_code: (file or plug-in, SHA-256) of the scene's user code; a worker with different code refuses the scene.
        is_alone: Whether scenes run one by one even if they fit a batch, as too few of them would share one.
    """

    source: str
    text: str
    overrides: tuple[str, ...]
    varied: tuple[Varied, ...]
    places: tuple[tuple[str, ...], ...]
    axes: tuple[str, ...]
    seed: int
    metrics: tuple[str, ...]
    engine: ChosenEngine
    duration: float | None = None
    cycles: int | None = None
    beyond_bus: bool = False
    is_alone: bool = False
    allow_code: bool = False
    own_code: tuple[tuple[str, str], ...] = ()


def make_recipe(scene: Scene, points: Points, *, allow_code: bool = False, **options: Any) -> Recipe:
    """Return the recipe of a sweep, after each value was checked by itself.

    Args:
        scene: Simulated scene, from a file or text.
        points: Scenes of the sweep.
        allow_code: Whether the program files that scenes name may run.
        options: Further attributes of the recipe: metrics, engine, and optionally duration, cycles and beyond_bus.

    Raises:
        InputError: The scene has no text or simulation, or a far side, or an algorithm is unknown.
        SceneError: A key or a value is wrong by itself.
    """
    if not scene.text:
        raise InputError(
            f"{scene.source}: a sweep needs the text of its scene; make it by load_scene or scene_from_text"
        )
    axis_loop.require_near(scene)
    moved = {name for of in scene.mechanisms for name in of.axes}
    if not all(axis.simulation is not None or axis.parameters.name in moved for axis in scene.axes):
        raise InputError(f"{scene.source}: has no `simulation`, expected a plant and a user on every axis; add one")
    places = places_of(scene, tuple(v.key for v in points.varied))
    recipe = Recipe(
        scene.source,
        scene.text,
        scene.overrides,
        tuple(v if v.spacing == "list" else replace(v, values=v.ends) for v in points.varied),
        tuple(places[v.key] for v in points.varied),
        tuple(axis_loop.parts_of(scene)),
        scene.simulation.seed if scene.simulation else 0,
        allow_code=allow_code or bool(scene.own_code),
        own_code=tuple(scene.own_code.items()),
        **options,
    )
    for varied in recipe.varied:
        _try_alone(recipe, scene, varied)
    return recipe


@lru_cache(maxsize=256)
def scene_of(recipe: Recipe, row: Row) -> UnderAlgorithm:
    """Return the scene of a recipe with the values of a row, checked like a scene file with these values.

    Args:
        recipe: Recipe of the sweep.
        row: Values of some or all keys.
    """
    values = dict(row)
    controller, rate = values.pop(CONTROLLER, None), None
    if recipe.beyond_bus and isinstance(values.get(RATE), float):
        rate = values.pop(RATE)
    try:
        scene = _read(recipe, _overrides(recipe, values))
        if rate is not None:
            scene = axis_loop.at_rate(scene, float(rate))
    except InputError as error:
        return UnderAlgorithm(None, _first_line(error))
    if controller is None:
        return UnderAlgorithm(scene)
    return axis_loop.tried(scene, str(controller))


def seeded(recipe: Recipe, scene: Scene, index: int) -> Scene:
    """Return a scene with the seed that belongs to its global index, unless the sweep varies the seed."""
    seeds = seeds_of(recipe, scene, np.array([index]))
    if scene.simulation is None or seeds is None:
        return scene
    seed = int(seeds[0])
    axes = tuple(
        replace(axis, simulation=axis.simulation and replace(axis.simulation, seed=seed + i))
        for i, axis in enumerate(scene.axes)
    )
    return replace(scene, axes=axes, simulation=scene.simulation.model_copy(update={"seed": seed}))


def seeds_of(recipe: Recipe, scene: Scene, indices: NDArray[np.intp]) -> Array | None:
    """Return the seeds that `seeded` gives to the scenes at the given indices of a sweep; None if it changes none."""
    if scene.simulation is None or any(varied.key == _SEED for varied in recipe.varied):
        return None
    return scene_seeds(recipe.seed, indices)


def cycles_in(recipe: Recipe, scene: Scene) -> int:
    """Return the number of SYNCs of a scene's run."""
    return recipe.cycles or axis_loop.cycles_of(scene, recipe.duration)


@lru_cache(maxsize=4096)
def is_box_permitted(recipe: Recipe, shared: Row) -> bool:
    """Return whether all scenes that share some values are permitted, for all values of the other keys.

    Every limit of a scene is an upper or lower bound, so that it is enough to check the corners of the ranges.
    """
    fixed = {key for key, _ in shared}
    free = [v for v in recipe.varied if v.key not in fixed]
    return all(scene_of(recipe, (*shared, *corner)).scene is not None for corner in _corners(free))


def _corners(free: list[Varied]) -> list[Row]:
    ends = [[(v.key, end) for end in v.ends] for v in free]
    if len(free) <= _MOST_CORNERS:
        return [tuple(corner) for corner in itertools.product(*ends)]
    low, high = tuple(e[0] for e in ends), tuple(e[-1] for e in ends)
    near = [(*low[:i], high[i], *low[i + 1 :]) for i in range(len(free))]
    far = [(*high[:i], low[i], *high[i + 1 :]) for i in range(len(free))]
    return [low, high, *near, *far]


def _try_alone(recipe: Recipe, scene: Scene, varied: Varied) -> None:
    """Refuse a value that is wrong by itself, for all values of the other keys.

    Raises:
        SceneError: A value is wrong; with the message of the scene.
    """
    if varied.key == CONTROLLER:
        for port in scene.ports:
            axis_loop.chosen_algorithms([str(value) for value in varied.values], port.algorithms)
        return
    for value in varied.ends:
        texts = _overrides(recipe, {varied.key: value}, with_unit=True)
        try:
            _read(recipe, texts)
        except SceneConflictError:
            continue  # other values may go with it
        except SceneError as error:
            raise SceneError([fault.replace("--set ", "--vary ", 1) for fault in error.faults]) from error


def _read(recipe: Recipe, overrides: list[str]) -> Scene:
    every = [*recipe.overrides, *overrides]
    scene = scene_from_text(recipe.text, recipe.source, every, allow_code=recipe.allow_code)
    expected = dict(recipe.own_code)
    common = {name: digest for name, digest in scene.own_code.items() if name in expected}  # a varied value has its own
    require_same_code(common, {name: expected[name] for name in common}, recipe.source)
    return scene


def _overrides(recipe: Recipe, values: Mapping[str, Value], *, with_unit: bool = False) -> list[str]:
    texts = []
    for varied, places in zip(recipe.varied, recipe.places, strict=True):
        if varied.key in values:
            text = varied.yaml(values[varied.key], with_unit=with_unit)
            texts += [f"{place}={text}" for place in places]
    return texts


def _first_line(error: Exception) -> str:
    """Return the first line of an error, without the name of the override that the sweep made."""
    line = str(error).splitlines()[0]
    return line.partition(": ")[2] if line.startswith("--set ") else line


RADIUS: Final = "spectral_radius"
"""Metric: largest |eigenvalue| of the linear sampled loop; NaN where the loop is not linear."""
FIGURES: Final = tuple(dict.fromkeys((*ALL, RADIUS, *DISPLAY_METRICS)))
USUAL: Final = (*METRICS, RADIUS)
"""Metrics that need no continuous run; the default."""


def usual_figures(scene: Scene) -> tuple[str, ...]:
    """Return the default metrics of a sweep, for the ports of the scene."""
    kinds = [USUAL if port.causality is IMPEDANCE else DISPLAY_METRICS for port in scene.ports]
    return tuple(dict.fromkeys(name for kind in kinds for name in kind))


STATUS: Final = ("pending", "completed", "refused", "failed", *OUTCOMES[1:])
COMPLETED, REFUSED, _FAILED, UNTOUCHED, UNRENDERED = range(1, len(STATUS))
ENGINES: Final = ("none", "closed form", "python", "numba", "scalar")

_CLOSED_FORM, _SCALAR = ENGINES.index("closed form"), ENGINES.index("scalar")
BATCHED: Final = frozenset(f"{section}.{name}" for section, names in BATCH_KEYS.items() for name in names)
"""All keys that may vary inside a batch."""
_Rows = NDArray[np.intp]


class ChunkResult(NamedTuple):
    """Results of a chunk; every array has shape (n_scenes,)."""

    figures: dict[str, Array]  # by "axis/metric"; NaN where a metric does not apply
    status: NDArray[np.uint8]  # index in STATUS
    engine: NDArray[np.uint8]  # index in ENGINES
    remark: NDArray[np.object_]  # why it was refused or ran alone, or which properties came from the plant; "" for none
    of_plant: str = ""  # note on the properties taken from the simulated plant; "" for none


def run_chunk(recipe: Recipe, start: int, columns: Mapping[str, Column]) -> ChunkResult:
    """Compute the figures of consecutive scenes.

    Args:
        recipe: Recipe of the sweep.
        start: Global index of the first scene.
        columns: Values of the scenes by key, of equal length.
    """
    return _Chunk(recipe, start, columns).run()


def is_batch_key(recipe: Recipe, key: str) -> bool:
    """Return whether a key may vary inside a batch, on every axis that it affects."""
    names = [batch_key(key, index, name) for index, name in enumerate(recipe.axes)]
    return all(name is None or name in BATCHED for name in names)


class _Chunk:
    """Computation of one chunk, see `run_chunk`."""

    def __init__(self, recipe: Recipe, start: int, columns: Mapping[str, Column]) -> None:
        self._recipe, self._start, self._columns = recipe, start, columns
        self._count = len(next(iter(columns.values())))
        self._free = _free_keys(recipe)
        names = [f"{axis}/{metric}" for axis in recipe.axes for metric in recipe.metrics]
        self._figures = {name: np.full(self._count, np.nan) for name in names}
        self._status, self._engine = np.zeros((2, self._count), dtype=np.uint8)
        self._remark = np.full(self._count, "", dtype=np.object_)
        self._of_plant = ""

    def run(self) -> ChunkResult:
        """Compute the figures of every scene of the chunk."""
        batched = {key for key in self._columns if is_batch_key(self._recipe, key)}
        apart = {key for key in self._columns if key not in batched}
        if RATE in self._columns and self._recipe.cycles is None:
            apart.add(RATE)  # scenes of one duration differ in their number of holds
        permitted = self._permitted()
        for rows in self._alike(apart, permitted):
            self._run_alike(rows, tuple(sorted(batched)))
        return ChunkResult(self._figures, self._status, self._engine, self._remark, self._of_plant)

    def _permitted(self) -> _Rows:
        """Return the rows whose values are permitted; store the others as refused."""
        refused = []
        for rows in self._alike({key for key in self._columns if key not in self._free}, np.arange(self._count)):
            if is_box_permitted(self._recipe, self._row(int(rows[0]), set(self._columns) - self._free)):
                continue
            for row in rows.tolist():
                built = scene_of(self._recipe, self._row(row))
                if built.scene is None:
                    refused.append(row)
                    self._note(row, REFUSED, 0, built.remark)
        return np.setdiff1d(np.arange(self._count), np.array(refused, dtype=np.intp))

    def _alike(self, keys: set[str], rows: _Rows) -> list[_Rows]:
        """Return rows with equal values of the given keys together, in the order of their first row."""
        kinds = np.zeros(len(rows), dtype=np.int64)
        for key in keys:
            numbers = np.unique(np.asarray(self._columns[key])[rows], return_inverse=True)[1]
            kinds = np.unique(kinds * (numbers.max(initial=0) + 1) + numbers, return_inverse=True)[1]
        _, first, kinds = np.unique(kinds, return_index=True, return_inverse=True)
        together = np.split(rows[np.argsort(kinds, kind="stable")], np.cumsum(np.bincount(kinds))[:-1])
        return [together[number] for number in np.argsort(first).tolist()]

    def _row(self, row: int, keys: set[str] | None = None) -> Row:
        return row_of(self._columns, row, keys)

    def _run_alike(self, rows: _Rows, batched: Sequence[str]) -> None:
        built = scene_of(self._recipe, self._row(int(rows[0])))
        self._of_plant = built.remark if built.from_plant else self._of_plant
        not_linear = self._closed_form(built, rows, batched) if RADIUS in self._recipe.metrics else ""
        if self._recipe.metrics == (RADIUS,):
            self._note(rows, COMPLETED, 0 if not_linear else _CLOSED_FORM, _joined(not_linear, _remark_of(built)))
            return
        reason = "" if self._recipe.is_alone else self._in_arrays(built, rows, batched)
        if reason or self._recipe.is_alone:
            self._one_by_one(rows, reason)

    def _closed_form(self, built: UnderAlgorithm, rows: _Rows, batched: Sequence[str]) -> str:
        """Store the spectral radius if the loop is linear; return "", else why it is not."""
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

    def _in_arrays(self, built: UnderAlgorithm, rows: _Rows, batched: Sequence[str]) -> str:
        """Run the rows as one batch for each axis; return "", else the reason why they cannot run in a batch."""
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
        self._note(rows, COMPLETED, engine, _remark_of(built, is_batched=True))
        for row, text in stopped.items():
            self._note(int(rows[row]), _FAILED, engine, text)
        return ""

    def _varied(
        self, built: UnderAlgorithm, scene: Scene, index: int, rows: _Rows, batched: Sequence[str]
    ) -> dict[str, Array]:
        """Return the values that vary within a batch of one axis, by key of `BATCH_KEYS`."""
        varied: dict[str, Array] = {}
        for key in batched:
            name = batch_key(key, index, self._recipe.axes[index])
            values = self._columns[key]
            if name is None or not isinstance(values, np.ndarray) or not _is_taken(scene, name):
                continue
            varied[name] = np.ascontiguousarray(values[rows])
            follows = (own for own in built.from_plant if name == f"simulation.plant.{axis_loop.PLANT_OF[own]}")
            varied |= {f"passivity.{own}": varied[name] for own in follows}  # what is taken from the plant varies too
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
            failure, engine, why = "", _SCALAR, reason
            for name in self._recipe.axes:
                scene = seeded(self._recipe, _alone(built, name), self._start + row)
                try:
                    figures, is_compiled, why_not = run_port(
                        scene, cycles_in(self._recipe, scene), asked, self._recipe.engine
                    )
                except CanHapticError as error:
                    failure = str(error).splitlines()[0]
                    continue
                if is_compiled:
                    engine, why = ENGINES.index("numba"), ""
                elif why_not:
                    why = f"not compiled: {why_not}"
                for metric in asked:
                    self._figures[f"{name}/{metric}"][row] = figures[metric]
            remark = failure or _joined(why, _remark_of(built))
            self._note(row, _FAILED if failure else COMPLETED, engine, remark)

    def _note(self, rows: _Rows | int, status: int, engine: int, remark: str) -> None:
        self._status[rows], self._engine[rows], self._remark[rows] = status, engine, remark


def row_of(columns: Mapping[str, Column], row: int, keys: set[str] | None = None) -> Row:
    """Return the values of one scene at the given keys; None: at all keys."""
    return tuple(
        (key, float(values[row]) if isinstance(values, np.ndarray) else values[row])
        for key, values in columns.items()
        if keys is None or key in keys
    )


def _alone(built: UnderAlgorithm, name: str) -> Scene:
    """Return the scene with only one axis or group."""
    return axis_loop.parts_of(built.permitted())[name]


def _remark_of(built: UnderAlgorithm, *, is_batched: bool = False) -> str:
    """Return the note on properties taken from the plant, and on bus effects that the loop omits."""
    return _joined(built.remark, not_in_loop(built.permitted(), is_batched=is_batched))


def _joined(*remarks: str) -> str:
    return "; ".join(remark for remark in remarks if remark)


def _is_taken(scene: Scene, name: str) -> bool:
    """Return whether the algorithm of a scene has the varied parameter, which may belong to another algorithm."""
    section, _, key = name.rpartition(".")
    axis = scene.axes[0]
    own = type(axis.passivity.parameters).model_fields
    return section != "passivity" or key in own or key in type(axis.loop).model_fields


@lru_cache(maxsize=64)
def _free_keys(recipe: Recipe) -> frozenset[str]:
    """Return the keys that vary over a range inside a batch: if its ends are permitted, so are the values between."""
    return frozenset(v.key for v in recipe.varied if v.spacing != "list" and is_batch_key(recipe, v.key))
