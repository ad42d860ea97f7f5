"""Summary of a run from its energy log, with the names of `run --json`, and the comparison of two logs.

`PortRecord` adds up the figures of a port from a log that may still grow. `impossible_values` finds signs of a damaged
log or a faulty logger: numbers that are not finite, counts that decrease, and rows that do not match their digest.
"""

from collections.abc import Callable, Mapping, Sequence
from math import inf, isfinite
from operator import itemgetter
from typing import TYPE_CHECKING, Any, Final, NotRequired, TypedDict, TypeVar, cast

import numpy as np

from canhaptic.axis_units import uses_degrees
from canhaptic.canopen.objects import StatusBit
from canhaptic.control import verdict
from canhaptic.control.balance import OUT_OF_CONTACT, Branch, Certificate
from canhaptic.control.ledger import LedgerSummary, without_dust
from canhaptic.control.motion_checks import FrictionDeclared, FrictionWatch, MassAsked, MassFelt
from canhaptic.control.verdict import PortResult
from canhaptic.errors import InputError, LogFormatError
from canhaptic.logs.columns import DIGEST, FRICTION_DECLARED, PHASE
from canhaptic.logs.energy_reader import RUNNING, EnergyLog, Quantities, read_safely
from canhaptic.logs.hdf5 import Array
from canhaptic.meters import ActiveLimits, PortFigures, Promise, limits_of
from canhaptic.quantities import with_old_names
from canhaptic.result import TruthResult, Verdicts, overall, port_account, with_groups
from canhaptic.signals import CycleTiming, Measured

if TYPE_CHECKING:
    from canhaptic.audit.recompute import Recomputed, Rederived
    from canhaptic.audit.two_logs import JoinedLogs
    from canhaptic.audit.user_checks import Outcome


