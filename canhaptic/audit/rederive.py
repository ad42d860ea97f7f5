"""The energy account of a run from its bus log and its scene: frames -> samples -> controllers -> ledger.

Frames are decoded with the PDO maps and rated torques of the bring-up in the log, without the codecs of the master, so
that this account is independent of the logged one.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from math import inf
from pathlib import Path
from typing import Any, Final, NotRequired, cast

from canhaptic.audit.listened_axis import OF_A_NODE, DeclaredDrive, DeclaredForce, ListenedAxis
from canhaptic.audit.recompute import efforts_asked, logged_rows
from canhaptic.audit.user_checks import Outcome
from canhaptic.canopen import objects as od
from canhaptic.control.balance import EnergyBalance
from canhaptic.control.ledger import Ledger
from canhaptic.control.multi_axis.group_controller import GroupedControllers
from canhaptic.control.verdict import NOT_CHECKED, PortResult, claim_nothing
from canhaptic.errors import InputError
from canhaptic.logs.bus_reader import read_bus_log
from canhaptic.logs.energy_reader import EnergyLog
from canhaptic.meters import RunMeters, promise_of
from canhaptic.result import Verdicts, overall, port_account, with_groups
from canhaptic.scene.models import AxisScene, Scene
from canhaptic.scene.parts import build_axis_controllers, build_axis_groups, build_axis_meters
from canhaptic.scene.scene_logs import Channels
from canhaptic.signals import Sample


@dataclass(slots=True)
class _Heard:
    """Torque record of one axis from its frames; after a missing one the torque that acted is unknown."""

    read_back_bound: float = 0.0
    longest_hold: int = 1
    longest_gap: int = 1
    uncommanded: int = 0
    open_time: int = 0
    open_torque: float = 0.0

    def take(self, sample: Sample, periods: int, shows_demand: bool) -> None:
        """Update the record with the sample of the next SYNC."""
        self.longest_gap = max(self.longest_gap, periods)
        if not sample.fresh or periods > 1 or not shows_demand:
            self.read_back_bound = inf


def _samples_of(bus_log: str | Path, scene: Scene) -> Iterator[tuple[int, list[Sample], list[bool]]]:
    """Yield for each SYNC the sample times since the last, each axis's sample, and whether its torque is the demand.

    From the first SYNC that all axes answered in OPERATION ENABLED to the last one. The ramp of the stop is included,
    since frames do not distinguish it from the run.

    Raises:
        LogFormatError: The bus log cannot be read.
    """
    axes = [ListenedAxis(_declared(axis)) for axis in scene.axes]
    on_bus = [[a for a, of in zip(axes, scene.axes, strict=True) if of.bus == bus.name] for bus in scene.buses]
    place_of = Channels(scene).place_of
    together = {axis: group for group in scene.group_places for axis in group}
    cycle, sent, periods, period = -1, 0, 1, scene.bus.sample_time_ns

    def heard() -> tuple[int, list[Sample], list[bool]]:
        shown = [axis.shows_demand for axis in axes]
        samples = [
            axis.sample(cycle, is_whole=all(axes[other].is_complete for other in together.get(number, ())))
            for number, axis in enumerate(axes)
        ]
        return periods, samples, shown

    for frame in read_bus_log(bus_log):
        place = place_of(frame)
        if frame.can_id != od.SYNC_FRAME_COB_ID:
            for axis in on_bus[place]:
                axis.take(frame)
            continue
        if place:  # the SYNC of the same index on another bus, sent right after the SYNC of the first bus
            continue
        if any(axis.has_left for axis in axes) and cycle >= 0:
            return
        if cycle >= 0 or all(axis.is_enabled for axis in axes):
            cycle += 1
            yield heard()
        periods, sent = (frame.timestamp_ns - sent + period // 2) // period or 1, frame.timestamp_ns
        for axis in axes:
            axis.forget()
    if all(axis.is_enabled for axis in axes):  # no SYNC follows the last one
        cycle += 1
        yield heard()


def _declared(axis: AxisScene) -> DeclaredDrive:
    given = axis.parameters
    named = {field.name: getattr(given, field.name) for field in fields(DeclaredDrive) if field.name != "force"}
    display, force = given.admittance, None
    if display is not None:
        given_force, place = display.force, display.force.place
        force = DeclaredForce(
            OF_A_NODE if place is None else place[0], given_force.per_count, given_force.offset_counts,
            given_force.node, axis.loop.sample_time if given_force.sampling == "impulse" else 0.0, given_force.bits,
        )  # fmt: skip
    return DeclaredDrive(**named, force=force)


class Rederived(Verdicts):
    """The account of a run from its frames, with the names of `run --json`."""

    status: NotRequired[str]
    cycles: int
    ports: dict[str, PortResult]
    differences: NotRequired[list[dict[str, str | int | float]]]  # with a log: the first of each port
    checks: NotRequired[list[Outcome]]


_COMPARED: Final = ("position", "torque_applied", "h_i", "h_pas", "h_m", "h_r", "h_s", "h_dis", "gen", "deficit")


def rederive(bus_log: str | Path, scene: Scene, log: EnergyLog | None = None) -> Rederived:
    """Return the account of a run from its frames, and the first difference of each port from the logged one.

    Args:
        bus_log: Bus log of the run, bring-up included.
        scene: The scene of the run.
        log: Energy log of the same run; its last SYNC ends the account.

    Raises:
        InputError: The log holds no SYNC that every axis answered in OPERATION ENABLED.
    """
    derived = _Derivation(scene, dry_run=log is not None and log.dry_run)
    logged = {} if log is None else {name: _logged(log, name) for name in derived.units}
    differences: dict[str, dict[str, str | int | float]] = {}
    asked = _asked(derived.programs, scene, log, bus_log)
    for periods, samples, shown in _samples_of(bus_log, scene):
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
    result = cast("Rederived", {"cycles": cycles, **overall(ports), "ports": ports})
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
    given = [axis.parameters for axis in scene.axes if not scene.simulated and axis.parameters.admittance is None]
    return {of.name: "checked at commissioning" if of.hold_checked else NOT_CHECKED for of in given}


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

    def __init__(self, scene: Scene, *, dry_run: bool) -> None:
        self._scene, self._dry_run = scene, dry_run
        self._groups, alone = build_axis_groups(scene), build_axis_controllers(scene)
        self._controllers = GroupedControllers(alone, self._groups, dry_run)
        self._torques = [_Heard() for _ in scene.axes]
        self._meters = RunMeters(build_axis_meters(scene), self._torques, alone, self._groups)
        self.units: dict[str, str] = {axis.parameters.name: axis.parameters.unit for axis in scene.axes}
        self.units |= {group.name: self.units[group.axes[0]] for group in scene.groups}
        self._ledgers = [Ledger() for _ in self.units]
        self.cycles, self._deadline = 0, -1
        self.programs = self._controllers.programs

    def take(self, periods: int, samples: list[Sample], shown: Sequence[bool]) -> list[tuple[Sample, EnergyBalance]]:
        """Compute the cycle of a SYNC from its samples; return sample and balance of each axis, then of each group.

        Args:
            periods: Sample times since the previous SYNC.
            samples: Sample of each axis.
            shown: Whether the reported torque of each axis is the drive's demand (0x6074).
        """
        self._controllers.lasted(periods)
        for axis, sample, is_demand in zip(self._torques, samples, shown, strict=True):
            axis.take(sample, periods, is_demand)
        balances = [*self._controllers.step(samples), *(group.balance.account for group in self._groups)]
        samples = [*samples, *(group.sample(samples) for group in self._groups)]
        self._deadline += periods if self.cycles else 1
        for group in self._groups:
            group.book(self.cycles, self._deadline)
        for ledger, balance in zip(self._ledgers, balances, strict=True):
            ledger.add(balance, self.cycles)
        self._meters.take(samples, balances, self._ledgers, self._deadline)
        self.cycles += 1
        return list(zip(samples, balances, strict=True))

    def accounts(self, holds: Mapping[str, str]) -> dict[str, PortResult]:
        """Return the accounts of the axes, then of the groups; for an axis in a group only the energy through it.

        Args:
            holds: Axis -> whether its hold was checked.
        """
        scene, time = self._scene, self._scene.bus.sample_time
        rendered = [*(axis.passivity for axis in scene.axes), *(group.passivity for group in scene.groups)]
        known = zip(self.units.items(), self._meters.ports, self._ledgers, rendered, strict=True)
        ports: dict[str, PortResult] = {
            name: {"unit": unit, **port_account(port, ledger.summary().as_json(time), promise_of(of.parameters), time)}
            for (name, unit), port, ledger, of in known
        }
        for name, hold in holds.items():
            ports[name]["hold"] = hold
        for account in ports.values() if self._dry_run else ():
            claim_nothing(account)
        return with_groups(ports, {group.name: group.axes for group in scene.groups})
