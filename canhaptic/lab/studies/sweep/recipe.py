"""From one row of values to a scene, or to the reason why there is none. Plain data: workers get it by pickle.

A value that is wrong by itself (`stiffness=abc`, an unknown key, a mass of -1) ends the sweep before it begins: it is a
slip of the pen. A row whose values are right and do not go together (a rate that the bus cannot carry, an algorithm
that lacks what it rests on) is a finding: the row is kept as refused, with the reason, and the others run.
"""

import itertools
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from canhaptic.control.admittance import DISPLAY_ALGORITHMS
from canhaptic.errors import InputError, ParameterError, SceneConflictError, SceneError
from canhaptic.lab.batch.engine import ChosenEngine
from canhaptic.lab.loop.accounts_over_can import known_algorithms
from canhaptic.lab.loop.algorithms import PLANT_OF, able_under, chosen_algorithms, display_under
from canhaptic.lab.loop.axis_loop import Array
from canhaptic.lab.loop.scenes import at_rate, cycles_of, parts_of
from canhaptic.lab.studies.sweep.places import places_of
from canhaptic.lab.studies.sweep.points import CONTROLLER, Points, scene_seed, scene_seeds
from canhaptic.lab.studies.sweep.vary import Value, Varied
from canhaptic.scene.load import scene_from_text
from canhaptic.scene.models import AxisScene, Scene
from canhaptic.scene.own_code import require_same_code

RATE: Final = "bus.rate"
_SEED: Final = "simulation.seed"
_MOST_CORNERS: Final = 6
"""Keys of which every corner is tried; of more, the neighbours of two opposite corners."""

Row = tuple[tuple[str, Value], ...]
"""(key, value) of one scene, or of several that share these values."""


@dataclass(frozen=True, slots=True)
class Recipe:
    """How every scene of a sweep is made.

    Attributes:
        source: File of the scene, the start of relative paths.
        text: The scene.
        overrides: Values that replace those of the scene before anything varies.
        varied: The keys; of a range only its ends.
        places: Override paths of each key, in the order of `varied`.
        axes: Names of the axes that render by themselves, and of the groups.
        duration: Length of every run [s]; None: that of the scene.
        cycles: SYNCs of every scene; None: by the duration.
        metrics: Asked for.
        engine: For scenes that fit a batch; chosen once, so that workers need not agree on it.
        beyond_bus: Whether a rate is judged that the bus could not carry.
        seed: From which every scene's own follows.
        allow_code: Whether the program files that scenes name may run, here and in workers.
        own_code: (file or plug-in, SHA-256) of what the scene names; a worker that has another refuses the scene.
        displays: Whether every axis is an admittance display.
        alone: Why every scene runs by itself although it might fit a batch; "" where batches pay.
    """

    source: str
    text: str
    overrides: tuple[str, ...]
    varied: tuple[Varied, ...]
    places: tuple[tuple[str, ...], ...]
    axes: tuple[str, ...]
    duration: float | None
    cycles: int | None
    metrics: tuple[str, ...]
    engine: ChosenEngine
    beyond_bus: bool
    seed: int
    alone: str = ""
    displays: bool = False
    allow_code: bool = False
    own_code: tuple[tuple[str, str], ...] = ()


class Built(NamedTuple):
    """A scene, or why there is none."""

    scene: Scene | None
    remark: str  # why it is refused, or what was given to an algorithm
    from_plant: tuple[str, ...] = ()  # loop properties taken from the plant

    def permitted(self) -> Scene:
        """Return the scene.

        Raises:
            InputError: There is none.
        """
        if self.scene is None:
            raise InputError(self.remark)
        return self.scene


