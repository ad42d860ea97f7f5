"""An account computed once more: from the energy log of a run, and from the frames of its bus log.

`recompute` gives the controllers the logged inputs again; every output must agree bit for bit. `rederive` takes frames
-> samples -> controllers -> ledger. Frames are decoded with the PDO maps and rated torques of the bring-up in the log,
without the codecs of the master, so that this account is independent of the logged one.

The scene of a log is found by the hash of its configuration, which for the log of an earlier release is that of the
names and keys of that release. `tools/convert_scene.py` converts a scene of an earlier release to those of this one.
"""

import struct
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import ceil, inf
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal, NamedTuple, NotRequired, TypedDict, cast, get_args

import numpy as np

from canhaptic.audit.listened_axis import OF_A_NODE, DeclaredDrive, DeclaredForce, HeardAxis, ListenedAxis
from canhaptic.audit.user_checks import Outcome
from canhaptic.canopen import objects as od
from canhaptic.control.balance import Certificate, EnergyBalance
from canhaptic.control.booked_stop import BookedStop
from canhaptic.control.ports import Port, Ports
from canhaptic.control.verdict import ACTIVE_AT_HANDLE, ACTIVE_AT_MOTOR, PortResult, claim_nothing
from canhaptic.errors import InputError, LogFormatError
from canhaptic.logs.bus_reader import Frame, Remarks, read_bus_log
from canhaptic.logs.energy_reader import EnergyLog, Quantities
from canhaptic.logs.text_lines import UNTIMED
from canhaptic.meters import RunMeters, limits_of, promise_of
from canhaptic.quantities import NEW_COLUMNS
from canhaptic.result import Verdicts, overall, port_account, with_groups
from canhaptic.scene.buses import PLACES, kind_of
from canhaptic.scene.load import load_scene
from canhaptic.scene.models import LATER_LOOP_KEYS, AxisScene, Scene, hash_of
from canhaptic.scene.own_code import apart, require_same_code
from canhaptic.scene.parts import build_axis_meters, build_ports, lateness_of
from canhaptic.scene.scene_logs import Channels
from canhaptic.signals import FarRow, Sample

if TYPE_CHECKING:
    from canhaptic.audit.listened_line import ListenedLine

_INPUTS: Final = ("position", "torque_applied", "fresh")
_OUTPUTS: Final = tuple({"torque": "torque_command", **NEW_COLUMNS}.get(name, name) for name in EnergyBalance._fields)
_CERTIFICATE: Final = EnergyBalance._fields.index("certificate")
_NONE: Final = Certificate.NONE.value
_ROUNDING: Final = 1e-12
"""Largest accepted difference between a recomputed and a logged sum of energies [J]."""
_LAST_OLD_FORMAT: Final = 2
"""Newest format of the logs of earlier releases."""
_BLOCK: Final = 65_536  # rows held in memory at a time
_ONE: Final = struct.Struct("d")


class Mismatch(NamedTuple):
    """The first output that differs."""

    port: str
    cycle: int
    quantity: str
    logged: float
    recomputed: float


class Recomputed(TypedDict):
    """Outcome of the recomputation of a port."""

    port: str
    mismatch: dict[str, str | int | float] | None  # fields of the `Mismatch`; None: every output is equal
    rows: int  # that were recomputed: up to the first missing one, or to a skipped SYNC whose length matters
    unchecked_rows: int  # after these
    missing_rows: int  # that the log lost


