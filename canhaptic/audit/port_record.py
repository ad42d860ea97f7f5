"""Figures of a port in an energy log in addition to its ledger, read in pieces from a finished or a growing log.

Selection of the rows of a log: a span of time, or each contact.

Stored values that no run writes: signs of a damaged log or a faulty logger.

They are numbers that are not finite, running counts that fall, and rows that do not fit their digest.
"""

from collections.abc import Callable
from math import inf
from typing import Final, TypedDict, TypeVar

import numpy as np

from canhaptic.control.balance import OUT_OF_CONTACT, Branch, certificates_of
from canhaptic.control.friction_watch import FrictionDeclared, FrictionWatch
from canhaptic.control.mass_felt import MassAsked, MassFelt
from canhaptic.control.verdict import ACTIVE_AT_HANDLE, ACTIVE_AT_MOTOR, NOT_CHECKED, PortResult, claim_nothing
from canhaptic.errors import InputError, LogFormatError
from canhaptic.logs.columns import ACTIVE_LIMITS, DIGEST, FRICTION_DECLARED
from canhaptic.logs.energy_reader import EnergyLog, damage_told
from canhaptic.logs.hdf5 import Array
from canhaptic.meters import ActiveLimits, PortFigures, Promise
from canhaptic.result import port_account
from canhaptic.signals import Measured


def rows_between(log: EnergyLog, start: float | None, stop: float | None) -> slice:
    """Return the rows after time `start` [s] and up to `stop` [s]; None: from the first row, or to the last.

    Raises:
        InputError: No cycle lies between them.
    """
    if start is None and stop is None:
        return slice(0, log.rows)
    time = log.time
    first = 0 if start is None else int(np.searchsorted(time, start))
    last = log.rows if stop is None else int(np.searchsorted(time, stop))
    if first >= last:
        end = f"{time[-1]:.6g}" if len(time) else "0"
        raise InputError(f"{log.path}: no cycle from {start} s to {stop} s; the log ends at {end} s")
    return slice(first, last)


def rows_to_draw(log: EnergyLog, start: float | None, stop: float | None) -> slice:
    """Return the rows of `rows_between`; raise an error where there are none.

    Raises:
        InputError: It holds no cycle, or none between them.
    """
    if log.rows == 0:
        raise InputError(f"{log.path}: the log holds no cycle, so there is nothing to draw")
    return rows_between(log, start, stop)


def contacts(branch: Array) -> list[tuple[int, int]]:
    """Return (first, last) row of every stretch in which every hold was booked by a branch other than `free`.

    A contact continues across a hold whose sample was lost.
    """
    rows = np.flatnonzero(branch != Branch.HELD.value)
    edges = np.flatnonzero(np.diff(branch[rows] != Branch.FREE.value, prepend=False, append=False))
    ends = [int(rows[edge]) if edge < len(rows) else len(branch) for edge in edges[1::2]]
    return [(int(start), end - 1) for start, end in zip(rows[edges[::2]], ends, strict=True)]


_Compared = TypeVar("_Compared")
_BLOCK: Final = 65_536  # rows held in memory at a time
_COUNTS: Final = frozenset({"uncommanded"})
"""Columns that count from the beginning of a run; a recomputation does not have them."""


CHANGED: Final = "not as the run wrote it"


class ImpossibleValue(TypedDict):
    """A column with values that no run writes."""

    dataset: str
    what: str
    rows: int  # how many
    cycle: int  # the first


def impossible_values(log: EnergyLog) -> list[ImpossibleValue]:
    """Return each column that holds a value that no run writes.

    Raises:
        LogFormatError: A column cannot be read.
    """
    found: list[ImpossibleValue] = []
    for group, quantities in log.tables.items():
        for name in quantities if group != "timing" else ():
            rows, first, before = 0, -1, 0
            for start in range(0, log.rows, _BLOCK):
                values = quantities.read(name, start, start + _BLOCK)
                if name in _COUNTS:
                    values = values.astype(np.int64)
                    bad = np.flatnonzero(np.diff(values, prepend=before) < 0)
                    before = int(values[-1])
                elif values.dtype.kind == "f":
                    bad = np.flatnonzero(~np.isfinite(values))
                else:
                    break
                first = start + int(bad[0]) if first < 0 and len(bad) else first
                rows += len(bad)
            if rows:
                cycle = int(log.timing.read("sync_index", first, first + 1)[0])
                what = "a decreasing count" if name in _COUNTS else "not finite"
                found.append({"dataset": f"{group}/{name}", "what": what, "rows": rows, "cycle": cycle})
    if changed := log.changed_rows():
        cycle = int(log.timing.read("sync_index", changed[0], changed[0] + 1)[0])
        found.append({"dataset": DIGEST, "what": CHANGED, "rows": len(changed), "cycle": cycle})
    return found