def rows_between(log: EnergyLog, start: float | None, stop: float | None) -> slice:
    """Return the rows from time `start` [s] on and before `stop` [s]; None: from the first row, or to the last.

    Raises:
        InputError: No cycle lies between `start` and `stop`.
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
    """Return the rows of `rows_between`, of a log with at least one cycle.

    Raises:
        InputError: The log holds no cycle, or none between `start` and `stop`.
    """
    if log.rows == 0:
        raise InputError(f"{log.path}: the log holds no cycle, so there is nothing to draw")
    return rows_between(log, start, stop)


def contacts(branch: Array) -> list[tuple[int, int]]:
    """Return (first, last) row of each contact: consecutive rows with a branch other than `free`.

    A lost sample does not end a contact.
    """
    rows = np.flatnonzero(branch != Branch.HELD.value)
    edges = np.flatnonzero(np.diff(branch[rows] != Branch.FREE.value, prepend=False, append=False))
    ends = [int(rows[edge]) if edge < len(rows) else len(branch) for edge in edges[1::2]]
    return [(int(start), end - 1) for start, end in zip(rows[edges[::2]], ends, strict=True)]


_Compared = TypeVar("_Compared")
_BLOCK: Final = 65_536  # rows held in memory at a time
_COUNTS: Final = frozenset({"uncommanded"})
"""Columns that count from the beginning of a run."""
CHANGED: Final = "not as the run wrote it"


def impossible_values(log: EnergyLog) -> list[dict[str, str | int]]:
    """Return the columns with values that no run writes: dataset, fault, number of rows, and first cycle.

    Raises:
        LogFormatError: A column cannot be read.
    """
    found: list[dict[str, str | int]] = []

    def add(dataset: str, what: str, rows: Sequence[int]) -> None:
        cycle = int(log.timing.read("sync_index", rows[0], rows[0] + 1)[0])
        found.append({"dataset": dataset, "what": what, "rows": len(rows), "cycle": cycle})

    for table, quantities in log.tables.items():
        for name in quantities if table != "timing" else ():
            bad, before = [], 0
            for start in range(0, log.rows, _BLOCK):
                values = quantities.read(name, start, start + _BLOCK)
                if name in _COUNTS:
                    values = values.astype(np.int64)
                    bad.append(start + np.flatnonzero(np.diff(values, prepend=before) < 0))
                    before = int(values[-1])
                elif values.dtype.kind == "f":
                    bad.append(start + np.flatnonzero(~np.isfinite(values)))
                else:
                    break
            if any(map(len, bad)):
                what = "a decreasing count" if name in _COUNTS else "not finite"
                add(f"{table}/{name}", what, np.concatenate(bad).tolist())
    if changed := log.changed_rows():
        add(DIGEST, CHANGED, changed)
    return found


class PortRecord(PortFigures):
    """The figures that `canhaptic.meters.RunMeters` computes for a port, here from the columns of a log.

    Args:
        log: Open energy log, which may still grow.
        name: Name of the port.
        start: First row to include.
    """

    def __init__(self, log: EnergyLog, name: str, start: int = 0) -> None:
        port, before = log.ports[name], start - 1
        super().__init__(
            limits_of(log, name) or ActiveLimits(0.0, inf, log.sample_time),
            is_damped=f"{name}.is_damped" in log.attributes,
            books_least=port.unit("torque_command") != port.unit("torque_applied"),
            damping_asked=log.number(f"{name}.damping_asked") if name in log.axes else None,
        )
        self._name, self._is_dry, self._sample_time = name, log.dry_run, log.sample_time
        losses = int(log.number(f"{name}.max_consecutive_losses"))
        force = log.number(f"{name}.hand_force") if f"{name}.hand_force" in log.attributes else None
        self._promise = Promise(losses, log.number(f"{name}.energy_allowance"), force)
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
        self._hold, self._is_in_degrees = "", name in log.axes and in_degrees(log, name)
        self._environment, self._algorithm = (
            log.attributes.get(f"{name}.{key}") for key in ("environment", "algorithm")
        )
        self._wall, self.is_requested = log.attributes.get(f"{name}.wall_position"), _is_requested(log, name)

    def _at(self, log: EnergyLog, column: str, row: int) -> float:
        return float(log.ports[self._name].read(column, row, row + 1)[0]) if self._is_measured else 0.0

    def take(self, log: EnergyLog, start: int, stop: int) -> None:
        """Add the rows from `start` up to, but without, `stop`; they must follow the rows added before."""
        port = log.ports[self._name]
        if stop <= start:
            return
        branch, torque = port.read("branch", start, stop), port.read("torque_command", start, stop)
        h_i = port.read("interaction", start, stop)
        came_in = h_i - _read(port, "supplied", slice(start, stop))
        self._in += float(came_in[came_in > 0.0].sum())
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
            axes = log.axes_of(self._name)
            found = {event.port: event.text for event in log.events if event.kind == "hold" and event.port in axes}
            self._hold = verdict.worst_hold(found.values())  # of each axis the last word
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
        asked, most = port.read("effort_requested", start, stop), self._largest_torque
        booked = (asked != 0.0) & (branch != Branch.HELD)
        asked, sent = asked[booked], np.clip(torque[booked], -most, most)  # beyond it the limiter cuts
        sizes = np.minimum(np.abs(asked), most)
        self.asked += float(np.abs(asked).sum())
        self.rendered -= float((sent * np.sign(asked)).sum())
        self.beyond_limit += int((np.abs(asked) > most).sum())
        self.sizes_asked += float(sizes.sum())
        self.sizes_sent += float(np.abs(sent).sum())
        if (acted := np.flatnonzero(sent)).size:
            row = start + int(np.flatnonzero(booked)[acted[-1]])
            self.last_torque, self.unanswered = float(log.deadlines(row, row + 1)[0]), 0.0
            sizes = sizes[acted[-1] + 1 :]
        self.unanswered += float(sizes.sum())
        if self._knows_active:
            self._take_active(log, start, port.read("active", start, stop))
        if self._watch is not None or self.felt is not None:
            self._take_motion(log, start, stop, branch)
        deadlines = log.deadlines(max(0, start - 1), stop)
        if len(deadlines) > 1:
            self._gap = max(self._gap, int(np.diff(deadlines).max()))

    def _take_active(self, log: EnergyLog, start: int, active: Array) -> None:
        for bit, key in ((verdict.ACTIVE_AT_MOTOR, "since"), (verdict.ACTIVE_AT_HANDLE, "at_handle_since")):
            if getattr(self.activity, key) is None and not self._before & bit and active[-1] & bit:
                row = start + int(np.argmax(active & bit > 0))
                setattr(self.activity, key, int(log.deadlines(row, row + 1)[0]))

    def _take_motion(self, log: EnergyLog, start: int, stop: int, branch: Array) -> None:
        port, booked = log.ports[self._name], branch != Branch.HELD
        names = ("position", "torque_applied", "effort_requested")
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
        """Force by which the motion exceeds declared friction and hand [N or N*m]; None if not checked."""
        return None if self._watch is None else self._watch.excess

    def measured(self) -> Measured:
        """Return the values of the log's columns for this port after the last row."""
        return self._measured

    def account(self) -> PortResult:
        """Return the account after the last row, with the names of `run --json` and without verdicts."""
        certificates = [certificate.name.lower() for certificate in Certificate.of(self._certificates)]
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
            if self._before & verdict.ACTIVE_AT_MOTOR:
                account["active_before"] = True
        if isinstance(self._environment, str):
            account["environment"] = self._environment
        if self._is_in_degrees:
            account["in_degrees"] = True
        if isinstance(self._algorithm, str):
            account["algorithm"] = self._algorithm
        if isinstance(self._wall, float):
            account["wall"] = self._wall
        if self._is_dry:
            verdict.claim_nothing(account)
        return account


