"""Construction of a rig from a scene, and the object that holds, closes and accounts for everything that runs.

    with build(load_scene("configs/demo.yaml")) as experiment:
        run(experiment.cycle, cycles=10_000)

Nothing is sent before `run`. Each axis and each group is a port with an energy account of its own.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from math import inf
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Literal, Self, TypeAlias, cast

from canhaptic.axis_units import effort_unit, uses_degrees
from canhaptic.control.axis_meter import AxisMeter
from canhaptic.control.ledger import DEFAULT_GROWTH, DEFAULT_LIMIT, EnergyLossMeter
from canhaptic.control.ports import Port
from canhaptic.control.verdict import GUARANTEEING, PortResult
from canhaptic.cycle import Cycle, run
from canhaptic.drive.bus_cycle import BusCycle
from canhaptic.drive.clock import Clock, VirtualClock, WallClock
from canhaptic.drive.profile.torque_axis import TorqueAxis
from canhaptic.drive.rig import Rig
from canhaptic.errors import CanHapticError, InputError, cause_of
from canhaptic.result import RunResult, run_result
from canhaptic.scene.buses import BusParameters, kind_of, part, part_if_any
from canhaptic.scene.models import FAR, AxisScene, Scene
from canhaptic.scene.parts import build_axis_meters, build_ports, build_servo_drive, require_torque_axis
from canhaptic.signals import SimulatedPeer, Truth

if TYPE_CHECKING:
    import can

    from canhaptic.drive.can.link import Link
    from canhaptic.drive.ethercat.bus_cycle import EthercatBusCycle
    from canhaptic.far.parameters import FarParameters
    from canhaptic.far.side import FarSide, Transport
    from canhaptic.logs.frame_log import FrameLog, LoggedFrame, RecordedLine
    from canhaptic.logs.tap import Tap
    from canhaptic.logs.writer_process import BusLogWriter, EnergyLogWriter
    from canhaptic.scene.coupled import CoupledCycle
    from canhaptic.scene.own_code import CodeProcess
    from canhaptic.sim.bus.faulty_bus import FaultyBus
    from canhaptic.sim.drive.can.drive_node import Drives, DrivesOnBus, SimulatedDrive
    from canhaptic.sim.drive.ethercat.cable import Cable
    from canhaptic.sim.plant.plant import Plant


def build_loss_meters(scene: Scene) -> list[EnergyLossMeter]:
    """Return a meter for each port that has a limit on the energy it may generate beyond the declared energy.

    In a simulation an algorithm without a guarantee has no limit unless one is declared. The uncertainty of a display
    is that of its force sensor, which has no limit by default; over a way, an offset of it is more energy than a port
    may lose, so that a display alone has no meter. The cycle counts what declared dry friction dissipates.
    """
    meters = []
    for port in scene.ports:
        axes, passivity = port.axes, port.passivity
        is_limited = passivity.name in GUARANTEEING or not scene.simulated
        limit = _least((axis.parameters.energy_loss_limit for axis in axes), DEFAULT_LIMIT if is_limited else inf)
        growths = [axis.parameters.energy_uncertainty_limit for axis in axes]
        is_display = axes[0].parameters.admittance is not None
        growth = _least(growths, inf if limit == inf or is_display else DEFAULT_GROWTH)
        if min(limit, growth) == inf or (is_display and not axes[0].group):
            continue
        is_of_link = all(growth is None for growth in growths)
        damping = [0.0 if axis.loop.device_friction else axis.loop.device_damping or 0.0 for axis in axes]
        allowance = getattr(passivity.parameters, "energy_allowance", 0.0)
        meter = _meter_of(axes[0])(
            port.name, port.places, limit, allowance, damping, scene.bus.sample_time, growth, is_of_link=is_of_link
        )
        meters.append(meter)
    return meters


def _meter_of(axis: AxisScene) -> type[EnergyLossMeter]:
    if axis.guard != FAR:
        return EnergyLossMeter
    from canhaptic.far.side import CoupledLossMeter

    return CoupledLossMeter


def _least(given: Iterable[float | str | None], default: float) -> float:
    """Return the least of some limits: None is the default, `none` is no limit."""
    return min(default if one is None else inf if isinstance(one, str) else one for one in given)


def logs_elsewhere(scene: Scene, *, energy: bool, bus: bool) -> list[str]:
    """Return a note on each log that a scene puts outside its own folder and the current one.

    A scene may come from another person: its log paths must not overwrite a file elsewhere.

    Args:
        scene: The scene.
        energy: Whether the scene's energy log is used, because the user named none.
        bus: Whether the scene's bus log is used.

    Raises:
        InputError: Such a log already exists.
    """
    homes = (Path.cwd().resolve(), Path(scene.source).resolve().parent)
    notes = []
    for is_used, key, option, path in (
        (energy, "log.energy", "--log", scene.log.energy),
        (bus, "log.bus", "--bus-log", scene.log.bus),
    ):
        if not is_used or path is None or any(path.resolve().is_relative_to(home) for home in homes):
            continue
        if path.exists():
            text = f"{scene.source}: {key}: {path} already exists, outside the folder of the scene and the current one"
            raise InputError(f"{text}; give {option} {path} --force to replace it")
        notes.append(f"{key} of {scene.source} is outside its folder: {path}")
    return notes


def _with_channel(bus: BusParameters) -> BusParameters:
    named: Callable[[BusParameters], BusParameters] | None = part_if_any(kind_of(bus), "named")
    return bus if named is None else named(bus)


def _opened(named: Sequence[BusParameters], stack: ExitStack) -> "list[can.BusABC | None]":
    """Return one connection to each bus, closed with the stack; None for a line, which has no end of its own."""
    doors = ((part_if_any(kind_of(of), "open"), of) for of in named)
    return [None if door is None else door(of, stack) for door, of in doors]


def _simulated_side(
    scene: Scene, named: Sequence[BusParameters], stack: ExitStack
) -> "tuple[list[DrivesOnBus | Cable], Drives | None]":
    """Return the simulated drives of each bus, and of all buses in the order of the axes; none with real drives."""
    if not scene.simulated:
        return [], None
    from canhaptic.scene.far_side import build_far_end
    from canhaptic.sim.drive.can.drive_node import AllDrives

    groups, drives = list["DrivesOnBus | Cable"](), dict[str, "Iterator[SimulatedDrive]"]()
    for bus, of in zip(_opened(named, stack), scene.buses, strict=True):
        group, on_bus = build_far_end(scene, of.name, bus)
        groups.append(group)
        drives[of.name] = iter(on_bus)
    if not scene.further_buses and kind_of(scene.bus) == "can":
        return groups, cast("DrivesOnBus", groups[0])
    return groups, AllDrives(tuple(next(drives[axis.bus]) for axis in scene.axes))


def _faulty_buses(scene: Scene, buses: "Sequence[can.BusABC | None]", stack: ExitStack) -> "dict[int, FaultyBus]":
    """Return the master's connections to the buses with simulated faults, by index of the bus."""
    from canhaptic.scene.far_side import with_effects

    faulty = {n: of for n, bus in enumerate(buses) if bus and (of := with_effects(bus, scene, "master", n))}
    for bus in faulty.values():
        stack.callback(bus.shutdown)
    return faulty


