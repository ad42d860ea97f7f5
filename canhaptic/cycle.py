"""The signal path of one cycle, once per SYNC. Read this file first.

    SYNC -> position TPDO -> displacement -> energy balance -> torque -> RPDO -> drive -> motor + user
            `drive/`         `control/`                       `drive/`        `sim/` (or real hardware)

One thread runs it. On any error zero torque is sent first and the exception is raised second.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from math import inf
from operator import attrgetter
from typing import TYPE_CHECKING, Final

from canhaptic.control.axis_meter import AxisMeter
from canhaptic.control.balance import AT_REST, Certificate, EnergyBalance
from canhaptic.control.ledger import EnergyLossMeter
from canhaptic.control.ports import Port, Ports
from canhaptic.control.verdict import (
    BY_CONSTRUCTION,
    COUNTS_DISAGREE,
    NOT_CHECKED,
    UNBOOKED,
    UNCONFIRMED,
    UNDECIDED,
)
from canhaptic.drive.clock import DurationHistogram, VirtualClock
from canhaptic.drive.rig import Rig
from canhaptic.drive.safety.link_policy import LossBudget, StopReason, reason_of
from canhaptic.errors import (
    CanHapticError,
    CycleFailedError,
    EmergencyError,
    InputError,
    LogStoppedError,
    RigError,
    StartStoppedError,
    cause_of,
)
from canhaptic.meters import RunMeters
from canhaptic.signals import CycleTiming, Sample, Truth

if TYPE_CHECKING:
    from canhaptic.control.booked_stop import BookedStop
    from canhaptic.control.energy_audit import EnergyAudit
    from canhaptic.logs.writer_process import EnergyLogWriter

_torque = attrgetter("torque")
_NO_CERTIFICATE: Final = Certificate.NONE.value
_LOOK: Final = 0.05
"""Time between two looks at the uncertainties [s]."""
_FEWEST_UNCHANGED: Final = 20  # SYNCs; or those of a second
_UNEVEN: Final = (
    "a hold was {:.3g} s longer or shorter than the sample time, more than sync_jitter declares: its certificate is "
    "void; measure again (canhaptic commission)"
)
_STOPPING: Final = "the stop begins: its holds are a part of the account"
_UNBOOKED: Final = {
    True: "the run ended while a torque acted: what it did from then on is in no account",
    False: "the run ended while a torque acted, and the drive has not confirmed that it is disabled",
}
_UNCHANGED: Final = (
    "position, torque and statusword were identical for 1 s, with a torque: a handle held still, a stuck "
    "encoder, or TPDOs that the drive does not update"
)


class Cycle:
    """A rig, its ports and their accounts; one `step` per SYNC.

    Args:
        rig: The rig; `run` starts it.
        ports: Its ports; each axis of the rig is in one. `control.ports.axis_ports` makes them of controllers of axes.
        log: Log of every cycle, which must not block the control thread; None without one.
        truths: True motion and energy of the simulated axes, read right after their SYNC; None with real drives.
        axis_meters: Accuracy of the sensors and the device of each axis; None where they are ideal.
        loss_meters: Meters of the ports with a limit on the energy that they may generate.
        jitters: For each axis, largest deviation of a hold from the sample time, as a fraction; None: not checked.

    Raises:
        InputError: There is not one port for each axis.

    Attributes:
        ledgers: Account of each row, see `control.ports`; for an axis of a port of several, only the energy exchanged
            through that axis.
        meters: Figures of the rows in addition to their ledgers.
        judge: Comparison with the simulated plant; None with real drives.
        timing: Durations of each part of the cycle; empty in a run that is not paced in real time.
        cycles: Cycles completed, those of the stop included.
        all_ports: The ports with their rows.
        holds_of_stop: Cycles of the stop among them.
        uneven: Number of holds that were longer or shorter than the declared `sync_jitter` allows.
        unbooked: After a run, each axis on which a torque acted when it ended, by its number, and whether its drive
            confirmed that it is disabled. What it gave from then on is in no account.
        turn: Function that requests torques from user code in a separate process, by the samples; None without one.
    """

    def __init__(
        self,
        rig: Rig,
        ports: Iterable[Port],
        log: "EnergyLogWriter | None" = None,
        truths: Callable[[], Sequence[Truth]] | None = None,
        axis_meters: Sequence[AxisMeter] | None = None,
        loss_meters: Sequence[EnergyLossMeter] = (),
        jitters: Sequence[float] | None = None,
    ) -> None:
        self.rig = rig
        self.all_ports = Ports(ports, dry_run=rig.dry_run)
        self.ports, self._steps = self.all_ports.ports, self.all_ports.steps
        axes = self.all_ports.axes
        if axes != len(rig.drives):
            text = f"cycle: got controllers for {axes} axes and a rig of {len(rig.drives)}"
            raise InputError(f"{text}; give each axis one")
        self.meters = RunMeters(axis_meters or [AxisMeter() for _ in range(axes)], rig.drives, self.all_ports)
        self.ledgers = [figures.ledger for figures in self.meters.ports]
        self._at_rest, self._several = [AT_REST] * self.all_ports.rows, self.all_ports.several
        self.timing = {name: DurationHistogram() for name in CycleTiming._fields}
        self.judge = None if truths is None else _judge(self.all_ports)
        self.cycles = self.uneven = self.holds_of_stop = 0
        self.unbooked: dict[int, bool] = {}
        self.turn: Callable[[Sequence[Sample]], None] | None = None
        self._stop: BookedStop | None = None
        self._is_timed = not isinstance(rig.clock, VirtualClock)  # virtual time does not advance within a cycle
        self._log: EnergyLogWriter | _FailedLog | None = log
        self._truths = truths
        self._loss_meters, self._metered = tuple(loss_meters), {port.name: port for port in self.ports}
        self._uncertainties = _uncertainties(self._loss_meters, rig.bus.sample_time)
        self._look_at = self._look_every = max(1, round(_LOOK / rig.bus.sample_time))
        self._period = rig.bus.sample_time_ns
        self._jitters = [round(part * self._period) + 1 for part in jitters or ()]
        self._least_jitter = min(self._jitters, default=inf)
        self._frozen_after = max(_FEWEST_UNCHANGED, round(1.0 / rig.bus.sample_time))

    def __repr__(self) -> str:
        return f"<Cycle: {self.cycles} cycles run, {self.rig!r}>"

    def step(self) -> None:
        """Run one cycle.

        Raises:
            RigError: Drive, link or controller failed, or a port generated more energy than declared.
        """
        samples = self.rig.sync()  # SYNC out, position TPDOs in       [rad or m]
        if self.turn is not None:
            self.turn(samples)
        self.answer(samples)

    def answer(self, samples: Sequence[Sample]) -> list[EnergyBalance]:
        """Complete the cycle from the samples of a SYNC; return the balance of each row.

        Raises:
            RigError: As `step`.
        """
        rig, read = self.rig, self._truths
        truths = read() if read is not None else None
        if rig.periods > 1:
            self.all_ports.note_skipped_syncs(rig.periods)
        balances = self._at_rest.copy()
        for port in self._steps:  # displacement -> energy balance [J]
            port.step(samples, balances)
        torques = list(map(_torque, balances[: self.all_ports.axes]))
        if rig.uneven > self._least_jitter:
            self._withdraw(balances)
        for meter in self._loss_meters:
            if meter.take(samples, rig.deadline_index) and (lost := self._lost(meter, balances, samples)):
                error = rig.end(StopReason.ENERGY_LOST, lost)  # zero torque first, the account second
                self._account(samples, balances, truths)
                raise error
        if self.cycles >= self._look_at and (unsure := self._unsure()):
            error = rig.end(*unsure)
            self._account(samples, balances, truths)
            raise error
        rig.write_torques(torques)  # RPDOs out, held until the next SYNC [N*m or N]
        self._account(samples, balances, truths)
        return balances

    def planned_stop(self) -> "BookedStop | None":
        """Return the holds of an operator's stop now; None where no torque acts and no brake is to be set."""
        rig = self.rig
        if rig.is_still and not rig.has_brake:
            return None
        from canhaptic.control.booked_stop import BookedStop

        axes = [drive.axis for drive in rig.drives]
        return BookedStop(self.ports, axes, rig.bus, rig.holds_to_act, dry_run=rig.dry_run)

    def wind_down(self, samples: Sequence[Sample] | None = None) -> None:
        """Run the holds of an operator's stop, sampled, booked, checked and logged as every other; disable follows.

        Args:
            samples: Samples of the last SYNC if it was not answered yet.

        Raises:
            RigError: As `step`; the torque is zero.
            LogStoppedError: The log failed; call it again for the holds that are left.
        """
        rig = self.rig
        if self._stop is None:
            stop = self.planned_stop() if rig.is_running else None
            if stop is None:
                return
            self._stop, self._steps = stop, stop.steps
            self._event(rig.sync_index + (samples is None), "stopping", "", _STOPPING)
        while rig.is_running and self._stop.left:
            self.holds_of_stop += 1
            self.answer(rig.sync() if samples is None else samples)
            samples = None
            if self._stop.has_come_down:
                rig.begin_stop()

    def _withdraw(self, balances: list[EnergyBalance]) -> None:
        """Withdraw the certificates of a hold that was longer or shorter than they permit."""
        broken = {axis for axis, jitter in enumerate(self._jitters) if self.rig.uneven > jitter}
        for row, axes in self.all_ports.axes_of_rows:
            if not broken.isdisjoint(axes):
                balances[row] = balances[row]._replace(certificate=_NO_CERTIFICATE)
        if not self.uneven:
            self._event(self.rig.sync_index, "timing", "", _UNEVEN.format(self.rig.uneven * 1e-9))
        self.uneven += 1

    def _lost(self, meter: EnergyLossMeter, balances: Sequence[EnergyBalance], samples: Sequence[Sample]) -> str:
        """Return the text on a port that generated too much energy, and how much; "" unless that is certain."""
        uncertainty = sum(self._likely_uncertainty(axis) + self._lost_to_friction(axis, samples) for axis in meter.axes)
        row, supplied = self._metered[meter.name].row, meter.supplied
        if supplied is None:
            supplied = self.ledgers[row].supplied + balances[row].supplied
        if meter.energy + supplied + uncertainty >= meter.floor:
            return ""
        limit = f"limit {meter.limit:.3g} J beyond the {meter.allowance:.3g} J declared"
        return f"{meter.name}: sum of interaction {meter.energy + supplied:.3g} J, {limit}"

    def _unsure(self) -> tuple[StopReason, str] | None:
        """Return why the uncertainty of a port grows too fast, and how large it is; None without such a port."""
        self._look_at = self.cycles + self._look_every
        for meter, budget in self._uncertainties:
            known = float(getattr(self._metered[meter.name].controller, "energy_resolution", 0.0))
            known += sum(self.rig.drives[axis].contested for axis in meter.axes)
            grown, meter.uncertainty = known - meter.uncertainty, known
            if (not meter.is_of_link or self._has_lost(meter)) and budget.lose(self.rig.deadline_index, grown):
                text = f"{budget.level:.3g} J beyond energy_uncertainty_limit ({meter.uncertainty_limit:.3g} J/s)"
                what = f"uncertainty {known:.3g} J, {text}"
                for drive in (self.rig.drives[axis] for axis in meter.axes):
                    if drive.suspicion:
                        found = self.rig.details(drive, drive.suspicion)
                        return drive.suspicion, f"{drive.axis.name}: {found}; {what}"
                return StopReason.ENERGY_UNCERTAIN, f"{meter.name}: {what}"
        return None

    def _has_lost(self, meter: EnergyLossMeter) -> bool:
        """Whether a sample or a command of a port was lost since the look before, or shows in its account only now."""
        return any(self.rig.drives[axis].policy.lost_since <= self._look_every + 2 for axis in meter.axes)

    def _lost_to_friction(self, axis: int, samples: Sequence[Sample]) -> float:
        """Return the energy that the declared dry friction of a device has dissipated at least [J]."""
        known = self.meters.axes[axis]
        friction, blur = known.accuracy.device_friction, 2.0 * known.accuracy.position
        if not friction:
            return 0.0
        return known.dissipated + friction * max(0.0, abs(samples[axis].position - known.position) - blur)

    def _likely_uncertainty(self, axis: int) -> float:
        """Return the largest likely error of an axis's energy [J], not counting commands that were lost undetected.

        If no torque is read back, such commands would make every loss of energy uncertain, and no rig would stop.
        """
        drive = self.rig.drives[axis]
        unseen = drive.read_back_bound if drive.read_back == "none" else 0.0
        return self.meters.ports[axis].measured().energy_resolution - unseen

    def fail_log(self, reason: str) -> None:
        """End the run after the present cycle because a log can no longer be written; callable from any thread."""
        self._log = _FailedLog(reason)

    def drop_log(self) -> None:
        """Write nothing more to a log that failed."""
        self._log = None

    def _event(self, index: int, kind: str, name: str, text: str) -> None:
        if self._log is not None:
            self._log.event(index, kind, name, text)

    def note_fault(self, error: Exception) -> None:
        """Log the cause that ended the run, with the SYNC that found it and the axis that failed."""
        kind = "emcy" if isinstance(error, EmergencyError) else "fault"
        self._event(self.rig.sync_index, kind, getattr(error, "axis", ""), cause_of(error))

    def note_holds(self) -> None:
        """Log for each drive whether a test has confirmed in which hold its torques act, and remarks of the start."""
        for drive in self.rig.drives:
            if drive.hold:
                self._event(0, "hold", drive.axis.name, drive.hold)
            for text in drive.remarks:
                self._event(0, "setting", drive.axis.name, text)

    def note_found_holds(self) -> None:
        """Log what the run itself has found of the hold of an axis, which its verdict needs."""
        for axis, found in self.found_holds().items():
            self._event(self.rig.sync_index, "hold", self.rig.drives[axis].axis.name, found)

    def found_holds(self) -> dict[int, str]:
        """Return what the run itself has found of the hold of each axis.

        For a dithered axis it is what is known: by commissioning, else by the test of the run.
        """
        drives = self.rig.drives
        known = {axis: COUNTS_DISAGREE for axis, drive in enumerate(drives) if drive.disagreement}
        for port in self.ports:
            found = "" if port.row in known else getattr(port.controller, "hold_found", "")
            if found and not self.rig.dry_run:
                before = drives[port.row].hold
                is_known = found == UNDECIDED and before not in (NOT_CHECKED, BY_CONSTRUCTION)
                known[port.row] = before if is_known else found
        return known

    def note_unbooked(self) -> None:
        """Note on which axes a torque acted when the run ended, and log it."""
        rig = self.rig
        self.unbooked = {axis: axis not in rig.unconfirmed for axis in rig.acting}
        for axis, is_confirmed in self.unbooked.items():
            kind = UNBOOKED if is_confirmed else UNCONFIRMED
            self._event(rig.sync_index, kind, rig.drives[axis].axis.name, _UNBOOKED[is_confirmed])

    def note_link(self) -> None:
        """Log for each drive the share of SYNCs that it answered, unless it answered all."""
        for drive in self.rig.drives:
            if (share := drive.policy.success_rate()) < 1.0:
                text = f"{100.0 * share:.6g} % of SYNCs answered"
                self._event(self.rig.sync_index, "link", drive.axis.name, text)

    def note_unrestored(self) -> None:
        """Log objects of a drive that the start changed and the stop did not restore."""
        for drive in self.rig.drives:
            for text in drive.unrestored:
                self._event(self.rig.sync_index, "unrestored", drive.axis.name, text)

    def _account(
        self, samples: Sequence[Sample], balances: Sequence[EnergyBalance], truths: Sequence[Truth] | None
    ) -> None:
        """Book the energies and log the cycle, after the torque has been sent."""
        rig, log = self.rig, self._log
        index, deadline, timing = rig.sync_index, rig.deadline_index, rig.timing
        for port in self._several:
            if port.news:
                self._event(index, "limit", port.name, port.news)
            samples = [*samples, port.sample(samples)]
        late = timing[0]  # of the SYNC
        measured = self.meters.take(samples, balances, index, deadline, late / self._period if late else 0.0)
        if self.judge is not None and truths is not None:
            truths = self.judge.compare(self.ledgers, truths, balances)
        if self._is_timed:
            for histogram, duration in zip(self.timing.values(), timing, strict=True):
                histogram.add(duration)
        if log is not None:
            log.append(index, samples, balances, timing, truths, deadline, measured)
            for drive in rig.drives:
                if drive.unchanged == self._frozen_after:
                    log.event(index, "unchanged", drive.axis.name, _UNCHANGED)
        self.cycles += 1