def in_degrees(log: EnergyLog, name: str) -> bool:
    """Return whether the angle of an axis is shown in degrees, as the scene of the log gives angles so."""
    texts = (str(log.attributes.get(key, "")) for key in ("config", "config_overrides"))
    return log.ports[name].unit("position") == "rad" and uses_degrees("\n".join(texts))


def _is_requested(log: EnergyLog, name: str) -> bool:
    return f"{name}.guard" in log.attributes or log.attributes.get(f"{name}.environment") == "program"


def _declared(log: EnergyLog, name: str, build: Callable[[dict[str, float]], _Compared]) -> _Compared | None:
    """Return the object built from a JSON attribute, such as the declared dry friction; None without the attribute.

    Raises:
        LogFormatError: The attribute is damaged.
    """
    if name not in log.attributes:
        return None
    with read_safely(log.path, f"attribute {name} cannot be used", "; the file is damaged"):
        return build(log.decoded(name, dict[str, float]()))


class LogComparison(TypedDict):
    """Comparison of two runs."""

    identical: bool
    rows: list[int]  # number of rows of each
    missing: list[str]  # groups and quantities that only one of them has
    differences: list[dict[str, Any]]  # quantity, unit, first cycle, both values in it, and the largest in any cycle


def compare(first: EnergyLog, second: EnergyLog) -> LogComparison:
    """Compare two runs, except the times of the cycles, which differ in every run.

    Args:
        first: An open energy log.
        second: Another open energy log.
    """
    groups = [{path: of for path, of in log.tables.items() if path != "timing"} for log in (first, second)]
    names = [{f"{group}/{name}" for group, columns in side.items() for name in columns} for side in groups]
    shared = min(first.rows, second.rows)
    differences: list[dict[str, Any]] = []
    for path in sorted(names[0] & names[1]):
        group, _, name = path.rpartition("/")
        left, right = (side[group].read(name, 0, shared) for side in groups)
        unequal = _unequal(left, right)
        if len(unequal):
            cycle = int(first.timing["sync_index"][unequal[0]])
            left, right = left[unequal], right[unequal]
            differences.append(
                {
                    "name": path,
                    "unit": groups[0][group].unit(name),
                    "cycle": cycle,
                    "first": left[0].item(),
                    "second": right[0].item(),
                    "largest": float(np.abs(left.astype(float) - right.astype(float)).max()),
                }
            )
    one_sided = set(groups[0]) ^ set(groups[1])
    single = {path for path in names[0] ^ names[1] if path.rpartition("/")[0] not in one_sided}
    missing = sorted(one_sided | single)
    return {
        "identical": not differences and not missing and first.rows == second.rows,
        "rows": [first.rows, second.rows],
        "missing": missing,
        "differences": sorted(differences, key=itemgetter("cycle")),
    }


def _unequal(left: Array, right: Array) -> Array:
    """Rows whose bits differ: NaN equals NaN, and 0.0 is not -0.0."""
    if left.dtype != right.dtype:
        return np.flatnonzero(left.astype(float) != right.astype(float))
    width = f"u{left.dtype.itemsize}"
    return np.flatnonzero(np.ascontiguousarray(left).view(width) != np.ascontiguousarray(right).view(width))