ToFar: TypeAlias = "tuple[Transport, Callable[[], int] | None]"
"""What carries packets to a far side, and the random numbers of its sessions; None: of the system."""
_Pace = Literal["real", "free"]


class Experiment:
    """A built scene: everything that a run needs, to be closed after it.

    Attributes:
        scene: The scene it was built from.
        config_hash: Its hash.
        pace: "free" (lock-step with simulated drives, as fast as the machine allows) or "real".
        far_side: Simulated drives inside this process; None with real drives.
        faulty_buses: The master's connections to the buses with simulated faults, by name of the bus.
        cables: Simulated EtherCAT lines with faults, by name of the bus.
        cycle: Rig, controllers and accounts, ready for `canhaptic.cycle.run`.
        energy_log: Energy log, with every cycle; None without one.
        bus_log: Bus log of CAN buses, with every frame; None without one.
        far: Link to a far side; None without one.
        frame_log: Log of an EtherCAT line, with every frame; None without one.
        tap: Process that logs the interface of an EtherCAT line; None without one.
        played: Log of a line that is played in its place; None without one.
        code: Process in which user code runs; None where it runs in the cycle, or there is none.
    """

    def __init__(
        self, scene: Scene, pace: _Pace, energy_log: Path | None, bus_log: Path | None, *, no_torque: bool = False,
        recorded: "Sequence[LoggedFrame] | None" = None, to_far: "ToFar | None" = None,
    ) -> None:  # fmt: skip
        self.scene, self.pace, self._log_failure = scene, pace, ""
        self.config_hash = scene.config_hash()  # now: it reads the dictionaries, and a run may use up every descriptor
        ports, meters = build_ports(scene), build_axis_meters(scene)
        _require_push(scene, ports)
        with ExitStack() as stack:
            named = [_with_channel(bus.parameters) for bus in scene.buses]
            groups, self.far_side = _simulated_side(scene, named, stack)
            buses = _opened(named, stack)
            is_faulty = scene.simulated and scene.bus_effects is not None
            faulty = _faulty_buses(scene, buses, stack) if is_faulty else {}
            self.faulty_buses = {scene.buses[n].name: faulty_bus for n, faulty_bus in faulty.items()}
            lines = zip(scene.buses, groups, strict=False) if scene.cable_effects is not None else ()
            self.cables = {of.name: cast("Cable", line) for of, line in lines if kind_of(of.parameters) != "can"}
            self.clock = _build_clock(pace, scene.bus.spin_margin, groups, faulty)
            self._open_logs(energy_log, bus_log, meters, stack, dry_run=no_torque)
            links = self._linked(named, [faulty.get(n, bus) for n, bus in enumerate(buses)], groups, recorded, stack)
            if self.energy_log is not None:
                self.energy_log.clock = next((lock for of in links if (lock := getattr(of, "lock", None))), None)
            self.rig = _build_rig(scene, links, dry_run=no_torque)
            # A simulation in real time is as uneven as this computer; the declared jitter is that of the simulated bus.
            is_exact = pace == "free" or not scene.simulated
            jitters = [axis.loop.sync_jitter or 0.0 for axis in scene.axes] if is_exact else None
            known = meters, build_loss_meters(scene), jitters
            truths = _truths(self.far_side) if recorded is None else None
            kind = Cycle if scene.far is None else _coupled()
            self.cycle = kind(self.rig, ports, self.energy_log, truths, *known)
            self.code = self._start_code(stack)
            self.far = None if scene.far is None else self._couple(scene.far, known[1], to_far, stack)
            if self._log_failure:  # before the cycle existed
                self.cycle.fail_log(self._log_failure)
            self._stack = stack.pop_all()

    def __repr__(self) -> str:
        return f"<Experiment {self.scene.source}: {self.pace}, {self.cycle!r}>"

    def _open_logs(
        self, energy_log: Path | None, bus_log: Path | None, meters: Sequence[AxisMeter], stack: ExitStack, *,
        dry_run: bool,
    ) -> None:  # fmt: skip
        self.energy_log: EnergyLogWriter | None = None
        self.bus_log: BusLogWriter | None = None
        self.frame_log: FrameLog | None = None
        self.tap: Tap | None = None
        self.played: RecordedLine | None = None
        if not (energy_log or bus_log):
            return
        from canhaptic.scene.scene_logs import open_bus_log, open_energy_log

        scene, pace, lose = self.scene, self.pace, self._lose_log
        if energy_log:
            self.energy_log = open_energy_log(scene, meters, energy_log, pace, lose, dry_run=dry_run)
            stack.callback(self.energy_log.close, "failed")
        if bus_log and kind_of(scene.bus) != "can" and not scene.simulated:
            self.tap = part(kind_of(scene.bus), "tap")(scene.bus.interface, bus_log)
            stack.callback(self.tap.close)
        elif bus_log and kind_of(scene.bus) != "can":
            self.frame_log = stack.enter_context(part(kind_of(scene.bus), "frame_log")(bus_log))
        elif bus_log:
            self.bus_log = open_bus_log(scene, bus_log, pace, lose)
            stack.callback(self.bus_log.close)

    def _linked(
        self, named: Sequence[BusParameters], buses: "Sequence[can.BusABC | None]",
        groups: "Sequence[DrivesOnBus | Cable]", recorded: "Sequence[LoggedFrame] | None", stack: ExitStack,
    ) -> "list[Any]":  # fmt: skip
        """Return the rig's side of each bus or line, with its log; one without a bus carries its frames itself."""
        records = [self.bus_log.on(n) if self.bus_log else None for n in range(len(buses))]
        cables = [self._logged(group, recorded) for group in groups] or [None] * len(buses)
        ends = [bus or cables[n] for n, bus in enumerate(buses)]
        return [
            part(kind_of(of), "line")(end, self.clock, of, stack, record)
            for of, end, record in zip(named, ends, records, strict=True)
        ]

    def _logged(self, line: Any, recorded: "Sequence[LoggedFrame] | None") -> Any:
        """Return what carries the frames of a line: it, with a log of them, or a log of them in its place."""
        if recorded is None and self.frame_log is None:
            return line
        from canhaptic.logs.frame_log import RecordedLine, RecordingLine

        if self.frame_log is not None:
            return RecordingLine(line, self.clock, self.frame_log.note)
        self.played = RecordedLine(list(recorded or ()), self.clock)
        return self.played

    def _couple(
        self, far: "FarParameters", meters: Sequence[EnergyLossMeter], to_far: "ToFar | None", stack: ExitStack
    ) -> "FarSide":
        """Return the link of the axis that a far side has; without `to_far` in a simulation no packet arrives."""
        from canhaptic.far.side import CoupledLossMeter, FarSide, Nowhere, over_udp

        place = [axis.guard for axis in self.scene.axes].index(FAR)
        port = next(port.controller for port in self.cycle.ports if port.row == place)
        transport, fresh = to_far or (Nowhere() if self.pace == "free" else over_udp(far), None)
        side = FarSide(far, port, place, transport, fresh)
        cast("CoupledCycle", self.cycle).far = side
        if self.energy_log is not None:
            self.energy_log.far = side.row
        stack.callback(side.close)
        for meter in meters:
            if isinstance(meter, CoupledLossMeter):
                meter.side = side
        return side

    def _start_code(self, stack: ExitStack) -> "CodeProcess | None":
        """Start the process of user code; None where the cycle runs it, or none exists."""
        run = self.scene.run
        if run.guard is not None or run.code_runs_in != "process" or not any(a.guard for a in self.scene.axes):
            return None
        from canhaptic.scene.own_code import CodeProcess

        code = CodeProcess(self.scene, self.cycle, self.pace)
        stack.callback(code.close)
        self.cycle.turn = code.turn
        return code

    def _lose_log(self, reason: str) -> None:
        """Record, from another thread, that a log failed; `close` reports it in any case."""
        if self.scene.log.on_failure == "stop":
            self._log_failure = reason
            if hasattr(self, "cycle"):
                self.cycle.fail_log(reason)

    @property
    def plants(self) -> "list[Plant]":
        """The simulated plant of each axis; none with real drives."""
        if self.far_side is None:
            return []
        from canhaptic.sim.plant.plant import Plant

        motors = [drive.servo.motor for drive in self.far_side.drives]
        return [motor for motor in motors if isinstance(motor, Plant)]

    def run_through(
        self,
        cycles: int | None,
        stop_requested: Callable[[], bool] = lambda: False,
        progress: Callable[[int], None] | None = None,
    ) -> tuple[RunResult, CanHapticError | None]:
        """Run until completion or failure, and close; return the account and the error that ended the run.

        The arguments are as for `canhaptic.cycle.run`.
        """
        clock, error = WallClock(), None
        begin = clock.now()
        try:
            run(self.cycle, cycles, stop_requested, progress)
        except CanHapticError as raised:
            error = raised
        status = f"failed: {error}" if error else "stopped" if stop_requested() else "completed"
        result = experiment_account(self, status, (clock.now() - begin) * 1e-9)
        try:
            self.close(status)
        except CanHapticError as raised:
            error = error or raised
            if self.energy_log is not None and self.energy_log.failure:
                from canhaptic.logs.hdf5 import note_length

                result["energy_log"] = note_length(self.energy_log.path, result["cycles"])
        return result, error

    def close(self, status: str = "completed") -> None:
        """Close logs and buses; a second call does nothing.

        Args:
            status: Status of the run, for the logs.

        Raises:
            LogStoppedError: A log is not complete.
        """
        with self._stack:
            try:
                if self.energy_log is not None:
                    self.energy_log.close(status)
            finally:
                if self.bus_log is not None:
                    self.bus_log.close(status)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close("completed" if error is None else f"failed: {cause_of(error)}")


