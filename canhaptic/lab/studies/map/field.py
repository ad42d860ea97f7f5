"""The figures of a sweep by the values of its keys: a grid as arrays with one dimension per key, samples as lists."""

import json
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from canhaptic.errors import InputError
from canhaptic.lab.loop.algorithms import display_under, with_algorithm
from canhaptic.lab.loop.axis_loop import Array
from canhaptic.lab.loop.display_loop import is_display
from canhaptic.lab.studies.sweep.chunk import COMPLETED
from canhaptic.lab.studies.sweep.points import CONTROLLER
from canhaptic.lab.studies.sweep.sweep_table import SweepTable
from canhaptic.scene.load import scene_from_text
from canhaptic.scene.models import Scene
from canhaptic.units import Parameters

Mask = NDArray[np.bool_]


class MapField:
    """One axis of a sweep under one algorithm.

    Args:
        table: The file.
        axis: Name of the axis.
        controller: Name of the algorithm; "" for that of the scene where none was varied.
        allow_code: Whether program files that the scene names may run.

    Attributes:
        keys: Numeric keys with more than one value, in the order given.
        values: Every value of each of them, in the order of a grid; of each scene, for samples.
        is_grid: Whether figures have one dimension per key.
        scene: Before anything varied, of this axis alone under this algorithm.
        algorithm: Its name.
        is_display: Whether the axis is an admittance display.
    """

    def __init__(self, table: SweepTable, axis: str, controller: str = "", *, allow_code: bool = False) -> None:
        self._table, self.axis = table, axis
        self.index = table.axes.index(axis)
        self.is_grid = not table.identity["samples"]
        varied = table.identity["varied"]
        names = [str(entry["key"]) for entry in varied]
        self._rows: Any = slice(None)
        if controller:
            self._rows = np.array(table.values(CONTROLLER)) == controller
        if self.is_grid:
            self._levels = {key: _levels(table.values(key)) for key in names if key != CONTROLLER}
        numeric = {str(entry["key"]) for entry in varied if entry["numbers"]}
        self.keys = [key for key in names if key in numeric and self._is_varied(key)]
        self.values = {key: self._values(key) for key in self.keys}
        self.scene = _scene(table, axis, controller, allow_code)
        self.algorithm = self.scene.axes[0].passivity.name
        self.unit = self.scene.axes[0].parameters.unit
        self.is_display = is_display(self.scene)

    def figure(self, metric: str) -> Array:
        """Return a figure, one dimension per key of `keys` and one for all others in a grid; NaN where none is."""
        found = self._shaped(self._table.figure(self.axis, metric))
        return np.where(self.judged(), found, np.nan)

    def judged(self) -> Mask:
        """Return which scenes were run to their end, shaped as a figure."""
        found: Mask = self._shaped(self._table.status() == COMPLETED)
        return found

    def has(self, metric: str) -> bool:
        """Whether the sweep asked for a figure."""
        return metric in self._table.metrics

    def label(self, key: str) -> str:
        """Return a key with its unit, for an axis of a picture."""
        unit = _unit_of(self.scene, key)
        return f"{key} [{unit}]" if unit else key

    def level(self, key: str, value: float) -> str:
        """Return one value of a key in words, such as `damping 5 N*s/m`."""
        return f"{key.rpartition('.')[2]} {value:.3g} {_unit_of(self.scene, key)}".rstrip()

    def _is_varied(self, key: str) -> bool:
        return len(self._levels[key]) > 1 if self.is_grid else len(_levels(self._table.values(key))) > 1

    def _values(self, key: str) -> Array:
        if self.is_grid:
            return np.array(self._levels[key])
        found: Array = np.asarray(self._table.values(key))[self._rows]
        return found

    def _shaped(self, column: NDArray[Any]) -> Any:
        """Return a column of this algorithm; of a grid with the numeric keys first, all others last."""
        rows = column[self._rows]
        if not self.is_grid:
            return rows
        names = list(self._levels)
        cube = rows.reshape([len(self._levels[key]) for key in names])
        order = [names.index(key) for key in self.keys] + [i for i, key in enumerate(names) if key not in self.keys]
        cube = cube.transpose(order)
        return cube.reshape(*cube.shape[: len(self.keys)], -1)


def fields_of(table: SweepTable, axis: str | None = None, *, allow_code: bool = False) -> list[MapField]:
    """Return one field per algorithm.

    Args:
        table: The file.
        axis: Name of the axis; the first by default.
        allow_code: Whether program files that the scene names may run.

    Raises:
        InputError: No such axis, nothing is finished, or nothing numeric varies.
    """
    name = axis or table.axes[0]
    if name not in table.axes:
        raise InputError(f"{table.path}: has no axis {name!r}, expected one of: {', '.join(table.axes)}")
    if not table.done().any():
        raise InputError(f"{table.path}: no chunk is finished yet, there is nothing to draw; let the sweep run on")
    controllers = list(dict.fromkeys(table.values(CONTROLLER))) if CONTROLLER in table.keys else [""]
    fields = [MapField(table, name, str(controller), allow_code=allow_code) for controller in controllers]
    if not fields[0].keys:
        raise InputError(f"{table.path}: no key with numbers was varied, there is no axis to draw along")
    return fields


def _levels(column: Any) -> list[Any]:
    values = column.tolist() if isinstance(column, np.ndarray) else column
    return list(dict.fromkeys(values))


def _scene(table: SweepTable, axis: str, controller: str, allow_code: bool) -> Scene:
    """Return the scene before anything varied, of one axis alone."""
    overrides = json.loads(table.note("overrides"))
    scene = scene_from_text(table.note("scene"), table.note("source"), overrides, allow_code=allow_code)
    chosen = next(one for one in scene.axes if axis in (one.parameters.name, one.group))
    if not controller:
        return replace(scene, axes=(chosen,))
    under = with_algorithm if chosen.parameters.admittance is None else display_under
    return replace(scene, axes=(under(chosen, controller),))


def _unit_of(scene: Scene, key: str) -> str:
    """Return the unit that the model of a varied key gives it on the axis of a scene; "" for a pure number."""
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
