"""Figures of a port in an energy log in addition to its ledger, read in pieces from a finished or a growing log.

Selection of the rows of a log: a span of time, or each contact.

Stored values that no run writes: signs of a damaged log or a faulty logger.

They are numbers that are not finite, running counts that fall, and rows that do not fit their digest.
"""

from math import inf
from typing import Final, TypedDict

import numpy as np

from canhaptic.control.balance import OUT_OF_CONTACT, Branch, certificates_of
from canhaptic.control.friction_watch import FrictionDeclared, FrictionWatch
from canhaptic.control.verdict import ACTIVE_AT_HANDLE, ACTIVE_AT_MOTOR, NOT_CHECKED, PortResult, claim_nothing
from canhaptic.errors import InputError, LogFormatError
from canhaptic.logs.columns import ACTIVE_LIMITS, DIGEST, FRICTION_DECLARED
from canhaptic.logs.energy_reader import EnergyLog
from canhaptic.logs.hdf5 import Array
from canhaptic.meters import ActiveLimits, Promise
from canhaptic.result import rendered_shares, withdraw_certificates


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
        raise InputError(f"{log.path}: the log holds no cycle, there is nothing to draw")
    return rows_between(log, start, stop)


def contacts(branch: Array) -> list[tuple[int, int]]:
    """Return (first, last) row of every stretch in which a hold was booked by another branch than `free`.

    A contact continues across a hold whose sample was lost.
    """
    booked = np.where(branch != Branch.HELD.value, np.arange(len(branch)), 0)
    touching = np.isin(branch[np.maximum.accumulate(booked)], (Branch.FREE.value, Branch.HELD.value), invert=True)
    edges = np.flatnonzero(np.diff(touching, prepend=False, append=False))
    return [(int(start), int(end) - 1) for start, end in zip(edges[::2], edges[1::2], strict=True)]


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
    groups = {f"ports/{name}": port for name, port in log.ports.items()}
    groups |= {f"truth/{name}": truth for name, truth in log.truth.items()}
    found: list[ImpossibleValue] = []
    for group, quantities in groups.items():
        for name in quantities:
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
                what = "a count that falls" if name in _COUNTS else "no finite number"
                found.append({"dataset": f"{group}/{name}", "what": what, "rows": rows, "cycle": cycle})
    if changed := log.changed_rows():
        cycle = int(log.timing.read("sync_index", changed[0], changed[0] + 1)[0])
        found.append({"dataset": DIGEST, "what": CHANGED, "rows": len(changed), "cycle": cycle})
    return found