_QUANTILES: Final = {"p50": 0.5, "p99": 0.99, "p99.9": 0.999}


class ContactStretch(TypedDict):
    """One contact: time, depth, torque and energy."""

    start: float  # [s]
    duration: float  # [s]
    depth: float | None  # [m or rad]; None: not known, as in the wall of a program
    peak_torque: float  # [N or N*m]
    energy: float  # taken in [J]


_Inspected = TypedDict("_Inspected", {"from": float, "to": float})  # [s]


class Inspection(_Inspected, Verdicts):
    """Summary of a log, or of a part of it."""

    file: str
    status: str
    config_hash: str
    cycles: int
    rate: float  # [Hz]
    findings: list[dict[str, str | int]]
    ports: dict[str, PortResult]
    truth: dict[str, TruthResult]
    timing: dict[str, int | dict[str, float]]
    link: dict[str, float]
    contacts: dict[str, list[ContactStretch]]
    events: list[dict[str, Any]]  # an `Event` and its time [s]
    checks: NotRequired[list["Outcome"]]
    comparison: NotRequired[LogComparison]
    recomputed: NotRequired[list["Recomputed"]]
    rederived: NotRequired["Rederived"]
    why: NotRequired[Mapping[str, Any]]  # axis -> what trembles, and its causes (`audit.why`)
    trials: NotRequired[Mapping[str, Any]]  # axis -> outcome of a changed key in the twin
    pair: NotRequired["JoinedLogs"]  # of two logs of one link
    others: NotRequired[list["Inspection"]]  # summaries of further logs


def inspect(log: EnergyLog, start: float | None = None, stop: float | None = None) -> Inspection:
    """Return the account of a run, or of a part of it.

    Args:
        log: An open energy log.
        start: Time of the first SYNC to count [s]; from the beginning by default.
        stop: Time of the first SYNC not to count [s]; to the end by default.

    Raises:
        InputError: No cycle lies between `start` and `stop`.
    """
    rows = rows_between(log, start, stop)
    edges = (rows.start, rows.stop - 1) if rows.start < rows.stop else ()
    begin, end = [float(log.deadlines(row, row + 1)[0] * log.sample_time) for row in edges] or (0.0, 0.0)
    truth = {name: _truth(log, name, rows) for name in log.truth}
    ports = with_groups({name: _port(log, name, rows) for name in log.ports}, log.groups, truth)
    events = [{**event._asdict(), "time": log.time_of(event.sync_index)} for event in log.events]
    stretches = {name: _contacts(log, name, rows) for name in log.accounts}
    for name, among in stretches.items():
        if (first := ports[name].get("first_active")) is not None:
            ports[name]["first_active_contact"] = sum(contact["start"] <= first for contact in among)
    return cast(
        "Inspection",
        {
            "file": str(log.path),
            "status": log.status,
            "config_hash": str(log.attributes.get("config_hash", "")),
            "cycles": int(rows.stop - rows.start),
            "rate": 1.0 / log.sample_time,
            "from": begin,
            "to": end,
            "findings": impossible_values(log),
            **overall(ports),
            "ports": ports,
            "truth": truth,
            "timing": _timing(log, rows) | _phase(log, rows),
            "link": _link(log, rows),
            "contacts": stretches,
            "events": [event for event in events if (start or 0.0) <= event["time"] < (inf if stop is None else stop)],
        },
    )


def _sum(values: Array) -> float:
    """Sum in extended precision: the terms are many and of both signs."""
    return float(values.sum(dtype=np.longdouble))


def _running(values: Array) -> Array:
    return np.cumsum(values, dtype=np.longdouble)


def _least(running: Array) -> tuple[float, int]:
    """Return the least value of a running sum that starts at 0, and the row where it is reached."""
    if not len(running) or running.min() >= 0.0:
        return 0.0, 0
    row = int(running.argmin())
    return float(running[row]), row


def _first_below(log: EnergyLog, running: Array, start: int) -> int | None:
    """Return the sample times to the first row after which a running sum is below 0; None: it never is."""
    below = running < -verdict.PASSIVE_TOLERANCE
    if not below.any():
        return None
    row = start + int(below.argmax())
    return int(log.deadlines(row, row + 1)[0])