def build(
    scene: Scene, pace: _Pace | None = None, energy_log: str | Path | None = None, bus_log: str | Path | None = None,
    *, no_torque: bool = False, to_far: "ToFar | None" = None,
) -> Experiment:  # fmt: skip
    """Return the scene built and ready to run; nothing is sent yet.

    Args:
        scene: Scene from `load_scene`.
        pace: "real" or "free"; by default free where the drives are simulated in this process, else real.
        energy_log: Energy log (HDF5) to write, replacing any earlier one; by default none. Only the command `run` uses
            the paths under `log` of the scene.
        bus_log: Bus log to write, of CAN as candump text, of an EtherCAT line as pcap; by default none.
        no_torque: Whether the torque sent is always 0: a dry run.
        to_far: What carries packets to the far side; by default the socket that the scene declares.

    Raises:
        InputError: Free pace without simulated drives, a bus that python-can cannot use, own code left unread, or a dry
            run of an admittance display.
        LinkError: The bus cannot be opened.
        LogWriteError: A log cannot be written.
    """
    if scene.unread:
        text = f"{scene.source}: {', '.join(scene.unread)} was left unread"
        raise InputError(f"{text}; load the scene with allow_code=True")
    if pace == "free" and not scene.simulated:
        text = f"{scene.source}: pace 'free' needs drives simulated in this process (bus.interface"
        raise InputError(f"{text}: virtual and a `simulation`); real drives run at pace 'real'")
    chosen: _Pace = pace or ("free" if scene.simulated else "real")
    if bus_log is not None and len(scene.buses) > 1 and any(kind_of(bus.parameters) != "can" for bus in scene.buses):
        raise InputError(f"{scene.source}: a bus log has CAN buses, or one EtherCAT line; leave --bus-log out")
    for axis in scene.axes if no_torque else ():
        require_torque_axis(axis)  # before a log is made
    logs = (None if path is None else Path(path) for path in (energy_log, bus_log))
    if scene.own_code:
        from canhaptic.scene.own_code import apart, require_law

        require_law(scene)
        scene = apart(scene)
    if scene.accuracy_tolerance is not None:
        from canhaptic.scene.far_side import with_accuracy

        scene = with_accuracy(scene)
    if scene.far is not None and to_far is None:
        from canhaptic.far.parameters import LOOPBACK

        if scene.far.peer == LOOPBACK:
            raise InputError(
                f"{scene.source}: far.peer: loopback needs the other rig: canhaptic run A.yaml --with B.yaml"
            )
        if chosen == "free":
            key, other = ("peer", "") if scene.far.world is None else ("world", ', or use canhaptic.World("virtual")')
            text = f"{scene.source}: far.{key}: {scene.far.other} is reached in real time only; add --pace real"
            raise InputError(text + other)
    return Experiment(scene, chosen, *logs, no_torque=no_torque, to_far=to_far)


