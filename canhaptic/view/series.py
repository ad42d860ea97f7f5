"""What is drawn of one port: its units, its wall, what was lost and which events are marked."""

from typing import Final, NamedTuple

import numpy as np

from canhaptic.logs.columns import Event
from canhaptic.logs.energy_reader import EnergyLog
from canhaptic.logs.hdf5 import Array

FAULTS: Final = frozenset({"fault", "emcy", "stop", "limit"})
"""Kinds of events that are marked."""
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
    """Return what the attributes of a log say of a port."""
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
    """Return for each row what was lost before it: SYNCs not sent, TPDOs that did not come, rows without room."""
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


def faults_of(log: EnergyLog, port: str, index: Array) -> list[MarkedEvent]:
    """Return the events to mark that concern a port and lie within the SYNCs of `index`.

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