def _read(port: Quantities, name: str, rows: slice) -> Array:
    """Return rows of a column; what was supplied is 0 in a log of an earlier release."""
    if name == "supplied" and name not in port:
        return np.zeros(len(port.read("interaction", rows.start, rows.stop)))
    return port.read(name, rows.start, rows.stop)


def _port(log: EnergyLog, port_name: str, rows: slice) -> PortResult:
    """Return the account of one port, read a column at a time: an hour of all columns would not fit in memory."""
    port = log.ports[port_name]

    def column(name: str) -> Array:
        return _read(port, name, rows)

    record = PortRecord(log, port_name, rows.start)
    record.take(log, rows.start, rows.stop)
    account: PortResult = {
        "unit": port.unit("position"),
        **_summary(log, column, rows).as_json(log.sample_time),
        **record.account(),
        "peak_torque": float(np.abs(column("torque_applied")).max(initial=0.0)),
        "limited_cycles": int((column("statusword") & StatusBit.INTERNAL_LIMIT != 0).sum()),
    }
    if rows.stop == log.rows and log.rows:
        _leave_open(log, log.axes_of(port_name), account)
    if port_name not in log.axes:
        account["state_unit"] = port.unit("state")
    return account


def _leave_open(log: EnergyLog, axes: Sequence[str], account: PortResult) -> None:
    """Say in an account up to the last row of a log that a torque of its axes acted on, if one did."""
    kinds = {event.kind for event in log.events if event.port in axes}
    is_cut = any(log.ports[axis].read("torque_command", log.rows - 1, log.rows)[0] for axis in axes)
    if is_cut or kinds & {verdict.UNBOOKED, verdict.UNCONFIRMED}:
        is_confirmed = verdict.UNCONFIRMED not in kinds and (log.status != RUNNING or not is_cut)
        verdict.leave_open(account, is_confirmed=is_confirmed)


def _summary(log: EnergyLog, column: Callable[[str], Array], rows: slice) -> LedgerSummary:
    """Return the sums over some rows; a `Ledger` that takes one row at a time gives equal sums."""
    h_i, h_r = column("interaction"), column("dissipated")
    margin, margin_row = _least(_running(h_i - h_r))
    margin = without_dust(margin, _sum(np.abs(h_i)))
    margin_row = margin_row if margin else 0
    dissipated, (least, first_below) = _sum(h_r), _lowest(log, h_i, rows.start)
    energy_in, energy_out, supplied = _flows(h_i, column("supplied"))
    place, is_any = rows.start + margin_row, len(h_i) > 0
    cycle = int(log.timing["sync_index"][place]) if is_any else 0
    deadline = int(log.deadlines(place, place + 1)[0]) if is_any else 0
    del h_i, h_r  # of an hour 60 MB
    surplus, branch = column("surplus"), _known(log, "branch", column("branch"), len(Branch))
    certificates = _known(log, "certificate", column("certificate"), len(Certificate))
    rendered = column("damping_rendered")[(branch != Branch.FREE) & (branch != Branch.EXIT)]
    return LedgerSummary(
        energy_in=energy_in,
        energy_out=energy_out,
        stored=_last(column("stored")),
        dissipated=dissipated,
        generated=_sum(column("gen")),
        supplied=supplied,
        surplus_end=_last(surplus),
        surplus_max=float(surplus.max(initial=0.0)),
        recovered=_sum(column("h_pas")),
        leaked=_sum(column("leaked")),
        paid=_sum(column("paid")),
        deficit=_sum(column("deficit")),
        margin_value=margin,
        margin_cycle=cycle,
        margin_deadline=deadline,
        least_interaction=least,
        first_below=first_below,
        certificates=Certificate.of(
            sum(1 << int(number) for number in np.unique(certificates[column("torque_command") != 0.0]))
        ),
        branches={member.name.lower(): int((branch == member).sum()) for member in Branch},
        damping_least=float(rendered.min()) if len(rendered) else 0.0,
        damping_most=float(rendered.max()) if len(rendered) else 0.0,
        has_open_hold=bool(len(branch) and branch[-1] == Branch.HELD),
    )


def _lowest(log: EnergyLog, h_i: Array, start: int) -> tuple[float, int | None]:
    running = _running(h_i)
    return _least(running)[0], _first_below(log, running, start)


