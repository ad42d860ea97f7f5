"""Follows an energy log while another process writes it: each look gives the rows that came since the last one.

The file is opened for reading only, anew for every look, so that a log which is replaced (packed at its end, begun
again) is followed, and the writer never waits for the reader.
"""

from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from canhaptic.errors import LogFormatError
from canhaptic.logs.columns import Event
from canhaptic.logs.energy_reader import EnergyLog

_Array = NDArray[Any]

_MOST_AT_ONCE: Final = 200_000  # rows; a viewer that comes late takes the past in pieces
_PORT_COLUMNS: Final = ("position", "torque_command", "torque_applied", "h_i", "h_r", "h_dis", "statusword", "fresh")


class News(NamedTuple):
    """What one look found."""

    status: str
    rows: int  # in the log, so far
    restarted: bool  # another run has begun in this file: what was drawn is past
    time: _Array  # of the new rows [s]
    cycle_time: _Array  # [s]
    ports: dict[str, dict[str, _Array]]  # new rows, with energies summed from the beginning
    units: dict[str, str]  # of each port's position
    events: list[Event]  # all so far
    fresh_share: float  # TPDOs that came, of all expected, since the beginning
    group_of: dict[str, str]  # of each axis in a group, whose account is the group's

    @property
    def groups(self) -> frozenset[str]:
        """Ports that are groups, which have no position."""
        return frozenset(self.group_of.values())


class LiveLog:
    """An energy log that is being written.

    Args:
        path: The log; it need not be there yet.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._forget()

    def _forget(self) -> None:
        self._rows = 0
        self._sums: dict[str, tuple[float, float]] = {}
        self._expected = self._missed = 0
        self._run: tuple[Any, ...] = ()

    def look(self) -> News | None:
        """Returns what is new; None while there is no log that can be read."""
        try:
            with EnergyLog.open(self.path) as log:
                return self._take(log)
        except LogFormatError:  # not there yet, or just being replaced
            return None

    def _take(self, log: EnergyLog) -> News:
        run = (log.sample_time_ns, str(log.attributes.get("config_hash")), tuple(log.ports))
        restarted = bool(self._run) and (log.rows < self._rows or run != self._run)
        if restarted:
            self._forget()
        self._run = run
        start, stop = self._rows, min(log.rows, self._rows + _MOST_AT_ONCE)
        index = log.timing.read("sync_index", start, stop)
        busy = sum(
            (log.timing.read(name, start, stop) for name in ("sync_to_last_tpdo", "compute", "send")),
            start=np.zeros(stop - start),
        )
        ports = {name: self._port(log, name, start, stop) for name in log.ports}
        self._rows = stop
        return News(
            log.status,
            log.rows,
            restarted,
            index * log.sample_time,
            busy * 1e-9,
            ports,
            {name: port.unit("position") for name, port in log.ports.items()},
            log.events,
            1.0 - self._missed / self._expected if self._expected else 1.0,
            log.group_of,
        )

    def _port(self, log: EnergyLog, name: str, start: int, stop: int) -> dict[str, _Array]:
        rows = {column: log.ports[name].read(column, start, stop) for column in _PORT_COLUMNS}
        before_in, before_dissipated = self._sums.get(name, (0.0, 0.0))
        taken_in = before_in + np.cumsum(rows.pop("h_i"))
        dissipated = before_dissipated + np.cumsum(rows.pop("h_r"))
        if len(taken_in):
            self._sums[name] = float(taken_in[-1]), float(dissipated[-1])
        if name not in log.groups:
            self._expected += len(taken_in)
            self._missed += int((rows["fresh"] == 0).sum())
        return {**rows, "taken_in": taken_in, "dissipated": dissipated, "margin": taken_in - dissipated}