class PortRecord:
    """Adds up the figures of `canhaptic.meters.RunMeters` from the columns of a log.

    Args:
        log: View of the log.
        name: Name of the port.
        start: First row that counts.
    """

    def __init__(self, log: EnergyLog, name: str, start: int = 0) -> None:
        self._name = name
        losses = int(log.number(f"{name}.max_consecutive_losses"))
        self._promise = Promise(losses, log.number(f"{name}.energy_allowance"))
        self._is_damped = f"{name}.is_damped" in log.attributes
        self._largest_torque = log.number(f"{name}.torque_limit", inf)
        self._damping_asked = log.number(f"{name}.damping_asked")
        self._is_group, self._is_dry = name in log.groups, log.dry_run
        self._is_measured, self._knows_active = "energy_resolution" in log.ports[name], "active" in log.ports[name]
        self._books_least = log.ports[name].unit("torque_command") != log.ports[name].unit("torque_applied")
        self._sample_time, self._since = log.sample_time, dict[int, float]()
        limits = limits_of(log, name)
        self._is_estimate = limits is not None and limits.floor == -inf
        before = start - 1
        self._dissipated = self._at(log, "device_dissipated", before) if start else 0.0
        self._unknown = self._at(log, "energy_resolution", before) if start else 0.0
        self._resolution, self._longest_hold, self._gap = self._unknown, 1, 1
        self._before = int(self._at(log, "active", before)) if start and self._knows_active else 0
        self._certificates = self._contacts = self._silent = self._uncommanded = 0
        self._interaction, self._least, self._at_handle = np.longdouble(0.0), 0.0, 0.0
        self._certain = self._certain_at_handle = 0.0
        self._device = self._asked = self._given = self._damping = self._sizes_asked = self._sizes_sent = 0.0
        self._is_open, self._in = False, 0.0
        self._watch = _watch(log, f"{name}.{FRICTION_DECLARED}")
        self._hold = ""

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
        self._contacts += int(touching.sum())
        self._silent += int((touching & (torque == 0.0)).sum())
        self._damping += float(port.read("damping_rendered", start, stop)[touching].sum())
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
        self._device = float(dissipated[-1])
        self._at_handle = min(self._at_handle, float((running + dissipated).min()))
        resolution = port.read("energy_resolution", start, stop)
        self._resolution = float(resolution[-1])
        self._certain = min(self._certain, float((running - resolution).min()))
        self._certain_at_handle = min(self._certain_at_handle, float((running + dissipated - resolution).min()))
        self._longest_hold = int(port.read("longest_hold", stop - 1, stop)[0])
        self._uncommanded = int(port.read("uncommanded", stop - 1, stop)[0])
        asked = port.read("effort_asked", start, stop)
        booked = (asked != 0.0) & (branch != Branch.HELD)
        self._asked += float(asked[booked].sum())
        self._given -= float(torque[booked].sum())
        self._sizes_asked += float(np.minimum(np.abs(asked[booked]), self._largest_torque).sum())
        self._sizes_sent += float(np.abs(torque[booked]).sum())
        if self._knows_active:
            self._take_active(log, start, port.read("active", start, stop))
        if self._watch is not None:
            self._take_motion(self._watch, log, start, stop, branch)
        deadlines = log.deadlines(max(0, start - 1), stop)
        if len(deadlines) > 1:
            self._gap = max(self._gap, int(np.diff(deadlines).max()))

    def _take_active(self, log: EnergyLog, start: int, active: Array) -> None:
        for bit in (ACTIVE_AT_MOTOR, ACTIVE_AT_HANDLE):
            if bit not in self._since and not self._before & bit and active[-1] & bit:
                row = start + int(np.argmax(active & bit > 0))
                self._since[bit] = float(log.deadlines(row, row + 1)[0]) * self._sample_time

    def _take_motion(self, watch: FrictionWatch, log: EnergyLog, start: int, stop: int, branch: Array) -> None:
        port, booked = log.ports[self._name], branch != Branch.HELD
        names = ("position", "torque_applied", "effort_asked")
        position, torque, asked = (port.read(name, start, stop)[booked].tolist() for name in names)
        deadlines = log.deadlines(start, stop)[booked].tolist()
        for row in zip(position, torque, deadlines, asked, strict=True):
            watch.take(*row)

    @property
    def least_interaction(self) -> float:
        """Least sum of interaction so far [J]."""
        return self._least

    def account(self) -> PortResult:
        """Figures so far, by the names of `run --json`, without verdicts."""
        certificates = [certificate.name.lower() for certificate in certificates_of(self._certificates)]
        account: PortResult = {
            "in": self._in,
            "least_interaction": self._least,
            "certificate": certificates[-1] if certificates else "exact",
            "certificates": certificates,
            "contact": {"holds": self._contacts, "without_torque": self._silent},
            "open_hold": self._is_open,
            "max_consecutive_losses": self._promise.max_consecutive_losses,
            "energy_allowance": self._promise.energy_allowance,
        }
        if self._hold:
            account["hold"] = self._hold
        if self._is_measured:
            account["energy_resolution"] = self._resolution + self._unknown
            account["least_certain"] = self._certain - self._unknown
            account["longest_hold"], account["uncommanded_cycles"] = self._longest_hold, self._uncommanded
            self._add_activity(account)
            if not self._is_group:
                account["contact"] |= {"asked": self._sizes_asked, "sent": self._sizes_sent}
            if self._is_damped:
                account["least_at_handle"], account["device_dissipated"] = self._at_handle, self._device
                account["least_certain_at_handle"] = self._certain_at_handle - self._unknown
            if self._watch is not None:
                account["friction_excess"] = self._watch.excess
            if not self._is_group:
                asked = self._damping_asked * self._contacts
                account["rendered"] = rendered_shares(self._asked, self._given, asked, self._damping)
            withdraw_certificates(account, longest_gap=self._gap)
        if self._is_dry:
            claim_nothing(account)
        return account

    def _add_activity(self, account: PortResult) -> None:
        if self._books_least:
            account["books_least"] = True
        if self._is_estimate:
            account["resolution_is_estimated"] = True
        if self._before & ACTIVE_AT_MOTOR:
            account["active_before"] = True
        if ACTIVE_AT_MOTOR in self._since:
            account["active_since"] = self._since[ACTIVE_AT_MOTOR]
        if ACTIVE_AT_HANDLE in self._since:
            account["active_at_handle_since"] = self._since[ACTIVE_AT_HANDLE]


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


def _watch(log: EnergyLog, name: str) -> FrictionWatch | None:
    """Check of a run against the dry friction that an attribute declares; None without one.

    Raises:
        LogFormatError: The attribute is damaged.
    """
    if name not in log.attributes:
        return None
    try:
        return FrictionWatch(FrictionDeclared(**log.decoded(name, dict[str, float]())))
    except TypeError as error:
        raise LogFormatError(f"{log.path}: attribute {name} cannot be used ({error}); the file is damaged") from error