def _flows(h_i: Array, supplied: Array) -> tuple[float, float, float]:
    """Return what came in, what went out, both without what was supplied, and that [J]."""
    by_motors = h_i - supplied if supplied.any() else h_i
    return _sum(np.maximum(by_motors, 0.0)), -_sum(np.minimum(by_motors, 0.0)), _sum(supplied)


def _known(log: EnergyLog, name: str, values: Array, count: int) -> Array:
    """Return the codes of a column, each less than `count`.

    Raises:
        LogFormatError: A code is larger.
    """
    worst = int(values.max(initial=0))
    if worst >= count:
        row = int(values.argmax())
        raise LogFormatError(f"{log.path}: {name} holds {worst} in row {row}, expected 0 to {count - 1}; damaged")
    return values


def _last(values: Array) -> float:
    return float(values[-1]) if len(values) else 0.0


def _truth(log: EnergyLog, name: str, rows: slice) -> TruthResult:
    """Return the true energies of a simulated port, and the largest error of its account.

    The interaction is minus the work of the motors on the moving mass; for a group the work of movers is subtracted.
    Energies count from the first row of the part.
    """
    interaction = _taken_in(log, name, rows)
    axes = log.axes_of(name)
    supplied = [_supplied(log, axis, rows) for axis in axes]
    if name in log.axes:  # in the columns of the other ports it is already
        interaction = interaction + _running(supplied[0]) - (0.0 if rows.start else supplied[0][:1].sum())
    if not len(interaction):
        return with_old_names(
            TruthResult(interaction=0.0, least_interaction=0.0, least_at_handle=0.0, accounted_error=0.0)
        )
    by_motors = sum(_taken_in(log, axis, rows) for axis in axes)
    columns = (log.ports[axis].read("interaction", rows.start, rows.stop) for axis in axes)
    h_i = np.sum([column - part for column, part in zip(columns, supplied, strict=True)], axis=0)
    del supplied
    accounted = _running(h_i) if rows.start else _running(h_i) - h_i[0]
    booked = log.ports[axes[0]].read("branch", rows.start, rows.stop) != Branch.HELD
    dissipated = log.truth[name].read("dissipated", rows.start, rows.stop)
    truth: TruthResult = {
        "interaction": float(interaction[-1]),
        "least_interaction": min(0.0, float(interaction.min())),
        "least_at_handle": min(0.0, float((interaction + dissipated - dissipated[0]).min())),
        "accounted_error": float(np.abs((accounted - by_motors)[booked]).max(initial=0.0)),
    }
    return with_old_names(truth)


def _supplied(log: EnergyLog, name: str, rows: slice) -> Array:
    return _read(log.ports[name], "supplied", rows)


def _taken_in(log: EnergyLog, name: str, rows: slice) -> Array:
    """Return the true energy that came in up to each row, counted from the row before the part [J]."""
    motor = log.truth[name].read("motor", max(0, rows.start - 1), rows.stop)
    return (motor[:1] - motor)[1 if rows.start else 0 :]


def _timing(log: EnergyLog, rows: slice) -> dict[str, int | dict[str, float]]:
    result: dict[str, int | dict[str, float]] = {}
    cycle_time, late = np.zeros(0, np.int64), np.zeros(0, np.int64)
    for name in CycleTiming._fields:  # one at a time: an hour has 29 MB of each
        values = log.timing.read(name, rows.start, rows.stop)
        if name == "wakeup_lateness":
            late = values.copy()
        else:
            cycle_time = cycle_time + values if len(cycle_time) else values.copy()
        result[name] = _quantiles(values)
    late += cycle_time
    if not late.any():
        return {}  # in lock-step virtual time does not advance within a cycle: all durations are 0
    missed = int((late > log.sample_time_ns).sum())
    return {"deadlines_missed": missed} | result | {"cycle_time": _quantiles(cycle_time)}


def _phase(log: EnergyLog, rows: slice) -> dict[str, dict[str, float]]:
    """Return how far the host was from the phase to keep, to either side; nothing of a run that leads its own cycle."""
    return {PHASE: _quantiles(np.abs(log.timing.read(PHASE, rows.start, rows.stop)))} if PHASE in log.timing else {}