def _judge(ports: Ports) -> "EnergyAudit":
    """Return the comparison of the accounts with the simulated plant, imported for simulations only."""
    from canhaptic.control.energy_audit import EnergyAudit

    return EnergyAudit(ports)


def _uncertainties(meters: Sequence[EnergyLossMeter], sample_time: float) -> list[tuple[EnergyLossMeter, LossBudget]]:
    """Return the meters of limited uncertainty, each with its budget [J]: what 1 s of the limit makes."""
    limits = ((meter, meter.uncertainty_limit) for meter in meters if meter.uncertainty_limit < inf)
    return [(meter, LossBudget(limit * sample_time, limit)) for meter, limit in limits]


class _FailedLog:
    """Replacement of a log that failed: it raises at the next cycle, so that the loop itself needs no check."""

    def __init__(self, reason: str) -> None:
        self._reason = reason

    def append(self, *_cycle: object) -> None:
        """End the run.

        Raises:
            LogStoppedError: Always.
        """
        raise LogStoppedError(f"{self._reason}; the run was stopped (log.on_failure: continue keeps it running)")

    def event(self, *_event: object) -> None:
        """No-op."""


def run(
    cycle: Cycle,
    cycles: int | None = None,
    stop_requested: Callable[[], bool] = lambda: False,
    progress: Callable[[int], None] | None = None,
) -> None:
    """Start the rig, run the cycle, and stop the rig on every exit.

    Args:
        cycle: The rig and its controllers.
        cycles: Number of cycles to run; None: until stopped.
        stop_requested: Called before each cycle; True ends the run by the operator's stop.
        progress: Called with the number of completed cycles, once per cycle; must be cheap.

    A signal that a `StopSignal` notes during the start ends it: no cycle is run.

    Raises:
        RigError: Drive, link or controller failed; every drive has zero torque and is disabled, and the error carries
            the last records.
        LogStoppedError: A log failed and the run may not continue without it; the rig was stopped as by the operator.
    """
    if cycle.turn is None and cycle.all_ports.programs:
        raise InputError("guard: the scene is for a program that requests its torques; run it with canhaptic.open_rig")
    with suppress(StartStoppedError), running(cycle):
        while (cycles is None or cycle.cycles < cycles) and not stop_requested():
            cycle.step()
            if progress is not None:
                progress(cycle.cycles)