def recompute(
    log: EnergyLog, axes: Sequence[str], ports: Ports, stop: Callable[[], BookedStop] | None = None
) -> list[Mismatch]:
    """Return the first logged output of each axis and group that differs from the recomputed one.

    The computation ends at the first missing row, because the inputs there are unknown.

    Args:
        log: An open energy log that holds the run from its first cycle.
        axes: Names of the axes, in the order of the rig.
        ports: Ports built from the scene of the run, in their initial state.
        stop: Constructor of the holds of the stop, called at their first row; None: the run has none.
    """
    found: dict[str, Mismatch] = {}
    names = (*axes, *(port.name for port in ports.several))
    inputs = [logged_rows(log, name, _INPUTS) for name in axes]
    known = [name for name in _OUTPUTS if all(name in log.ports[port] for port in names)]  # an older log has fewer
    outputs, every = [logged_rows(log, name, known) for name in names], struct.Struct(f"{len(known)}d")
    rows = zip(periods_of(log), zip(*inputs, strict=True), zip(*outputs, strict=True), strict=False)
    programs = [(program, efforts_asked(log, axes[axis])) for axis, program in ports.programs]
    coupled = [each for each in (port.controller for port in ports.ports) if hasattr(each, "take_far")]
    stopping, arrived = row_of_stop(log), far_rows(log)
    for row, (periods, seen, expected) in enumerate(rows):
        ports = stop() if row == stopping and stop is not None else ports
        ports.note_skipped_syncs(periods)
        for program, asked in programs:
            program.ask(-next(asked))
        for port, given in zip(coupled, arrived, strict=False):
            port.take_far(given)
        samples = [Sample(row, position, torque, 0, fresh=bool(fresh)) for position, torque, fresh in seen]
        balances = ports.balances_of(samples)
        for name, balance, logged in zip(names, balances, expected, strict=True):
            if logged[_CERTIFICATE] == _NONE:  # withdrawn for the length of a hold, which is no input
                balance = balance._replace(certificate=_NONE)
            if name not in found and every.pack(*(now := balance[: len(known)])) != every.pack(*logged):
                pairs = enumerate(zip(now, logged, strict=True))
                number = next(n for n, (new, was) in pairs if _ONE.pack(new) != _ONE.pack(was))
                cycle = int(log.timing["sync_index"][row])
                found[name] = Mismatch(name, cycle, _OUTPUTS[number], logged[number], balance[number])
    return list(found.values())


def far_rows(log: EnergyLog) -> Iterator[FarRow]:
    """Yield what arrived from a far side, row by row; nothing where the log has none."""
    for start in range(0, log.rows if log.far is not None else 0, _BLOCK):
        block = (cast("Quantities", log.far).read(name, start, start + _BLOCK).tolist() for name in FarRow._fields)
        yield from map(FarRow._make, zip(*block, strict=True))


def row_of_stop(log: EnergyLog) -> int:
    """Return the row with which the stop began; -1 where no torque was left to take away."""
    found = [event.sync_index for event in log.events if event.kind == "stopping"]
    return int(np.searchsorted(log.timing.read("sync_index", 0, log.rows), found[0])) if found else -1


def stop_of(scene: Scene, ports: Sequence[Port], *, dry_run: bool) -> BookedStop:
    """Return the holds of a stop as the run made them, by the state of the ports."""
    axes, time = [axis.parameters for axis in scene.axes], scene.bus.sample_time
    to_act = 2 + max(  # as `Rig.holds_to_act`
        axis.loop.delay + ceil(lateness_of(axis) / time) for axis in scene.axes
    )
    return BookedStop(ports, axes, scene.bus, to_act, dry_run=dry_run)


def activity_mismatch(log: EnergyLog, name: str) -> Mismatch | None:
    """Return the first row whose `active` disagrees with the energies and the resolution up to it; None if all agree.

    Rows after a missing one are not compared, nor logs of a format without this column.
    """
    port, rows = log.ports[name], rows_before_a_gap(log)
    limits = limits_of(log, name)
    if "active" not in port or limits is None or not rows:
        return None
    logged = port.read("active", 0, rows)
    most = np.cumsum(port.read("interaction", 0, rows), dtype=np.longdouble) + port.read("energy_resolution", 0, rows)
    at_handle = most + limits.power * limits.sample_time * (log.deadlines(0, rows) + 1)
    for bit, energy in ((ACTIVE_AT_MOTOR, most), (ACTIVE_AT_HANDLE, at_handle)):
        surely, likely = (np.maximum.accumulate(energy < limits.floor + more) for more in (-_ROUNDING, _ROUNDING))
        is_active = logged & bit > 0
        wrong = np.flatnonzero((surely & ~is_active) | (is_active & ~likely))
        if len(wrong):
            row = int(wrong[0])
            expected = logged[row] ^ bit
            return Mismatch(name, int(log.timing["sync_index"][row]), "active", float(logged[row]), float(expected))
    return None


def rows_before_a_gap(log: EnergyLog) -> int:
    """Return the number of rows before the first that the log lost."""
    lost = log.timing["dropped_before"]
    return int(np.argmax(lost > 0)) if lost.any() else log.rows