def make_recipe(
    scene: Scene,
    points: Points,
    *,
    metrics: tuple[str, ...],
    engine: ChosenEngine,
    duration: float | None = None,
    cycles: int | None = None,
    beyond_bus: bool = False,
    allow_code: bool = False,
) -> Recipe:
    """Return the recipe of a sweep, every value tried on its own.

    Raises:
        InputError: The scene has no text or simulation, or an unknown algorithm is asked for.
        SceneError: A key or a value is wrong by itself.
    """
    if not scene.text:
        raise InputError(
            f"{scene.source}: a sweep needs the text of its scene; make it by load_scene or scene_from_text"
        )
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
        tuple(parts_of(scene)),
        duration,
        cycles,
        metrics,
        engine,
        beyond_bus,
        scene.simulation.seed if scene.simulation else 0,
        displays=all(axis.parameters.admittance is not None for axis in scene.axes),
        allow_code=allow_code or bool(scene.own_code),
        own_code=tuple(scene.own_code.items()),
    )
    for varied in recipe.varied:
        _try_alone(recipe, varied)
    return recipe


@lru_cache(maxsize=256)
def scene_of(recipe: Recipe, row: Row) -> Built:
    """Return the scene of a row of values, checked as if it had been written so.

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
            scene = at_rate(scene, float(rate))
    except InputError as error:
        return Built(None, _first_line(error))
    return Built(scene, "") if controller is None else _under(scene, str(controller))


def seeded(recipe: Recipe, scene: Scene, index: int) -> Scene:
    """Return a scene with everything random in it by its global index, unless the sweep varies the seed itself."""
    if scene.simulation is None or any(varied.key == _SEED for varied in recipe.varied):
        return scene
    seed = scene_seed(recipe.seed, index)
    axes = tuple(
        replace(axis, simulation=axis.simulation and replace(axis.simulation, seed=seed + i))
        for i, axis in enumerate(scene.axes)
    )
    return replace(scene, axes=axes, simulation=scene.simulation.model_copy(update={"seed": seed}))


def seeds_of(recipe: Recipe, scene: Scene, indices: NDArray[np.intp]) -> Array | None:
    """Return what `seeded` gives the first axis of the scenes of some global indices; None where it gives nothing."""
    if scene.simulation is None or any(varied.key == _SEED for varied in recipe.varied):
        return None
    return scene_seeds(recipe.seed, indices)


def cycles_in(recipe: Recipe, scene: Scene) -> int:
    """Return the SYNCs of a scene."""
    return recipe.cycles or cycles_of(scene, recipe.duration)


@lru_cache(maxsize=4096)
def is_box_permitted(recipe: Recipe, shared: Row) -> bool:
    """Return whether every scene with these values is permitted, for all values of the other keys.

    Every limit of a scene is a bound from below or above, so that what holds in the corners of a box holds inside.
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


def _try_alone(recipe: Recipe, varied: Varied) -> None:
    """Refuse a value that no other value could make right.

    Raises:
        SceneError: One is; the message is that of the scene.
    """
    if varied.key == CONTROLLER:
        names = [str(value) for value in varied.values]
        if recipe.displays:
            known_algorithms(DISPLAY_ALGORITHMS, "admittance algorithm", names)
        else:
            chosen_algorithms(names)
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


def _under(scene: Scene, controller: str) -> Built:
    """Return the scene with every axis under an algorithm, which takes from the plant what it cannot do without."""
    axes: list[AxisScene] = []
    remark = ""
    from_plant: tuple[str, ...] = ()
    if scene.groups:
        return Built(None, f"{CONTROLLER} {controller}: group {scene.groups[0].name!r} has algorithms of its own")
    for axis in scene.axes:
        try:
            if axis.parameters.admittance is not None:
                axes.append(display_under(axis, controller))
                continue
            chosen = able_under(axis, controller, scene)
        except ParameterError as error:
            return Built(None, _first_line(error))
        axes.append(chosen.axis)
        remark, from_plant = chosen.remark or remark, chosen.from_plant or from_plant
    return Built(replace(scene, axes=tuple(axes)), remark, from_plant)


def of_plant(from_plant: tuple[str, ...]) -> dict[str, str]:
    """Return which batch key of the loop follows which of the plant, for properties that were taken from it."""
    return {f"passivity.{key}": f"simulation.plant.{PLANT_OF[key]}" for key in from_plant}


def _first_line(error: Exception) -> str:
    """Return the first fault of an error without the override that it names, which is one of the sweep's own."""
    line = str(error).splitlines()[0]
    return line.partition(": ")[2] if line.startswith("--set ") else line
