"""What is drawn of one port: a few thousand rows out of millions, no spike lost, every row around what matters."""

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from canhaptic.audit.extent import contacts
from canhaptic.logs.columns import Event
from canhaptic.logs.energy_reader import EnergyLog
from canhaptic.logs.hdf5 import Array
from canhaptic.view.decimate import decimate

FAULTS: Final = frozenset({"fault", "emcy", "stop", "limit"})
"""Kinds of events that are marked."""
_BUCKETS: Final = 400  # per quantity; about twice as many rows
_FULL_SPAN: Final = 0.25  # [s] drawn row by row on either side of the worst margin and of each fault
_FULL_PLACES: Final = 10
_FULL_ROWS: Final = 2000  # at each of them, at most


COLUMNS: Final = {
    "position": "position",
    "command": "torque_command",
    "applied": "torque_applied",
    "surplus": "h_dis",
    "damping": "damping_rendered",
}
"""What is drawn as it is logged -> its column in the log; energies in one entry are summed."""
_ENERGIES: Final = ("taken_in", "dissipated", "margin", "upper", "surplus", "deficit")


class MarkedEvent(NamedTuple):
    """An event that is marked."""

    time: float  # [s]
    event: Event


class PortFacts(NamedTuple):
    """What a panel must know of a port before the first row is drawn."""

    name: str
    is_group: bool  # of axes: it has no position
    is_member: bool  # an axis of a group, whose account is the group's
    units: dict[str, str]  # SI unit of each column
    wall: float | None  # where it begins [m or rad]
    wall_side: str  # of its inside: below or above

    @property
    def is_display(self) -> bool:
        """Whether velocities are commanded: an admittance display."""
        return self.units["command"] != self.units["applied"]


def port_facts(log: EnergyLog, name: str) -> PortFacts:
    """Returns what the attributes of a log say of a port."""
    port = log.ports[name]
    effort = port.unit("torque_applied")
    units = dict.fromkeys(_ENERGIES, "J") | {
        "time": "s",
        "position": port.unit("position"),
        "command": port.unit("torque_command"),
        "applied": effort,
        "damping": port.unit("damping_rendered"),
    }
    wall = log.attributes.get(f"{name}.wall_position")
    side = str(log.attributes.get(f"{name}.wall_side", "below"))
    place = float(wall) if isinstance(wall, int | float) else None
    return PortFacts(name, name in log.groups, name in log.group_of, units, place, side)


def losses(log: EnergyLog, start: int, stop: int) -> dict[str, Array]:
    """Returns for each row what was lost before it: SYNCs not sent, TPDOs that did not come, rows without room."""
    index = log.timing.read("sync_index", max(0, start - 1), stop).astype(np.int64)
    dropped = log.timing.read("dropped_before", start, stop).astype(np.int64)
    deadlines = log.deadlines(max(0, start - 1), stop).astype(np.int64)
    skipped = np.diff(deadlines - index, prepend=0 if start == 0 else deadlines[:1] - index[:1])
    gaps = np.diff(index, prepend=index[:1] - 1)[len(index) - len(dropped) :] - 1
    lost = {"SYNCs skipped": skipped[len(index) - len(dropped) :] + np.maximum(gaps - dropped, 0)}
    for name, port in log.ports.items():
        if name not in log.groups:
            lost[f"{name}: TPDOs missed"] = (port.read("fresh", start, stop) == 0).astype(np.int64)
    return lost | {"cycles not in the log": dropped}


class PortSeries:
    """The rows to draw of one port.

    Attributes:
        facts: Name, units, wall.
        columns: time [s] and what `facts.units` names, each of the same length; single precision but for the time.
        is_whole: Whether every row is drawn, none left out.
        sample_time: [s]
        worst: Time of the least margin [s].
        contacts: First and last time of each contact [s], greatest torque in it, and energy taken in.
        faults: Events to mark, each with its time [s].
    """

    def __init__(self, log: EnergyLog, name: str, rows: slice) -> None:
        self.facts = port_facts(log, name)
        self.sample_time = log.sample_time
        self._rows = rows
        self._port = log.ports[name]
        index = log.timing["sync_index"][rows]
        time = log.deadlines(rows.start, rows.stop) * log.sample_time
        full = self._columns()
        worst = int(full["margin"].argmin())
        self.worst = float(time[worst])
        self.faults = faults_of(log, name, index)
        self.contacts = self._contacts(time, full)
        places = [int(np.searchsorted(index, fault.event.sync_index)) for fault in self.faults]
        shown = self._shown(full, [worst, *places])
        self.is_whole = len(shown) == len(time)
        self.columns: dict[str, Array] = {"time": time[shown]} | {key: values[shown] for key, values in full.items()}
        self.columns["upper"] = np.maximum(self.columns["taken_in"], self.columns["dissipated"])

    def _read(self, name: str) -> Array:
        return self._port.read(name, self._rows.start, self._rows.stop)

    def _columns(self) -> dict[str, Array]:
        """Every row of what is drawn, in single precision: an hour of doubles would take half a gigabyte."""
        taken_in = np.cumsum(self._read("h_i"), dtype=np.longdouble)
        dissipated = np.cumsum(self._read("h_r"), dtype=np.longdouble)
        columns = {
            "taken_in": taken_in.astype(np.float32),
            "dissipated": dissipated.astype(np.float32),
            "margin": (taken_in - dissipated).astype(np.float32),
            "deficit": np.cumsum(self._read("deficit")).astype(np.float32),
        }
        del taken_in, dissipated
        return columns | {key: self._read(name).astype(np.float32) for key, name in COLUMNS.items()}

    def _contacts(self, time: Array, full: dict[str, Array]) -> dict[str, list[float]]:
        found = [] if self.facts.is_member else contacts(self._read("branch"))
        before = [max(0, first - 1) for first, _ in found]
        return {
            "start": [float(time[first]) for first, _ in found],
            "end": [float(time[last]) for _, last in found],
            "peak": [float(np.abs(full["applied"][first : last + 1]).max()) for first, last in found],
            "energy": [
                float(full["taken_in"][last]) - float(full["taken_in"][start])
                for start, (_, last) in zip(before, found, strict=True)
            ],
        }

    def _shown(self, full: dict[str, Array], places: Sequence[int]) -> Array:
        count = len(full["position"])
        picks = [decimate(values, _BUCKETS) for values in full.values()]
        span = min(_FULL_ROWS // 2, round(_FULL_SPAN / self.sample_time))
        picks += [np.arange(max(0, row - span), min(count, row + span)) for row in places[:_FULL_PLACES]]
        return np.unique(np.concatenate(picks))


def faults_of(log: EnergyLog, port: str, index: Array) -> list[MarkedEvent]:
    """Returns the events to mark that concern a port and lie within the SYNCs of `index`.

    The fault that ended a run came with a SYNC that has no row any more; it is moved to the last one that has.
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
