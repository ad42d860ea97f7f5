"""Summary of a run from its energy log, as one dictionary: the names of `run --json`, with contacts and events.

Comparison of two runs, quantity by quantity: the first row in which they differ, and by how much.
"""

from collections.abc import Callable
from typing import TYPE_CHECKING, Final, NotRequired, TypedDict, cast

import numpy as np
from numpy.typing import NDArray

from canhaptic.audit.port_record import ImpossibleValue, PortRecord, contacts, impossible_values, rows_between
from canhaptic.audit.recompute import Recomputed
from canhaptic.audit.user_checks import Outcome
from canhaptic.canopen.objects import StatusBit
from canhaptic.control.balance import Branch, Certificate, certificates_of
from canhaptic.control.ledger import LedgerSummary
from canhaptic.control.verdict import PASSIVE_TOLERANCE, PortResult
from canhaptic.errors import LogFormatError
from canhaptic.logs.energy_reader import EnergyLog, Quantities
from canhaptic.logs.hdf5 import Array
from canhaptic.result import TruthResult, Verdicts, overall, with_groups
from canhaptic.signals import CycleTiming

if TYPE_CHECKING:
    from canhaptic.audit.rederive import Rederived


class Difference(TypedDict):
    """A quantity that differs."""

    name: str
    unit: str
    cycle: int  # the first in which it does
    first: float
    second: float
    largest: float  # in any cycle


class LogComparison(TypedDict):
    """Comparison of two runs."""

    identical: bool
    rows: list[int]  # of both
    missing: list[str]  # groups and quantities that only one of them has
    differences: list[Difference]


def compare(first: EnergyLog, second: EnergyLog) -> LogComparison:
    """Compare two runs; the times of the cycles are left out, as they differ in every run.

    Args:
        first: An open energy log.
        second: Another open energy log.
    """
    groups = [{path: of for path, of in log.tables.items() if path != "timing"} for log in (first, second)]
    names = [{f"{group}/{name}" for group, columns in side.items() for name in columns} for side in groups]
    shared = min(first.rows, second.rows)
    differences: list[Difference] = []
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
        "differences": sorted(differences, key=lambda difference: difference["cycle"]),
    }


def _unequal(left: Array, right: Array) -> NDArray[np.intp]:
    """Rows whose bits differ: NaN equals NaN, and 0.0 is not -0.0."""
    if left.dtype != right.dtype:
        return np.flatnonzero(left.astype(float) != right.astype(float))
    width = f"u{left.dtype.itemsize}"
    return np.flatnonzero(np.ascontiguousarray(left).view(width) != np.ascontiguousarray(right).view(width))


_QUANTILES: Final = {"p50": 0.5, "p99": 0.99, "p99.9": 0.999}


class LoggedEvent(TypedDict):
    """An event of the run."""

    sync_index: int
    kind: str
    port: str
    text: str
    time: float  # [s]


class ContactStretch(TypedDict):
    """One stretch in contact."""

    start: float  # [s]
    duration: float  # [s]
    depth: float  # [m or rad]
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
    findings: list[ImpossibleValue]
    ports: dict[str, PortResult]
    truth: dict[str, TruthResult]
    timing: dict[str, int | dict[str, float]]
    link: dict[str, float]
    contacts: dict[str, list[ContactStretch]]
    events: list[LoggedEvent]
    checks: NotRequired[list[Outcome]]
    comparison: NotRequired[LogComparison]
    recomputed: NotRequired[list[Recomputed]]
    rederived: NotRequired["Rederived"]
    others: NotRequired[list["Inspection"]]  # of further logs


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
    stretches = {n: _contacts(log, port, rows) for n, port in log.ports.items() if n not in log.group_of}
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
            "timing": _timing(log, rows),
            "link": _link(log, rows),
            "contacts": stretches,
            "events": [{**event._asdict(), "time": log.time_of(event.sync_index)} for event in log.events],
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
    below = running < -PASSIVE_TOLERANCE
    if not below.any():
        return None
    row = start + int(below.argmax())
    return int(log.deadlines(row, row + 1)[0])


def _port(log: EnergyLog, port_name: str, rows: slice) -> PortResult:
    """The account of one port; columns are read one after the other, an hour of them at once would not fit."""
    port = log.ports[port_name]

    def column(name: str) -> Array:
        return port.read(name, rows.start, rows.stop)

    record = PortRecord(log, port_name, rows.start)
    record.take(log, rows.start, rows.stop)
    account: PortResult = {
        "unit": port.unit("position"),
        **_summary(log, column, rows).as_json(log.sample_time),
        **record.account(),
        "peak_torque": float(np.abs(column("torque_applied")).max(initial=0.0)),
        "limited_cycles": int((column("statusword") & StatusBit.INTERNAL_LIMIT != 0).sum()),
    }
    if port_name in log.groups:
        account["state_unit"] = port.unit("state")
    return account


