"""Reader of an energy log that another process is writing: each poll returns the rows added since the last one.

Every poll opens the file again, for reading only. The writer therefore never waits for the reader, and a log that is
replaced, by packing at its end or by another run, is followed.
"""

from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from canhaptic.audit.inspection import PortRecord, contacts
from canhaptic.control.verdict import PortResult
from canhaptic.errors import LogFormatError
from canhaptic.logs.energy_reader import EnergyLog
from canhaptic.logs.hdf5 import Array
from canhaptic.logs.repair import require_readable
from canhaptic.signals import CycleTiming
from canhaptic.view.series import COLUMNS, MarkedEvent, PortFacts, losses, port_facts

_MOST_AT_ONCE: Final = 200_000  # rows; a viewer that comes late takes the past in pieces
_S_PER_NS: Final = 1e-9


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
    accounts: dict[str, PortResult]  # what verdicts rest on, since the beginning
    events: list[MarkedEvent]  # all so far
    fresh_share: float  # TPDOs that came, of all expected, since the beginning
    group_of: dict[str, str]  # of each axis in a group, whose account is the group's
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
        start, stop = self._rows, min(log.rows, self._rows + _MOST_AT_ONCE)
        time = log.deadlines(start, stop) * log.sample_time
        ports = {name: self._port(log, name, start, stop) for name in log.ports}
        lost = {name: self._summed("", name, values) for name, values in losses(log, start, stop).items()}
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
            {name: port_facts(log, name) for name in log.ports},
            {name: record.account() for name, record in self._records.items()},
            [MarkedEvent(log.time_of(event.sync_index), event) for event in log.events],
            1.0 - self._missed / self._expected if self._expected else 1.0,
            log.group_of,
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
        rows["statusword"] = port.read("statusword", start, stop)
        summed = {"taken_in": "h_i", "dissipated": "h_r", "deficit": "deficit"}
        rows |= {key: self._summed(name, key, port.read(column, start, stop)) for key, column in summed.items()}
        if name not in self._records:
            self._records[name] = PortRecord(log, name)
        self._records[name].take(log, start, stop)
        if name not in log.groups:
            fresh = port.read("fresh", start, stop)
            self._expected += len(fresh)
            self._missed += int((fresh == 0).sum())
        taken_in, dissipated = rows["taken_in"], rows["dissipated"]
        return {**rows, "margin": taken_in - dissipated, "upper": np.maximum(taken_in, dissipated)}
