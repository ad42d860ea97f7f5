"""The plane in which a group of axes renders: the path of its handle, and where its surface is.

Mechanism and network are those that the log holds with the run; a log without them, a task space that is no plane and
a network without a surface have no such picture.
"""

import json
from collections.abc import Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np

from canhaptic.control.mechanisms import KINEMATICS
from canhaptic.control.mechanisms.kinematics import Kinematics
from canhaptic.control.multi_axis import NETWORKS
from canhaptic.control.port_hamiltonian.shapes.geometry import Rendered, coordinates_at
from canhaptic.errors import CanHapticError
from canhaptic.logs.energy_reader import EnergyLog
from canhaptic.logs.hdf5 import Array
from canhaptic.registry import load
from canhaptic.scene.models import task_unit
from canhaptic.view.decimate import decimate

_BUCKETS: Final = 1000
_GRID: Final = 121  # places along each side where the depth is taken
_MARGIN: Final = 0.25  # of the longer span of the path, shown on every side of it


class TaskPlane(NamedTuple):
    """A path and a surface [m or rad]."""

    name: str  # of the group
    unit: str
    time: Array  # of each place [s], (n,)
    path: Array  # (n, 2); NaN where the mechanism had no pose
    across: Array  # of the grid, (m,)
    along: Array  # of the grid, (m,)
    depth: Array  # in the material, above `surface` inside it, (m, m): rows along, columns across
    surface: float  # depth at the surface


def task_plane(log: EnergyLog, name: str, rows: slice) -> TaskPlane | None:
    """Return path and surface of a group; None where there is no such picture.

    Args:
        log: An open energy log.
        name: Name of the group's port.
        rows: Which of the log.
    """
    try:
        group = json.loads(str(log.attributes["config_resolved"]))["groups"][name]
        kinematics = _build(KINEMATICS, group["kinematics"])
        if kinematics.dimensions != 2:
            return None
        rendered: Rendered = _build(NETWORKS, group["network"]).build(2)
    except (KeyError, TypeError, ValueError, CanHapticError):  # no group, or written by a version that differs
        return None
    if not _has_surface(rendered):
        return None
    axes = log.groups[name]
    motors = np.array([log.ports[axis].read("position", rows.start, rows.stop) for axis in axes])
    shown = np.unique(np.concatenate([decimate(motor, _BUCKETS) for motor in motors]))
    path = np.array([_place(kinematics, position) for position in motors[:, shown].T.tolist()])
    if not np.isfinite(path).all(axis=1).any():
        return None
    margin = max(_MARGIN * float(np.max(np.nanmax(path, axis=0) - np.nanmin(path, axis=0))), 1e-3)
    across, along = (_span(values, margin) for values in path.T)
    depth = np.array([[_depth(rendered, (x, y)) for x in across.tolist()] for y in along.tolist()])
    # A path without width has no inside; its line is drawn as wide as one cell of the grid.
    surface = 0.0 if depth.min() < 0.0 else float(across[1] - across[0])
    unit = task_unit(group["kinematics"]["type"], log.ports[axes[0]].unit("position"))
    return TaskPlane(name, str(unit), log.time[rows][shown], path, across, along, depth, surface)


def _build(table: dict[str, str], section: Mapping[str, str]) -> Any:
    parameters = {key: value for key, value in section.items() if key != "type"}
    return load(table, section["type"], "part of a group")(**parameters)


def _has_surface(rendered: Rendered) -> bool:
    """Return whether some spring begins at an edge, and no state moves by itself."""
    tables = rendered.network.tables
    edges = zip(tables.lower, tables.upper, strict=True)
    return not tables.moving and any(low != high for low, high in edges)


def _depth(rendered: Rendered, position: Sequence[float]) -> float:
    """Return how far the spring that is deepest is beyond its edge; negative in free space [m or rad]."""
    tables, values = rendered.network.tables, coordinates_at(rendered.geometry, position)
    deepest = -np.inf
    for row, low, high in zip(tables.gain, tables.lower, tables.upper, strict=True):
        if low != high:
            state = sum(gain * value for gain, value in zip(row, values, strict=True))
            deepest = max(deepest, low - state, state - high)
    return float(deepest)


def _place(kinematics: Kinematics, position: list[float]) -> tuple[float, float]:
    pose = kinematics.pose(position)
    return (np.nan, np.nan) if pose.limit else (float(pose.position[0]), float(pose.position[1]))


def _span(values: Array, margin: float) -> Array:
    return np.linspace(float(np.nanmin(values)) - margin, float(np.nanmax(values)) + margin, _GRID)
