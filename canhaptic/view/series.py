"""What is drawn of one port: a few thousand rows out of millions, no spike lost, every row around what matters."""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from canhaptic.audit.extent import contacts
from canhaptic.logs.columns import Event
from canhaptic.logs.energy_reader import EnergyLog
from canhaptic.view.decimate import decimate

_Array = NDArray[Any]

_FAULTS: Final = frozenset({"fault", "emcy", "stop", "limit"})
"""Kinds of events that are marked."""
_BUCKETS: Final = 400  # per quantity; about twice as many rows
_FULL_SPAN: Final = 0.25  # [s] drawn row by row on either side of the worst margin and of each fault
_FULL_PLACES: Final = 10
_FULL_ROWS: Final = 2000  # at each of them, at most


class PortSeries:
    """The rows to draw of one port.

    Attributes:
        name: Of the port.
        is_group: Whether it is a group of axes, which has no position.
        is_member: Whether it is an axis of a group, whose account is the group's.
        columns: time [s], position, command, applied, taken_in, dissipated, margin, surplus and damping, each of the
            same length; single precision but for the time.
        units: SI unit of each column.
        sample_time: [s]
        worst: Time of the least margin [s].
        contacts: First and last time of each contact [s], greatest torque in it, and energy taken in.
        faults: Events to mark.
    """

    def __init__(self, log: EnergyLog, name: str, rows: slice) -> None:
        self.name = name
        self.is_group = name in log.groups
        self.is_member = name in log.group_of
        self.sample_time = log.sample_time
        self._rows = rows
        self._port = log.ports[name]
        index = log.timing["sync_index"][rows]
        time = index * log.sample_time
        full = self._columns()
        worst = int(full["margin"].argmin())
        self.worst = float(time[worst])
        self.faults = faults_of(log, name, index)
        self.contacts = self._contacts(time, full)
        shown = self._shown(full, [worst, *(int(np.searchsorted(index, fault.sync_index)) for fault in self.faults)])
        self.columns: dict[str, _Array] = {"time": time[shown]} | {key: values[shown] for key, values in full.items()}
        effort = self._port.unit("torque_applied")
        self.units = dict.fromkeys(("taken_in", "dissipated", "margin", "surplus"), "J") | {
            "time": "s",
            "position": self._port.unit("position"),
            "command": effort,
            "applied": effort,
            "damping": self._port.unit("damping_rendered"),
        }

    def _read(self, name: str) -> _Array:
        return self._port.read(name, self._rows.start, self._rows.stop)

    def _columns(self) -> dict[str, _Array]:
        """Every row of what is drawn, in single precision: an hour of doubles would take half a gigabyte."""
        taken_in = np.cumsum(self._read("h_i"), dtype=np.longdouble)
        dissipated = np.cumsum(self._read("h_r"), dtype=np.longdouble)
        columns = {
            "taken_in": taken_in.astype(np.float32),
            "dissipated": dissipated.astype(np.float32),
            "margin": (taken_in - dissipated).astype(np.float32),
        }
        del taken_in, dissipated
        names = {
            "position": "position",
            "command": "torque_command",
            "applied": "torque_applied",
            "surplus": "h_dis",
            "damping": "damping_rendered",
        }
        return columns | {key: self._read(name).astype(np.float32) for key, name in names.items()}

    def _contacts(self, time: _Array, full: dict[str, _Array]) -> dict[str, list[float]]:
        found = [] if self.is_member else contacts(self._read("branch"))
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

    def _shown(self, full: dict[str, _Array], places: Sequence[int]) -> _Array:
        count = len(full["position"])
        picks = [decimate(values, _BUCKETS) for values in full.values()]
        span = min(_FULL_ROWS // 2, round(_FULL_SPAN / self.sample_time))
        picks += [np.arange(max(0, row - span), min(count, row + span)) for row in places[:_FULL_PLACES]]
        return np.unique(np.concatenate(picks))


def faults_of(log: EnergyLog, port: str, index: _Array) -> list[Event]:
    """Returns the events to mark that concern a port and lie within the SYNCs of `index`.

    The fault that ended a run came with a SYNC that has no row any more; it is moved to the last one that has.
    """
    if not len(index):
        return []
    first, last = int(index[0]), int(index[-1])
    is_end = last == int(log.timing.read("sync_index", log.rows - 1)[0])
    return [
        event._replace(sync_index=min(event.sync_index, last))
        for event in log.events
        if event.kind in _FAULTS
        and event.port in {"", port}
        and first <= event.sync_index
        and (event.sync_index <= last or is_end)
    ]