class PortRecord(PortFigures):
    """Adds up the figures of `canhaptic.meters.RunMeters` from the columns of a log.

    Args:
        log: View of the log.
        name: Name of the port.
        start: First row that counts.
    """

    def __init__(self, log: EnergyLog, name: str, start: int = 0) -> None:
        port, before = log.ports[name], start - 1
        super().__init__(
            limits_of(log, name) or ActiveLimits(0.0, inf, log.sample_time),
            is_damped=f"{name}.is_damped" in log.attributes,
            books_least=port.unit("torque_command") != port.unit("torque_applied"),
            damping_asked=None if name in log.groups else log.number(f"{name}.damping_asked"),
        )
        self._name, self._is_dry, self._sample_time = name, log.dry_run, log.sample_time
        losses = int(log.number(f"{name}.max_consecutive_losses"))
        self._promise = Promise(losses, log.number(f"{name}.energy_allowance"))
        self._largest_torque = log.number(f"{name}.torque_limit", inf)
        self._is_measured, self._knows_active = "energy_resolution" in port, "active" in port
        self._dissipated = self._at(log, "device_dissipated", before) if start else 0.0
        self._unknown = self._at(log, "energy_resolution", before) if start else 0.0
        self._before = int(self._at(log, "active", before)) if start and self._knows_active else 0
        self.least_certain = self.least_certain_at_handle = -self._unknown
        self._measured, self._gap = Measured(2.0 * self._unknown, 0.0, 0.0, 1, 0, 0), 1
        self._certificates, self._is_open, self._in = 0, False, 0.0
        self._interaction, self._least = np.longdouble(0.0), 0.0
        self._watch = _declared(log, f"{name}.{FRICTION_DECLARED}", lambda of: FrictionWatch(FrictionDeclared(**of)))
        self.felt = _declared(log, f"{name}.mass_asked", lambda of: MassFelt(MassAsked(**of)))
        self._hold, self._environment = "", log.attributes.get(f"{name}.environment")
        self._wall = log.attributes.get(f"{name}.wall_position")

    def _at(self, log: EnergyLog, column: str, row: int) -> float:
        return float(log.ports[self._name].read(column, row, row + 1)[0]) if self._is_measured else 0.0

    def take(self, log: EnergyLog, start: int, stop: int) -> None:
        """Take the next rows."""
        port = log.ports[self._name]
        if stop <= start:
            return
        branch, torque = port.read("branch", start, stop), port.read("torque_command", start, stop)
        h_i = port.read("h_i", start, stop)
        self._in += float(h_i[h_i > 0.0].sum())
        running = self._interaction + np.cumsum(h_i, dtype=np.longdouble)
        self._interaction = running[-1]
        self._least = min(self._least, float(running.min()))
        for number in np.unique(port.read("certificate", start, stop)[torque != 0.0]):
            self._certificates |= 1 << int(number)
        touching = ~np.isin(branch, OUT_OF_CONTACT)
        self.contacts += int(touching.sum())
        if not self.contacts and self.damping_asked is not None:
            position = port.read("position", start, stop)[branch != Branch.HELD]
            low, high = position.min(initial=self.reach[0]), position.max(initial=self.reach[1])
            self.reach = float(low), float(high)
        self.silent += int((touching & (torque == 0.0)).sum())
        self.damping += float(port.read("damping_rendered", start, stop)[touching].sum())
        self._is_open = bool(branch[-1] == Branch.HELD)
        if not self._hold:
            axes = log.groups.get(self._name, (self._name,))
            found = [event.text for event in log.events if event.kind == "hold" and event.port in axes]
            self._hold = max(found, key=NOT_CHECKED.__eq__, default="")
        if self._is_measured:
            self._take_measured(log, start, stop, running, torque, branch)

    def _take_measured(
        self, log: EnergyLog, start: int, stop: int, running: Array, torque: Array, branch: Array
    ) -> None:
        port = log.ports[self._name]
        dissipated = port.read("device_dissipated", start, stop) - self._dissipated
        resolution = port.read("energy_resolution", start, stop)
        if self.least_at_handle is not None:
            self.least_at_handle = min(self.least_at_handle, float((running + dissipated).min()))
        certain, at_handle = (running - resolution).min(), (running + dissipated - resolution).min()
        self.least_certain = min(self.least_certain, float(certain) - self._unknown)
        self.least_certain_at_handle = min(self.least_certain_at_handle, float(at_handle) - self._unknown)
        longest, uncommanded = (int(port.read(key, stop - 1, stop)[0]) for key in ("longest_hold", "uncommanded"))
        known = float(resolution[-1]) + self._unknown, float(dissipated[-1])
        self._measured = Measured(*known, 0.0, longest, uncommanded, 0)
        asked = port.read("effort_asked", start, stop)
        booked = (asked != 0.0) & (branch != Branch.HELD)
        self.asked += float(asked[booked].sum())
        self.rendered -= float(torque[booked].sum())
        self.sizes_asked += float(np.minimum(np.abs(asked[booked]), self._largest_torque).sum())
        self.sizes_sent += float(np.abs(torque[booked]).sum())
        if self._knows_active:
            self._take_active(log, start, port.read("active", start, stop))
        if self._watch is not None or self.felt is not None:
            self._take_motion(log, start, stop, branch)
        deadlines = log.deadlines(max(0, start - 1), stop)
        if len(deadlines) > 1:
            self._gap = max(self._gap, int(np.diff(deadlines).max()))

    def _take_active(self, log: EnergyLog, start: int, active: Array) -> None:
        for bit, key in ((ACTIVE_AT_MOTOR, "since"), (ACTIVE_AT_HANDLE, "at_handle_since")):
            if getattr(self.activity, key) is None and not self._before & bit and active[-1] & bit:
                row = start + int(np.argmax(active & bit > 0))
                setattr(self.activity, key, int(log.deadlines(row, row + 1)[0]))

    def _take_motion(self, log: EnergyLog, start: int, stop: int, branch: Array) -> None:
        port, booked = log.ports[self._name], branch != Branch.HELD
        names = ("position", "torque_applied", "effort_asked")
        position, torque, asked = (port.read(name, start, stop)[booked].tolist() for name in names)
        deadlines = log.deadlines(start, stop)[booked].tolist()
        for row in zip(position, torque, deadlines, asked, strict=True):
            if self._watch is not None:
                self._watch.take(*row)
            if self.felt is not None:
                self.felt.take(*row[:3])

    @property
    def longest_gap(self) -> int:
        """Largest number of sample times between two SYNCs."""
        return self._gap

    @property
    def friction_excess(self) -> float | None:
        """Force in excess of declared friction and hand [N or N*m]; None without that check."""
        return None if self._watch is None else self._watch.excess

    def measured(self) -> Measured:
        """Return the figures so far that the log holds."""
        return self._measured

    def account(self) -> PortResult:
        """Figures so far, by the names of `run --json`, without verdicts."""
        certificates = [certificate.name.lower() for certificate in certificates_of(self._certificates)]
        account: PortResult = {
            "in": self._in,
            "least_interaction": self._least,
            "certificate": certificates[-1] if certificates else "exact",
            "certificates": certificates,
            "contact": {"holds": self.contacts, "without_torque": self.silent},
            "open_hold": self._is_open,
            "max_consecutive_losses": self._promise.max_consecutive_losses,
            "energy_allowance": self._promise.energy_allowance,
            **({"hold": self._hold} if self._hold else {}),
        }
        if self._is_measured:
            account = port_account(self, account, self._promise, self._sample_time)
            if self._before & ACTIVE_AT_MOTOR:
                account["active_before"] = True
        if isinstance(self._environment, str):
            account["environment"] = self._environment
        if isinstance(self._wall, float):
            account["wall"] = self._wall
        if self._is_dry:
            claim_nothing(account)
        return account


def limits_of(log: EnergyLog, name: str) -> ActiveLimits | None:
    """Limits behind the column `active` of a port; None where the log does not hold them.

    Raises:
        LogFormatError: The attribute is damaged.
    """
    if f"{name}.{ACTIVE_LIMITS}" not in log.attributes:
        return None
    numbers = log.decoded(f"{name}.{ACTIVE_LIMITS}", dict[str, float]())
    if not all(key in ActiveLimits._fields and isinstance(value, float) for key, value in numbers.items()):
        raise LogFormatError(f"{log.path}: attribute {name}.{ACTIVE_LIMITS} cannot be used; the file is damaged")
    return ActiveLimits(numbers.get("floor", -inf), numbers.get("power", inf), numbers.get("sample_time", 0.0))


def _declared(log: EnergyLog, name: str, build: Callable[[dict[str, float]], _Compared]) -> _Compared | None:
    """What an attribute declares, such as the dry friction that the motion is compared with; None without it.

    Raises:
        LogFormatError: The attribute is damaged.
    """
    if name not in log.attributes:
        return None
    with damage_told(log.path, f"attribute {name} cannot be used", "; the file is damaged"):
        return build(log.decoded(name, dict[str, float]()))