def _summary(log: EnergyLog, column: Callable[[str], Array], rows: slice) -> LedgerSummary:
    """The account of rows held in arrays; `Ledger` sums the same one row at a time."""
    h_i, h_r = column("h_i"), column("h_r")
    margin, margin_row = _least(_running(h_i - h_r))
    running = _running(h_i)
    place = rows.start + margin_row
    cycle = int(log.timing["sync_index"][place]) if len(h_i) else 0
    deadline = int(log.deadlines(place, place + 1)[0]) if len(h_i) else 0
    surplus, branch = column("h_dis"), _known(log, "branch", column("branch"), len(Branch))
    certificates = _known(log, "certificate", column("certificate"), len(Certificate))
    rendered = column("damping_rendered")[(branch != Branch.FREE) & (branch != Branch.EXIT)]
    return LedgerSummary(
        energy_in=_sum(np.maximum(h_i, 0.0)),
        energy_out=-_sum(np.minimum(h_i, 0.0)),
        stored=_last(column("h_s")),
        dissipated=_sum(h_r),
        generated=_sum(column("gen")),
        surplus_end=_last(surplus),
        surplus_max=float(surplus.max(initial=0.0)),
        recovered=_sum(column("h_pas")),
        leaked=_sum(column("leak")),
        paid=_sum(column("paid")),
        deficit=_sum(column("deficit")),
        margin_value=margin,
        margin_cycle=cycle,
        margin_deadline=deadline,
        least_interaction=_least(running)[0],
        first_below=_first_below(log, running, rows.start),
        certificates=certificates_of(
            sum(1 << int(number) for number in np.unique(certificates[column("torque_command") != 0.0]))
        ),
        branches={member.name.lower(): int((branch == member).sum()) for member in Branch},
        damping_least=float(rendered.min()) if len(rendered) else 0.0,
        damping_most=float(rendered.max()) if len(rendered) else 0.0,
        has_open_hold=bool(len(branch) and branch[-1] == Branch.HELD),
    )


def _known(log: EnergyLog, name: str, values: Array, count: int) -> Array:
    """Values of a column of codes, from 0 to `count` - 1.

    Raises:
        LogFormatError: A value is none of them.
    """
    worst = int(values.max(initial=0))
    if worst >= count:
        row = int(values.argmax())
        raise LogFormatError(f"{log.path}: {name} holds {worst} in row {row}, expected 0 to {count - 1}; damaged")
    return values


def _last(values: Array) -> float:
    return float(values[-1]) if len(values) else 0.0


def _truth(log: EnergyLog, name: str, rows: slice) -> TruthResult:
    """True energies of the simulated axis against the accounted ones.

    The interaction is minus the motor's work on the moving mass, for a group less the movers' work; both count from the
    first row of the part.
    """
    interaction = _taken_in(log, name, rows)
    if not len(interaction):
        return {"interaction": 0.0, "least_interaction": 0.0, "least_at_handle": 0.0, "believed_error": 0.0}
    axes = log.groups.get(name, (name,))
    by_motors = sum(_taken_in(log, axis, rows) for axis in axes)
    h_i = np.sum([log.ports[axis].read("h_i", rows.start, rows.stop) for axis in axes], axis=0)
    accounted = _running(h_i) if rows.start else _running(h_i) - h_i[0]
    booked = log.ports[axes[0]].read("branch", rows.start, rows.stop) != Branch.HELD
    dissipated = log.truth[name].read("dissipated", rows.start, rows.stop)
    return {
        "interaction": float(interaction[-1]),
        "least_interaction": min(0.0, float(interaction.min())),
        "least_at_handle": min(0.0, float((interaction + dissipated - dissipated[0]).min())),
        "believed_error": float(np.abs((accounted - by_motors)[booked]).max(initial=0.0)),
    }


def _taken_in(log: EnergyLog, name: str, rows: slice) -> Array:
    """Return the true energy that came in since the row before the first, or since the first row of the log [J]."""
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
        return {}  # in lock-step virtual time does not advance within a cycle: durations say nothing
    missed = int((late > log.sample_time_ns).sum())
    return {"deadlines_missed": missed} | result | {"cycle_time": _quantiles(cycle_time)}


def _quantiles(durations: Array) -> dict[str, float]:
    """Return p50, p99, p99.9 and the maximum [s] of durations [ns], whose order is lost."""
    if not len(durations):
        return dict.fromkeys((*_QUANTILES, "max"), 0.0)
    values = np.quantile(durations, list(_QUANTILES.values()), method="higher", overwrite_input=True)
    return {name: float(value) / 1e9 for name, value in zip(_QUANTILES, values, strict=True)} | {
        "max": float(durations.max()) / 1e9
    }


def _link(log: EnergyLog, rows: slice) -> dict[str, float]:
    fresh = [port.read("fresh", rows.start, rows.stop) for n, port in log.ports.items() if n not in log.groups]
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


def _contacts(log: EnergyLog, port: Quantities, rows: slice) -> list[ContactStretch]:
    """Every stretch in contact: start [s], duration [s], depth [m or rad], peak torque [N or N*m], energy taken [J]."""

    def column(name: str) -> Array:
        return port.read(name, rows.start, rows.stop)

    stretches = contacts(column("branch"))
    if not stretches:
        return []
    edges = np.add(stretches, (0, 1))
    spans = edges.ravel() if edges[-1, 1] < rows.stop - rows.start else edges.ravel()[:-1]
    depth = np.maximum.reduceat(np.abs(column("state")), spans)[::2]
    peak = np.maximum.reduceat(np.abs(column("torque_applied")), spans)[::2]
    energy = np.add.reduceat(column("h_i"), spans)[::2]
    deadlines = log.deadlines(rows.start, rows.stop)
    first, last = deadlines[edges[:, 0]], deadlines[edges[:, 1] - 1]
    start, duration = first * log.sample_time, (last - first + 1) * log.sample_time
    columns = (values.tolist() for values in (start, duration, depth, peak, energy))
    named = [dict(zip(ContactStretch.__annotations__, row, strict=True)) for row in zip(*columns, strict=True)]
    return cast("list[ContactStretch]", named)