def _coupled() -> type[Cycle]:
    from canhaptic.scene.coupled import CoupledCycle

    return CoupledCycle


def _require_push(scene: Scene, ports: Sequence[Port]) -> None:
    """Refuse to run an axis that needs `hand_push` and does not declare it, as logs of earlier releases may.

    Raises:
        InputError: The environment has several exits, and no `hand_push` is declared.
    """
    for port in ports:
        axis = scene.axes[port.axes[0]]
        if getattr(port.controller, "lacks_push", False) and axis.environment.name != "free_space":
            raise InputError(
                f"{scene.source}: passivity of {axis.parameters.name}: hand_push: not declared, expected the largest "
                f"force with which the hand pushes against the effort: environment {axis.environment.name!r} has more "
                "than one exit, and where they meet the hand pushes out of one contact into the next; declare it "
                f"(such as {2.0 * axis.parameters.torque_limit:.2g} {effort_unit(axis.parameters.unit)}, twice "
                "torque_limit), or hand_force: null with another certificate"
            )


def require_buildable(scene: Scene) -> None:
    """Build everything that a run of a simulated scene needs, and close it; nothing is sent and no log is opened.

    Raises:
        InputError: A run would refuse the scene, for example a simulated drive without a rated torque.
    """
    if scene.simulated and not scene.unread:
        Experiment(scene, "free", None, None).close()


