"""Data of a log as pictures and live pages draw them: decimated rows, facts about a port, faults, new rows.

`LiveLog` reads a log that another process is writing. Every poll opens the file again, for reading only. The writer
therefore never waits for the reader, and a log that is replaced, by packing at its end or by another run, is followed.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from canhaptic.audit.inspection import PortRecord, contacts, walls_of
from canhaptic.control.mechanisms import KINEMATICS
from canhaptic.control.mechanisms.kinematics import Kinematics
from canhaptic.control.multi_axis import NETWORKS
from canhaptic.control.port_hamiltonian.shapes import Rendered, coordinates_at
from canhaptic.control.verdict import PortResult
from canhaptic.errors import CanHapticError, LogFormatError
from canhaptic.logs.columns import Event
from canhaptic.logs.energy_reader import EnergyLog, Quantities
from canhaptic.logs.hdf5 import Array
from canhaptic.logs.repair import require_readable
from canhaptic.registry import load
from canhaptic.scene.models import task_unit
from canhaptic.signals import CycleTiming

_MOST_AT_ONCE: Final = 200_000  # rows; a viewer that comes late takes the past in pieces
_S_PER_NS: Final = 1e-9


def decimate(values: NDArray[np.generic], buckets: int) -> NDArray[np.intp]:
    """Return the indices of samples to draw: the smallest and the largest of every bucket, and both ends.

    A spike of one sample is kept, which taking every n-th sample would lose.

    Args:
        values: Shape (n,); NaN counts as an extreme.
        buckets: Number of buckets, about half the number of points wanted.

    Returns:
        Ascending indices; all of them if there are at most two samples per bucket.
    """
    length = len(values)
    if length <= 2 * buckets:
        return np.arange(length)
    size = -(-length // buckets)
    whole = length // size * size
    blocks = values[:whole].reshape(-1, size)
    starts = np.arange(0, whole, size)
    indices = [starts + blocks.argmin(axis=1), starts + blocks.argmax(axis=1), np.array([0, length - 1])]
    if whole < length:
        rest = values[whole:]
        indices.append(whole + np.array([rest.argmin(), rest.argmax()]))
    return np.unique(np.concatenate(indices))


def decimate_together(columns: Iterable[NDArray[np.generic]], buckets: int) -> NDArray[np.intp]:
    """Return the indices of the rows to draw for several columns: the union of `decimate` over the columns."""
    return np.unique(np.concatenate([decimate(values, buckets) for values in columns]))


FAULTS: Final = frozenset({"fault", "emcy", "stop", "limit"})
"""Kinds of events that are marked in pictures."""
COLUMNS: Final = {
    "position": "position",
    "command": "torque_command",
    "applied": "torque_applied",
    "surplus": "surplus",
    "damping": "damping_rendered",
}
"""Drawn quantity -> log column with its values."""
_ENERGIES: Final = ("taken_in", "dissipated", "margin", "upper", "surplus", "deficit")


class MarkedEvent(NamedTuple):
    """An event of the log with its time."""

    time: float  # [s]
    event: Event


class PortFacts(NamedTuple):
    """Constants of a port that its panels need before the first row."""

    name: str
    has_motion: bool  # it is an axis
    has_account: bool  # of its own
    units: dict[str, str]  # SI unit of each column
    walls: list[tuple[float, str]]  # where each begins [m or rad], and on which side its inside is: below or above
    notches: list[float]  # of detents, around the first one [m or rad]
    torque_limit: float  # [N or N*m]; infinite where none is known
    plane: "Plane | None"  # of a group whose handle moves in a plane
    drawn: tuple[str, str]  # see `drawn_effort`


def drawn_effort(port: Quantities) -> tuple[str, str]:
    """Return the panel in which the commands of a port are drawn, and the name of the torque or force that acts."""
    is_torque = port.unit("torque_command") == port.unit("torque_applied")
    return ("torque", "applied") if is_torque else ("velocity", "on the hand")


def port_facts(log: EnergyLog, name: str) -> PortFacts:
    """Read the constants of a port from a log."""
    port = log.ports[name]
    effort = port.unit("torque_applied")
    units = dict.fromkeys(_ENERGIES, "J") | {
        "time": "s",
        "position": port.unit("position"),
        "command": port.unit("torque_command"),
        "applied": effort,
        "damping": port.unit("damping_rendered"),
    }
    pitch, start = (log.number(f"{name}.wall_{key}") for key in ("pitch", "position"))
    reach = 0.49 * _MOST_NOTCHES * pitch
    limit = log.number(f"{name}.torque_limit", math.inf)
    notches = notches_of(log, name, start - reach, start + reach)
    walls, plane = walls_of(log, name), None if name in log.axes else plane_of(log, name)
    return PortFacts(
        name, name in log.axes, name in log.accounts, units, walls, notches, limit, plane, drawn_effort(port)
    )


_MOST_NOTCHES: Final = 200


def notches_of(log: EnergyLog, name: str, low: float, high: float) -> list[float]:
    """Return the notches of detents between two positions [m or rad]; empty for another environment."""
    place, pitch = (log.attributes.get(f"{name}.wall_{key}") for key in ("position", "pitch"))
    if not (isinstance(place, float) and isinstance(pitch, float) and 0.0 < high - low < _MOST_NOTCHES * pitch):
        return []
    return [place + k * pitch for k in range(math.ceil((low - place) / pitch), math.floor((high - place) / pitch) + 1)]


def losses(log: EnergyLog, start: int, stop: int) -> dict[str, Array]:
    """Return the losses just before each row: SYNCs skipped, TPDOs missed per axis, and cycles not in the log."""
    parts = [_losses(log, at, min(at + _BLOCK, stop)) for at in range(start, max(stop, start + 1), _BLOCK)]
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


_BLOCK: Final = 65_536  # rows held in memory at a time


def _missed(axis: str) -> str:
    return f"{axis}: TPDOs missed"


def _losses(log: EnergyLog, start: int, stop: int) -> dict[str, Array]:
    index = log.timing.read("sync_index", max(0, start - 1), stop).astype(np.int64)
    dropped = log.timing.read("dropped_before", start, stop).astype(np.int64)
    deadlines = log.deadlines(max(0, start - 1), stop).astype(np.int64)
    skipped = np.diff(deadlines - index, prepend=0 if start == 0 else deadlines[:1] - index[:1])
    gaps = np.diff(index, prepend=index[:1] - 1)[len(index) - len(dropped) :] - 1
    lost = {"SYNCs skipped": skipped[len(index) - len(dropped) :] + np.maximum(gaps - dropped, 0)}
    for name in log.axes:
        lost[_missed(name)] = log.ports[name].read("fresh", start, stop) == 0
    lost["cycles not in the log"] = dropped
    return {name: of.astype(np.int32) for name, of in lost.items()}


def faults_of(log: EnergyLog, port: str, index: Array) -> list[MarkedEvent]:
    """Return the faults of a port, and of the whole rig, within the SYNCs of `index`.

    A fault that ended the run has a SYNC without a row; it is moved to the last row.
    """
    if not len(index):
        return []
    first, last = int(index[0]), int(index[-1])
    is_end = last == int(log.timing.read("sync_index", log.rows - 1)[0])
    moved = (
        event._replace(sync_index=min(event.sync_index, last))
        for event in log.events
        if event.kind in FAULTS
        and event.port in {"", port}
        and first <= event.sync_index
        and (event.sync_index <= last or is_end)
    )
    return [MarkedEvent(log.time_of(event.sync_index), event) for event in moved]


_BUCKETS: Final = 1000
_GRID: Final = 121  # places along each side where the depth is taken
_MARGIN: Final = 0.25  # of the longer span of the path, shown on every side of it


class TaskPlane(NamedTuple):
    """Path of a handle in a plane, and the depth in the material on a grid of that plane [m or rad]."""

    unit: str
    path: Array  # (n, 2); NaN where the mechanism had no pose
    across: Array  # of the grid, (m,)
    along: Array  # of the grid, (m,)
    depth: Array  # in the material, above `surface` inside it, (m, m): rows along, columns across
    surface: float  # depth at the surface
    further: tuple[tuple[Array, float], ...] = ()  # the same two of the other parts of a sum


class Plane(NamedTuple):
    """The plane in which the handle of a group moves, and what it may touch there."""

    axes: tuple[str, ...]  # of the group
    unit: str
    kinematics: Any
    surfaces: list[Rendered]  # the parts of its network that have one
    links: tuple[float, ...]  # of a five-bar: half the distance of the motors, the proximal links [m]; else empty

    def path(self, motors: Array) -> Array:
        """Return the places of the handle, shape (n, 2) [m or rad], at positions of the motors, shape (axes, n)."""
        return np.array([_place(self.kinematics, position) for position in motors.T.tolist()]).reshape(-1, 2)

    def drawn(self, path: Array) -> TaskPlane | None:
        """Return the material around a path; None if nothing of it is known, or nothing has a surface."""
        if not self.surfaces or not np.isfinite(path).all(axis=1).any():
            return None
        margin = max(_MARGIN * float(np.max(np.nanmax(path, axis=0) - np.nanmin(path, axis=0))), 1e-3)
        across, along = (_span(values, margin) for values in path.T)
        depths = [np.array([[_depth(part, (x, y)) for x in across.tolist()] for y in along.tolist()])
                  for part in self.surfaces]  # fmt: skip
        # A path without width has no inside; its line is drawn as wide as one cell of the grid.
        edges = [0.0 if depth.min() < 0.0 else float(across[1] - across[0]) for depth in depths]
        first, *further = sorted(zip(depths, edges, strict=True), key=lambda part: part[1])
        return TaskPlane(self.unit, path, across, along, *first, tuple(further))


def plane_of(log: EnergyLog, name: str) -> Plane | None:
    """Return the plane of a group, from the mechanism and network in its log.

    None if the log does not have them, or the task space is not a plane.

    Args:
        log: An open energy log.
        name: Name of the group's port.
    """
    try:
        group = log.decoded("config_resolved", dict[str, dict[str, Any]]())["groups"][name]
        kinematics = _build(KINEMATICS, group["kinematics"])
        if kinematics.dimensions != 2:
            return None
        network = group["network"]
        sections = network if isinstance(network, list) else [network]
        rendered: list[Rendered] = [_build(NETWORKS, section).build(2) for section in sections]
    except (KeyError, TypeError, ValueError, CanHapticError):  # no group, or written by a version that differs
        return None
    kind, axes = group["kinematics"]["type"], log.groups[name]
    links = (0.5 * kinematics.base, *kinematics.proximal) if kind == "five_bar" else ()
    unit = str(task_unit(kind, log.ports[axes[0]].unit("position")))
    return Plane(tuple(axes), unit, kinematics, [part for part in rendered if _has_surface(part)], links)


def task_plane(log: EnergyLog, name: str, rows: slice) -> TaskPlane | None:
    """Return path and surface of a group over rows of its log; None as of `plane_of`, or without a surface."""
    plane = plane_of(log, name)
    if plane is None or not plane.surfaces:
        return None
    motors = np.array([log.ports[axis].read("position", rows.start, rows.stop) for axis in plane.axes])
    return plane.drawn(plane.path(motors[:, decimate_together(motors, _BUCKETS)]))


def _build(table: dict[str, str], section: Mapping[str, str]) -> Any:
    parameters = {key: value for key, value in section.items() if key != "type"}
    return load(table, section["type"], "part of a group")(**parameters)


def _has_surface(rendered: Rendered) -> bool:
    """Return whether a surface can be drawn: a spring has a dead zone with an edge, and no part moves by itself."""
    tables = rendered.network.tables
    edges = zip(tables.lower, tables.upper, strict=True)
    return not tables.moving and any(low != high for low, high in edges)


def _depth(rendered: Rendered, position: Sequence[float]) -> float:
    """Return the largest penetration beyond the edge of any spring; negative in free space [m or rad]."""
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


class News(NamedTuple):
    """New data of the log, found by one poll."""

    status: str
    rows: int  # in the log, so far
    restarted: bool  # the file now holds another run: clear what was drawn
    time: Array  # of the new rows [s]
    timing: dict[str, Array]  # durations within each new cycle [s]
    lost: dict[str, Array]  # of the new rows, summed from the beginning
    ports: dict[str, dict[str, Array]]  # new rows, with energies summed from the beginning
    contacts: dict[str, list[tuple[float, float]]]  # first and last time in each contact, of the new rows [s]
    facts: dict[str, PortFacts]
    accounts: dict[str, PortResult]  # what the verdict of each account rests on, since the beginning
    events: list[MarkedEvent]  # all so far
    fresh_share: float  # TPDOs that came, of all expected, since the beginning
    sample_time: float  # [s]


class LiveLog:
    """An energy log that is being written.

    Args:
        path: Path of the log, which need not exist yet.

    Attributes:
        trouble: Reason why the last poll could not read the log; "" if it could, or if no file exists yet.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.trouble = ""
        self._forget()

    def _forget(self) -> None:
        self._rows = 0
        self._sums: dict[tuple[str, str], float] = {}  # of each port's column; losses belong to port ""
        self._records: dict[str, PortRecord] = {}
        self._expected = self._missed = 0
        self._run: tuple[int, str, tuple[str, ...]] | None = None
        self._facts: dict[str, PortFacts] = {}

    def look(self) -> News | None:
        """Poll the log: return the new data, or None while there is no readable log."""
        try:
            if self._run is None:
                require_readable(self.path)
            with EnergyLog.open(self.path) as log:
                self.trouble = ""
                return self._take(log)
        except LogFormatError as error:  # not there yet, just being replaced, or damaged
            self.trouble = str(error) if self.path.exists() else ""
            return None

    def _take(self, log: EnergyLog) -> News:
        run = (log.sample_time_ns, str(log.attributes.get("config_hash")), tuple(log.ports))
        restarted = self._run is not None and (log.rows < self._rows or run != self._run)
        if restarted:
            self._forget()
        self._run = run
        self._facts = self._facts or {name: port_facts(log, name) for name in log.ports}
        start, stop = self._rows, min(log.rows, self._rows + _MOST_AT_ONCE)
        time = log.deadlines(start, stop) * log.sample_time
        ports = {name: self._port(log, name, start, stop) for name in log.ports}
        found = losses(log, start, stop)
        self._expected += (stop - start) * len(log.axes)
        self._missed += sum(int(found[_missed(name)].sum()) for name in log.axes)
        lost = {name: self._summed("", name, values) for name, values in found.items()}
        touched = {name: contacts(log.ports[name].read("branch", start, stop)) for name in log.ports}
        self._rows = stop
        return News(
            log.status,
            log.rows,
            restarted,
            time,
            {name: log.timing.read(name, start, stop) * _S_PER_NS for name in CycleTiming._fields},
            lost,
            ports,
            {name: [(float(time[a]), float(time[b])) for a, b in spans] for name, spans in touched.items()},
            self._facts,
            {name: self._records[name].account() for name in log.accounts},
            [MarkedEvent(log.time_of(event.sync_index), event) for event in log.events],
            1.0 - self._missed / self._expected if self._expected else 1.0,
            log.sample_time,
        )

    def _summed(self, port: str, name: str, values: Array) -> Array:
        """Return the running sum of a column, continued from the last poll."""
        total = self._sums.get((port, name), 0) + np.cumsum(values)
        if len(total):
            self._sums[port, name] = total[-1]
        return np.asarray(total)

    def _port(self, log: EnergyLog, name: str, start: int, stop: int) -> dict[str, Array]:
        port = log.ports[name]
        rows = {key: port.read(column, start, stop) for key, column in COLUMNS.items()}
        rows |= {key: port.read(key, start, stop) for key in ("statusword", "branch", "certificate")}
        summed = {"taken_in": "interaction", "dissipated": "dissipated", "deficit": "deficit"}
        rows |= {key: self._summed(name, key, port.read(column, start, stop)) for key, column in summed.items()}
        if name not in self._records:
            self._records[name] = PortRecord(log, name)
        self._records[name].take(log, start, stop)
        taken_in, dissipated = rows["taken_in"], rows["dissipated"]
        return {**rows, "margin": taken_in - dissipated, "upper": np.maximum(taken_in, dissipated)}