def periods_of(log: EnergyLog) -> list[int]:
    """Return the length of the hold that ended at each row [sample times], up to the first row that the log lost.

    It follows from the times of the SYNCs. For a late SYNC next to a skipped one it may be wrong by a sample time.
    """
    rows, period = rows_before_a_gap(log), log.sample_time_ns
    sent = log.deadlines(0, rows) * period + np.maximum(0, log.timing.read("wakeup_lateness", 0, rows))
    return [1, *np.maximum(1, (np.diff(sent) + period // 2) // period).tolist()][:rows]


def logged_rows(log: EnergyLog, port: str, columns: Sequence[str]) -> Iterator[tuple[float, ...]]:
    """Yield some columns of a port row by row, with one block of rows in memory at a time."""
    for start in range(0, log.rows, _BLOCK):
        block = (log.ports[port].read(column, start, start + _BLOCK).tolist() for column in columns)
        yield from zip(*block, strict=True)


def efforts_asked(log: EnergyLog, axis: str) -> Iterator[float]:
    """Yield the effort requested on an axis, row by row [N or N*m]: the negative torque."""
    return (effort for (effort,) in logged_rows(log, axis, ("effort_requested",)))


def recompute_all(log: EnergyLog, config: Path | None = None, *, allow_code: bool = False) -> list[Recomputed]:
    """Return the outcome for every port, recomputed with the controllers of the run's own scene.

    Args:
        log: An open energy log that holds the run from its first cycle.
        config: Scene file; by default the one that the log names.
        allow_code: Whether program files that the scene names may run.

    Raises:
        InputError: The scene cannot be read, differs from the scene of the run, or names user code that has changed.
    """
    scene = scene_of(log, config, allow_code=allow_code)
    ports, dry_run = build_ports(scene), log.dry_run
    axes = [axis.parameters.name for axis in scene.axes]
    found: dict[str, Mismatch | None] = {
        of.port: of
        for of in recompute(log, axes, Ports(ports, dry_run=dry_run), partial(stop_of, scene, ports, dry_run=dry_run))
    }
    for name in log.ports:
        found.setdefault(name, activity_mismatch(log, name))
    whole, skips = rows_before_a_gap(log), np.flatnonzero(np.diff(log.deadlines()) > 1) + 1
    skipped = int(skips[0]) if len(skips) else log.rows
    results: list[Recomputed] = []
    for name in log.ports:
        mismatch, rows = found.get(name), whole
        if mismatch is not None and mismatch.cycle >= int(log.timing["sync_index"][min(skipped, log.rows - 1)]):
            mismatch, rows = None, min(rows, skipped)  # how long that hold lasted is not in the log
        values = None if mismatch is None else mismatch._asdict()
        unchecked = log.rows - rows
        results.append(
            {"port": name, "mismatch": values, "rows": rows, "unchecked_rows": unchecked, "missing_rows": log.dropped}
        )
    return results


def scene_of(log: EnergyLog, config: Path | None = None, *, allow_code: bool = False) -> Scene:
    """Return the scene of the run that a log holds, with the overrides of that run.

    Args:
        log: An open energy log.
        config: Scene file; by default the one that the log names.
        allow_code: Whether program files that the scene names may run.

    Raises:
        InputError: The scene cannot be read, differs from the scene of the run, or names user code that has changed.
    """
    overrides = log.decoded("config_overrides", list[str]())
    if log.format_version <= _LAST_OLD_FORMAT:
        overrides = overrides_now(overrides)
    path = config or Path(str(log.attributes.get("config_source", "")))
    if not path.is_file():
        raise InputError(f"{log.path}: its scene {str(path)!r} does not exist; name it with --config")
    scene = load_scene(path, overrides, allow_code=allow_code)
    resolved = log.decoded("config_resolved", dict[str, dict[str, str]]())
    require_same_code(scene.own_code, resolved.get("own_code", {}), str(log.path))
    if resolved.get("run", {}).get("code_runs_in") == "process":
        scene = apart(replace(scene, run=scene.run.model_copy(update={"code_runs_in": "process"})))
    hashes = [scene.config_hash(), *(earlier_hash(scene, release, resolved) for release in RELEASES)]
    if log.attributes.get("config_hash") not in hashes:
        raise InputError(
            f"{path}: is not the scene of {log.path}, or was changed since; name the right one with --config"
        )
    return scene


# --- from the frames --------------------------------------------------------------------------------------------------


@dataclass(slots=True)
class _Heard:
    """Torque record of one axis from its frames; after a missing one the torque that acted is unknown."""

    read_back_bound: float = 0.0
    longest_hold: int = 1
    longest_gap: int = 1
    uncommanded: int = 0
    open_time: int | None = None
    open_torque: float = 0.0

    def take(self, sample: Sample, periods: int, shows_demand: bool) -> None:
        """Update the record with the sample of the next SYNC."""
        self.longest_gap = max(self.longest_gap, periods)
        if not sample.fresh or periods > 1 or not shows_demand:
            self.read_back_bound = inf


def samples_of(bus_log: str | Path, scene: Scene, remarks: Remarks) -> Iterator[tuple[int, list[Sample], list[bool]]]:
    """Yield for each SYNC the sample times since the last, each axis's sample, and whether its torque is the demand.

    From the first SYNC that all axes answered in OPERATION ENABLED to the last one. The ramp of the stop is included,
    since frames do not distinguish it from the run.

    Raises:
        LogFormatError: The bus log cannot be read, or the time of a SYNC is not known, so that a hold has no length.
    """
    together = {axis: port.places for port in scene.ports for axis in port.places}
    cycle, axes, rows = -1, *(_on_can if kind_of(scene.bus) == "can" else _on_line)(scene, bus_log, remarks)
    for periods in rows:
        if cycle >= 0 and any(axis.has_left for axis in axes):
            return
        if cycle >= 0 or all(axis.is_enabled for axis in axes):
            cycle += 1
            shown = [axis.shows_demand for axis in axes]
            samples = [
                axis.sample(cycle, is_whole=all(axes[other].is_complete for other in together[number]))
                for number, axis in enumerate(axes)
            ]
            yield periods, samples, shown


_HeardRows = tuple[Sequence[HeardAxis], Iterator[int]]
"""Axes, and for each SYNC, once they have heard what answers it, the sample times since the one before."""


def line_of(scene: Scene, remarks: Remarks) -> "ListenedLine":
    """Return the axes of the EtherCAT line of a scene, which have heard nothing yet; raise InputError."""
    from canhaptic.audit.listened_line import ListenedLine

    return ListenedLine([_declared(axis, scene) for axis in scene.axes], scene, remarks)


def cycles_on_line(bus_log: str | Path, scene: Scene) -> int | None:
    """Return the cycles of a recorded run of a line, with those of its stop; None without one. Errors as `samples_of`.

    No frame says where a stop began, but the drives answer as enabled until the command to leave.
    """
    line = line_of(scene, Remarks())
    enabled = [n for n, _ in enumerate(line.rows(bus_log)) if all(axis.is_enabled for axis in line.axes)]
    answered = 1 + scene.bus.delay  # once more after the command to leave
    return max(1, enabled[-1] - enabled[0] + 1 - answered) if enabled else None


def _on_line(scene: Scene, bus_log: str | Path, remarks: Remarks) -> _HeardRows:
    line = line_of(scene, remarks)
    return line.axes, line.rows(bus_log)


def _on_can(scene: Scene, bus_log: str | Path, remarks: Remarks) -> _HeardRows:
    axes = [ListenedAxis(_declared(axis, scene)) for axis in scene.axes]
    return axes, _rows_of_can(axes, scene, bus_log, remarks)


def _rows_of_can(axes: Sequence[ListenedAxis], scene: Scene, bus_log: str | Path, remarks: Remarks) -> Iterator[int]:
    on_bus = [[a for a, of in zip(axes, scene.axes, strict=True) if of.bus == bus.name] for bus in scene.buses]
    place_of = Channels(scene).place_of
    sent, periods, period = 0, 1, scene.bus.sample_time_ns
    for frame in read_bus_log(bus_log, remarks):
        place = place_of(frame)
        if frame.can_id != od.SYNC_FRAME_COB_ID:
            for axis in on_bus[place]:
                axis.take(frame)
            continue
        if place:  # the SYNC of the same index on another bus, sent right after the SYNC of the first bus
            continue
        yield periods
        _require_time(bus_log, frame, sent)
        periods, sent = (frame.timestamp_ns - sent + period // 2) // period or 1, frame.timestamp_ns
        for axis in axes:
            axis.forget()
    if all(axis.is_enabled for axis in axes):  # no SYNC follows the last one
        yield periods


def _require_time(bus_log: str | Path, sync: Frame, last: int) -> None:
    if sync.timestamp_ns < last:
        seen = "no time" if sync.timestamp_ns == UNTIMED else "an earlier time than the last one"
        text = f"{bus_log}: the SYNC at line or frame {sync.number} has {seen}, so the length of a hold is not known"
        raise LogFormatError(f"{text}; record with candump -L")


def _declared(axis: AxisScene, scene: Scene) -> DeclaredDrive:
    given = axis.parameters
    number = getattr(given, PLACES[kind_of(scene.bus_of(axis))])
    display, force = given.admittance, None
    if display is not None:
        given_force, place = display.force, display.force.place
        force = DeclaredForce(
            OF_A_NODE if place is None else place[0], given_force.per_count, given_force.offset_counts,
            given_force.node, axis.loop.sample_time if given_force.sampling == "impulse" else 0.0, given_force.bits,
        )  # fmt: skip
    return DeclaredDrive(
        given.name, number, given.dictionary_path, given.counts_per_unit, given.direction, given.transmission,
        given.rated_torque, given.quirks, given.demand_reported, force,
    )  # fmt: skip


class Rederived(Verdicts):
    """The account of a run from its frames, with the names of `run --json`."""

    status: NotRequired[str]
    cycles: int
    remarks: list[str]  # what was left out of the bus log, and what is odd about its times
    ports: dict[str, PortResult]
    damage: list[str]  # frames of a line that cannot be as they were
    differences: NotRequired[list[dict[str, str | int | float]]]  # with a log: the first of each port
    checks: NotRequired[list[Outcome]]


_COMPARED: Final = (
    *("position", "torque_applied", "interaction", "h_pas", "h_m", "dissipated", "stored", "surplus", "generated"),
    "deficit",
)


def rederive(bus_log: str | Path, scene: Scene, log: EnergyLog | None = None) -> Rederived:
    """Return the account of a run from its frames, and the first difference of each port from the logged one.

    Args:
        bus_log: Bus log of the run, bring-up included.
        scene: The scene of the run.
        log: Energy log of the same run; its last SYNC ends the account.

    Raises:
        InputError: The log holds no SYNC that every axis answered in OPERATION ENABLED.
    """
    derived = _Derivation(
        scene, dry_run=log is not None and log.dry_run, stopping=-1 if log is None else row_of_stop(log)
    )
    logged = {} if log is None else {name: _logged(log, name) for name in derived.units}
    differences: dict[str, dict[str, str | int | float]] = {}
    asked = _asked(derived.programs, scene, log, bus_log)
    remarks = Remarks()
    for periods, samples, shown in samples_of(bus_log, scene, remarks):
        if log is not None and derived.cycles == log.rows:
            break
        for program, efforts in asked:
            program.ask(-next(efforts))
        rows = derived.take(periods, samples, shown)
        for (name, columns), (sample, balance) in zip(logged.items(), rows, strict=False):
            found = (sample.position, sample.torque_applied, *balance[1:])
            for quantity, was, now in zip(_COMPARED, next(columns), found, strict=False):
                if was != now and name not in differences:
                    differences[name] = _difference(name, derived.cycles - 1, quantity, was, now)
    cycles = derived.cycles
    if not cycles:
        text = f"{bus_log}: no SYNC was answered in OPERATION ENABLED by every axis of {scene.source}"
        raise InputError(f"{text}; name the scene of this log")
    ports = derived.accounts(_holds(scene, log))
    result = cast("Rederived", {"cycles": cycles, "remarks": remarks.lines(), **overall(ports), "ports": ports})
    result["damage"] = remarks.note_lines(sorted(remarks.damage))
    if log is not None:
        result["differences"] = list(differences.values())
        if cycles < log.rows:  # the frames end before the log
            result["differences"].append(_difference("", cycles, "cycles", log.rows, cycles))
    return result


def _difference(port: str, cycle: int, quantity: str, logged: float, rederived: float) -> dict[str, str | int | float]:
    return {"port": port, "cycle": cycle, "quantity": quantity, "logged": logged, "rederived": rederived}


def _logged(log: EnergyLog, port: str) -> Iterator[tuple[float, ...]]:
    if port not in log.ports:
        raise InputError(f"{log.path}: has no port {port!r}, so it is of another scene; name the log of this run")
    return logged_rows(log, port, _COMPARED)


def _holds(scene: Scene, log: EnergyLog | None) -> dict[str, str]:
    """Return whether the hold of each axis was checked: by the energy log, or without one by the scene."""
    if log is not None:
        return {event.port: event.text for event in log.events if event.kind == "hold"}
    known = {axis.parameters.name: scene.hold_of(axis) for axis in scene.axes}
    checked = {axis.parameters.name for axis in scene.axes if axis.parameters.hold_checked}
    return {name: "checked at commissioning" if name in checked else hold for name, hold in known.items() if hold}


def _asked(
    programs: Sequence[tuple[int, Any]], scene: Scene, log: EnergyLog | None, bus_log: str | Path
) -> list[tuple[Any, Iterator[float]]]:
    """Return the controllers of a program, each with the efforts that it requested, which no frame holds."""
    if not programs:
        return []
    if log is None:
        text = f"{bus_log}: a program requested the torques, and no frame holds its requests"
        raise InputError(f"{text}; name the energy log of the run as well")
    return [(each, efforts_asked(log, scene.axes[axis].parameters.name)) for axis, each in programs]


class _Derivation:
    """Controllers and accounts of a scene, driven by the samples from the frames.

    Attributes:
        units: Name and unit of each axis, then of each group.
        cycles: Number of SYNCs processed.
        programs: Axes whose torques a program requests, and their controllers.
    """

    def __init__(self, scene: Scene, *, dry_run: bool, stopping: int) -> None:
        self._scene, self._dry_run, self._stopping = scene, dry_run, stopping
        self._ports: Ports = Ports(build_ports(scene), dry_run=dry_run)
        self._torques = [_Heard() for _ in scene.axes]
        self._meters = RunMeters(build_axis_meters(scene), self._torques, self._ports)
        self.units: dict[str, str] = {axis.parameters.name: axis.parameters.unit for axis in scene.axes}
        self.units |= {group.name: self.units[group.axes[0]] for group in scene.groups}
        self.cycles, self._deadline = 0, -1
        self.programs = self._ports.programs

    def take(self, periods: int, samples: list[Sample], shown: Sequence[bool]) -> list[tuple[Sample, EnergyBalance]]:
        """Compute the cycle of a SYNC from its samples; return sample and balance of each axis, then of each group.

        Args:
            periods: Sample times since the previous SYNC.
            samples: Sample of each axis.
            shown: Whether the reported torque of each axis is the drive's demand (0x6074).
        """
        if self.cycles == self._stopping:
            self._ports = stop_of(self._scene, self._ports.ports, dry_run=self._dry_run)
        self._ports.note_skipped_syncs(periods)
        for axis, sample, is_demand in zip(self._torques, samples, shown, strict=True):
            axis.take(sample, periods, is_demand)
        balances = self._ports.balances_of(samples)
        samples = [*samples, *(port.sample(samples) for port in self._ports.several)]
        self._deadline += periods if self.cycles else 1
        self._meters.take(samples, balances, self.cycles, self._deadline)
        self.cycles += 1
        return list(zip(samples, balances, strict=True))

    def accounts(self, holds: Mapping[str, str]) -> dict[str, PortResult]:
        """Return the accounts of the axes, then of the groups; for an axis in a group only the energy through it.

        Args:
            holds: Axis -> whether its hold was checked.
        """
        scene, time = self._scene, self._scene.bus.sample_time
        rendered = [*(axis.passivity for axis in scene.axes), *(group.passivity for group in scene.groups)]
        known = zip(self.units.items(), self._meters.ports, rendered, strict=True)
        ports: dict[str, PortResult] = {
            name: {
                "unit": unit,
                "algorithm": of.name,
                **port_account(port, port.ledger.summary().as_json(time), promise_of(of.parameters), time),
            }
            for (name, unit), port, of in known
        }
        for name, hold in holds.items():
            ports[name]["hold"] = hold
        for account in ports.values() if self._dry_run else ():
            claim_nothing(account)
        return with_groups(ports, {group.name: group.axes for group in scene.groups})


# --- logs of earlier releases -----------------------------------------------------------------------------------------


OLD_KEYS: Final = {"lead": "prediction_holds", "credit": "energy_allowance", "lost_frames": "max_consecutive_losses"}
"""Key of `passivity` in release 0.1 -> its name in release 0.2."""
OLD_ALGORITHMS: Final = {"direct": "unprotected", "original": "a_priori_dissipation"}
"""Algorithm of an axis in release 0.1 -> its name now."""
GONE_KEYS: Final = ("compiled", "prediction_holds", "may_cut")
"""Keys of `passivity` and `simulation` that were removed."""
_Plain = dict[str, Any]
"""A section of the configuration in effect, as JSON values."""
Release = Literal["0.1", "0.2"]
RELEASES: Final[tuple[Release, ...]] = get_args(Release)
"""Earlier releases whose logs can be compared with their scenes."""
_GONE: Final[dict[str, dict[str, _Plain]]] = {
    "axes": {"guarded": {"prediction_holds": 0.75}},
    "groups": {"": {"compiled": False}, "guarded": {"prediction_holds": 0.5, "may_cut": False}},
}
"""Owner -> algorithm ("" for all) -> removed key of `passivity` -> its default in release 0.2."""
_SECTION: Final = "passivity"
_SELECTOR: Final = "algorithm"


def overrides_now(overrides: Iterable[str]) -> list[str]:
    """Return overrides of an earlier release with today's names and without removed keys."""
    found = []
    for text in overrides:
        path, equals, value = text.partition("=")
        *owner, key = path.strip().split(".")
        if owner[-1:] == [_SECTION]:
            key = OLD_KEYS.get(key, key)
            value = OLD_ALGORITHMS.get(value.strip(), value) if key == _SELECTOR else value
        if not (owner[-1:] in ([_SECTION], ["simulation"]) and key in GONE_KEYS):
            found.append(f"{'.'.join((*owner, key))}{equals}{value}")
    return found


def earlier_hash(scene: Scene, release: Release, logged: Mapping[str, Any] | None = None) -> str:
    """Return the hash that an earlier release would write into a log of a scene.

    Args:
        scene: Scene as loaded by this release.
        release: Release that wrote the log.
        logged: Configuration in effect in the log, for the values of removed keys; None: their defaults.
    """
    old, logged = scene.hashed(), logged or {}
    if old["simulation"] is not None:
        old["simulation"]["compiled"] = (logged.get("simulation") or {}).get("compiled", False)
    displays = {name for name, axis in old["axes"].items() if "admittance" in axis}
    for kind, gone in _GONE.items():
        for name, owner in old.get(kind, {}).items():
            if not displays.intersection(owner.get("axes", (name,))):
                then = logged.get(kind, {}).get(name, {}).get(_SECTION, {})
                _put_gone(owner[_SECTION], gone, {OLD_KEYS.get(key, key): value for key, value in then.items()})
    return hash_of(old if release == "0.2" else _in_old_names(old, LATER_LOOP_KEYS))


def _put_gone(section: _Plain, gone: Mapping[str, Mapping[str, Any]], then: Mapping[str, Any]) -> None:
    """Add the keys to a section `passivity` that its algorithm had then, in place."""
    for algorithm in ("", section[_SELECTOR]):
        section |= {key: then.get(key, default) for key, default in gone.get(algorithm, {}).items()}


def _in_old_names(old: _Plain, later: Collection[str]) -> _Plain:
    """Change a configuration to the names and keys of release 0.1, in place."""
    keys, algorithms = ({new: name for name, new in table.items()} for table in (OLD_KEYS, OLD_ALGORITHMS))
    for owner in (*old["axes"].values(), *old.get("groups", {}).values()):
        section = {keys.get(key, key): value for key, value in owner[_SECTION].items()}
        section[_SELECTOR] = algorithms.get(section[_SELECTOR], section[_SELECTOR])
        if section.get("hand_push") == section.get("hand_force"):
            section.pop("hand_push", None)
        owner[_SECTION] = section
    for axis in old["axes"].values():
        axis["loop"] = {key: value for key, value in axis["loop"].items() if key not in later}
        axis["loop"]["device_damping_bound"] = axis["loop"]["device_damping_bound"] or None
    return old