def _build_clock(
    pace: _Pace, spin_margin: float, groups: "Sequence[DrivesOnBus | Cable]", faulty: "Mapping[int, FaultyBus]"
) -> Clock:
    """Return the clock, which also runs the simulated drives and the faults of their buses."""
    peers: list[SimulatedPeer] = [faulty[n].around(group) if n in faulty else group for n, group in enumerate(groups)]
    clock: Clock = VirtualClock(peers) if pace == "free" else WallClock(peers, spin_margin)
    for owner in (*faulty.values(), *groups):
        if (use := getattr(owner, "use", None)) is not None:
            use(clock)
    return clock


def _build_rig(scene: Scene, links: "Sequence[Link | EthercatBusCycle]", *, dry_run: bool) -> Rig:
    by_name = {bus.name: (link, bus.parameters) for bus, link in zip(scene.buses, links, strict=True)}
    drives: list[TorqueAxis] = [build_servo_drive(axis, *by_name[axis.bus], dry_run=dry_run) for axis in scene.axes]
    for drive, axis in zip(drives, scene.axes, strict=True):
        drive.hold = scene.hold_of(axis)
    buses: list[BusCycle] = []
    for name, (link, bus) in by_name.items():
        on_bus = [drive for drive, axis in zip(drives, scene.axes, strict=True) if axis.bus == name]
        buses += part(kind_of(bus), "cycles")(link, on_bus, bus)
    return Rig(buses, drives, scene.bus, [port.places for port in scene.ports])