def _start(rig: Rig) -> None:
    from canhaptic.control import booked_stop  # noqa: F401 - a process without descriptors stops in order too

    try:
        rig.start()
    except CanHapticError:
        raise
    except Exception as error:  # such as no memory: a run that has an account all the same
        rig.stop(ramp=False)  # nothing, where the start itself has disabled the drives
        raise CycleFailedError(f"the start failed: {cause_of(error)}", rig.records) from error


@contextmanager
def running(cycle: Cycle) -> Iterator[None]:
    """Start the rig, and stop it on every exit from the block: zero torque first. See `run`."""
    rig = cycle.rig
    try:
        _start(rig)
        try:
            cycle.note_holds()
            yield
            cycle.wind_down()
        except LogStoppedError:
            cycle.drop_log()
            cycle.wind_down()
            rig.stop(ramp=False, reason=StopReason.OPERATOR)
            raise
        except Exception as error:
            rig.stop(ramp=False, reason=reason_of(error))
            cycle.note_fault(error)
            if isinstance(error, RigError):
                error.records = error.records or tuple(rig.records)
                raise
            text = f"the cycle failed at SYNC {rig.sync_index}, torque is zero: {cause_of(error)}"
            raise CycleFailedError(text, rig.records) from error
        except BaseException:
            rig.stop(ramp=False)
            raise
        try:
            rig.stop(ramp=False, reason=StopReason.OPERATOR)
        except RigError as error:
            cycle.note_fault(error)
            raise
    finally:
        cycle.note_unbooked()
        cycle.note_found_holds()
        cycle.note_link()
        cycle.note_unrestored()