def _quantiles(durations: Array) -> dict[str, float]:
    """Return p50, p99, p99.9 and the maximum [s] of durations [ns], whose order is lost."""
    if not len(durations):
        return dict.fromkeys((*_QUANTILES, "max"), 0.0)
    values = np.quantile(durations, list(_QUANTILES.values()), method="higher", overwrite_input=True)
    return {name: float(value) / 1e9 for name, value in zip(_QUANTILES, values, strict=True)} | {
        "max": float(durations.max()) / 1e9
    }


def _link(log: EnergyLog, rows: slice) -> dict[str, float]:
    fresh = [log.ports[name].read("fresh", rows.start, rows.stop) for name in log.axes]
    expected = sum(len(values) for values in fresh)
    received = int(sum(values.sum(dtype=np.int64) for values in fresh))
    dropped = int(log.timing.read("dropped_before", rows.start, rows.stop).sum(dtype=np.int64))
    index, deadlines = log.timing.read("sync_index", rows.start, rows.stop), log.deadlines(rows.start, rows.stop)
    sent, due = (int(values[-1]) - int(values[0]) if len(values) else 0 for values in (index, deadlines))
    return {
        "success_rate": received / expected if expected else 1.0,
        "missing": expected - received,
        "cycles_without_row": sent - max(0, len(index) - 1),
        "skipped_syncs": due - sent,
        "dropped_by_log": dropped,
        "lost_by_damage": log.rows_lost,
    }


def _contacts(log: EnergyLog, name: str, rows: slice) -> list[ContactStretch]:
    """Return every contact: start [s], duration [s], depth [m or rad], peak torque [N or N*m], energy taken in [J]."""

    def column(quantity: str) -> Array:
        return log.ports[name].read(quantity, rows.start, rows.stop)

    stretches = contacts(column("branch"))
    if not stretches:
        return []
    edges = np.add(stretches, (0, 1))
    spans = edges.ravel() if edges[-1, 1] < rows.stop - rows.start else edges.ravel()[:-1]
    depths = _depths(log, name, rows)
    depth = np.array([None] * len(stretches)) if depths is None else np.maximum.reduceat(depths, spans)[::2]
    peak = np.maximum.reduceat(np.abs(column("torque_applied")), spans)[::2]
    energy = np.add.reduceat(column("interaction"), spans)[::2]
    deadlines = log.deadlines(rows.start, rows.stop)
    first, last = deadlines[edges[:, 0]], deadlines[edges[:, 1] - 1]
    start, duration = first * log.sample_time, (last - first + 1) * log.sample_time
    columns = (values.tolist() for values in (start, duration, depth, peak, energy))
    named = [dict(zip(ContactStretch.__annotations__, row, strict=True)) for row in zip(*columns, strict=True)]
    return cast("list[ContactStretch]", named)


def _depths(log: EnergyLog, name: str, rows: slice) -> Array | None:
    """Return the depth in the contact at each row [m or rad]; None if it is not known, as in the wall of a program.

    The states of user code in its own process are not in the log: its depth is measured from the position of its wall.
    """
    port = log.ports[name]
    if not _is_requested(log, name):
        return np.abs(port.read("state", rows.start, rows.stop))
    if (wall := wall_of(log, name)) is None:
        return None
    beyond, side = port.read("position", rows.start, rows.stop) - wall, log.attributes.get(f"{name}.wall_side")
    return np.maximum({"below": -beyond, "above": beyond}.get(str(side), np.abs(beyond)), 0.0)


def wall_of(log: EnergyLog, name: str) -> float | None:
    """Return the position of the wall of a port [m or rad]; None without one, as with detents."""
    wall = log.attributes.get(f"{name}.wall_position")
    is_wall = f"{name}.wall_pitch" not in log.attributes
    return float(wall) if is_wall and isinstance(wall, int | float) and isfinite(wall) else None


def walls_of(log: EnergyLog, name: str) -> list[tuple[float, str]]:
    """Return the positions of the walls [m or rad] and their sides, `below` or `above`; a sum may have two walls."""
    ends = [(log.number(f"{name}.wall_{key}", inf), side) for key, side in (("low", "below"), ("high", "above"))]
    if walls := [(place, side) for place, side in ends if isfinite(place)]:
        return walls
    wall = wall_of(log, name)
    return [] if wall is None else [(wall, str(log.attributes.get(f"{name}.wall_side", "below")))]