def _truths(far_side: "Drives | None") -> Callable[[], Sequence[Truth]] | None:
    if far_side is None:
        return None
    readers = [drive.truth for drive in far_side.drives]
    return lambda: [read() for read in readers]


def experiment_account(experiment: Experiment, status: str, elapsed: float) -> RunResult:
    """Return the account as `canhaptic run --json` prints it; energies in [J], times in [s].

    Args:
        experiment: The experiment after its run, completed or not.
        status: "completed", "stopped" or the reason of a stop.
        elapsed: Duration of the run [s].
    """
    scene, cycle = experiment.scene, experiment.cycle
    account = run_result(cycle, status=status, config_hash=experiment.config_hash, method=_method(experiment))
    names = [axis.parameters.name for axis in scene.axes if axis.simulation is not None]  # with a plant of its own
    _add_of_axes(experiment, account["ports"])
    if experiment.far is not None:
        account["far"] = experiment.far.summary()._asdict()
        account["ports"][scene.axes[experiment.far.axis].parameters.name]["with_far"] = True
    account["plants"] = {
        name: {"events": plant.events, "products": plant.products}
        for name, plant in zip(names, experiment.plants, strict=False)
    }
    # In lock-step virtual time does not pass within a cycle: its durations say nothing.
    durations = account["timing"] if experiment.pace == "real" else {}
    account["timing"] = {
        "pace": experiment.pace,
        "cycles_per_second": cycle.cycles / elapsed if elapsed else 0.0,
        **durations,
        **{f"realtime_{name}": answer for name, answer in experiment.rig.realtime.report.items()},
    }
    totals: dict[str, Mapping[str, object]] = {name: bus.totals() for name, bus in experiment.faulty_buses.items()}
    totals |= {name: cable.totals() for name, cable in experiment.cables.items()}
    if totals:
        account["bus_effects"] = totals.get("", totals)  # the only bus may have no name
    if experiment.code is not None:
        late, longest = experiment.code.late, experiment.code.longest
        account["own_code"] = {"runs_in": "process", "late_holds": late, "longest": longest}
    elif scene.own_code:
        account["own_code"] = {"runs_in": "cycle"}
    account["logs"] = {"dropped": sum(log.dropped for log in (experiment.energy_log, experiment.bus_log) if log)}
    return account


def _add_of_axes(experiment: Experiment, ports: Mapping[str, PortResult]) -> None:
    """Add to each port its algorithm, to each axis its environment, and why a wall was not felt."""
    for of in experiment.scene.ports:
        ports[of.name]["algorithm"] = of.passivity.name
    is_in_degrees = uses_degrees("\n".join((experiment.scene.text, *experiment.scene.overrides)))
    for axis in experiment.scene.axes:
        port = ports[axis.parameters.name]
        if not axis.group:
            port["environment"] = axis.environment.name
            if axis.parameters.unit == "rad" and is_in_degrees:
                port["in_degrees"] = True
            if isinstance(wall := getattr(axis.environment.parameters, "position", None), float):
                port["wall"] = wall
        if port.get("verdict") == "nothing rendered":
            from canhaptic.scene.first_contact import why_silent

            if why := why_silent(axis, experiment.rig.skipped_syncs, experiment.cycle.cycles):
                port["advice"] = why


def _method(experiment: Experiment) -> str:
    """Return method, cost and error of the simulated plants in one line; empty with real drives, or without memory."""
    scene, plants, cycles = experiment.scene, experiment.plants, experiment.cycle.cycles
    if not scene.simulated:
        return ""
    try:
        from canhaptic.scene.method import method_line, plant_prices
    except (ImportError, OSError, MemoryError):  # the account all the same
        return ""
    return method_line(scene, plants, cycles, plant_prices(scene, plants, cycles))
