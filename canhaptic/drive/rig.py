"""A rig of several drives with one SYNC: start, cyclic exchange, stop, all in the thread that calls `sync`.

    rig.start()
    samples = rig.sync()               # SYNC out, position TPDOs in
    rig.write_torques(torques)         # RPDOs out
    rig.stop()

On every error zero torque is sent first, then the drives are disabled, then the exception is raised.
"""

import threading
from collections import deque
from collections.abc import Sequence
from operator import call
from typing import TYPE_CHECKING, Any, Final, NamedTuple, Self

from canhaptic.drive.bus_cycle import BackgroundLine, BusCycle
from canhaptic.drive.clock import VirtualClock
from canhaptic.drive.cycle_parameters import CycleParameters
from canhaptic.drive.exchange import Exchange
from canhaptic.drive.profile.restore import restore
from canhaptic.drive.profile.torque_axis import TorqueAxis
from canhaptic.drive.safety import stop
from canhaptic.drive.safety.link_policy import STOP_TABLE, LossBudget, StopReason
from canhaptic.drive.safety.stop import Trust
from canhaptic.drive.start import start
from canhaptic.errors import ControlError, InputError, LinkError, RigError, cause_of
from canhaptic.host.realtime import Realtime, RealtimeParameters
from canhaptic.signals import CycleTiming, Sample

if TYPE_CHECKING:
    from canhaptic.drive.can.background_sdo import BackgroundSdo
    from canhaptic.drive.profile.fitness import Finding

_tuple: Final = tuple.__new__  # makes a record at half the cost of calling its class
_OF_A_WATCHDOG: Final = (
    StopReason.EMERGENCY,
    StopReason.DRIVE_FAULT,
    StopReason.STATE_LEFT,
    StopReason.NMT_STATE_LEFT,
    StopReason.HEARTBEAT_LOST,
)


class _CycleRecord(NamedTuple):
    """One cycle as kept for a fault report."""

    samples: list[Sample]
    torques_per_mille: list[int]  # commanded in answer, per axis


class Rig:
    """The drives of one or several buses, run by one SYNC.

    Args:
        buses: The buses in the cycle; the first sets the clock.
        drives: One per axis, in the order of samples and torques.
        bus: Parameters of the cycle: rate, link policy and the rest; the same for all buses.
        ports: Indices of the axes of each port. If one of them does not answer a SYNC, none of them has a sample,
            and the link policy counts a missed SYNC for each.

    Attributes:
        is_running: Whether the drives are enabled and the cycle may continue.
        sync_index: Index of the last SYNC; 0 is the first that found every drive enabled, -1 before it.
        deadline_index: Sample times since SYNC 0: ahead of `sync_index` where SYNCs were skipped.
        periods: Sample times between the last two SYNCs; more than 1 where some were skipped.
        uneven: Deviation of the hold that ended from its sample times [ns].
        stop_reason: Reason why the rig stopped; NONE while it runs.
        records: The last cycles, newest last.
        unconfirmed: Axes whose drive has not confirmed at the stop that it is disabled, by their number.
        realtime: Real-time settings that the operating system granted to the thread that called `start`.
        timing: Durations within the last cycle with torques written [ns].
    """

    def __init__(
        self,
        buses: Sequence[BusCycle],
        drives: Sequence[TorqueAxis],
        bus: CycleParameters,
        ports: Sequence[Sequence[int]] = (),
    ) -> None:
        self.buses = tuple(buses)
        self._seen = tuple(bus.seen for bus in self.buses)
        self.drives: tuple[Any, ...] = tuple(drives)  # each of the class of its fieldbus
        self._commands = [drive.command_per_mille for drive in self.drives]
        several = (tuple(port) for port in ports if len(port) > 1)
        together = {axis: tuple(self.drives[other] for other in port) for port in several for axis in port}
        self._needed = [(drive, together.get(axis, ())) for axis, drive in enumerate(self.drives)] if together else []
        self.bus, self.clock = bus, self.buses[0].clock
        self._period = bus.sample_time_ns
        self._exchange = Exchange(self.buses, self.drives, bus)
        self._pace = self._exchange.pace
        self._skips = LossBudget(bus.loss_limit, max(bus.stop_cycles, 1.0 / bus.sample_time))  # those of a second
        self._sdo_lines: tuple[BackgroundLine, ...] = ()  # one for each bus, from the first `sdo` on
        self._making_lines = threading.Lock()  # between those who ask first; the cycle never waits for it
        # At free pace the thread never sleeps: with real-time priority it would starve all others of its processor.
        self.realtime = Realtime(RealtimeParameters() if isinstance(self.clock, VirtualClock) else bus.realtime)
        self._reset()

    def __repr__(self) -> str:
        state = "running" if self.is_running else "not running"
        return f"<Rig of {', '.join(drive.axis.name for drive in self.drives)}: {state}, SYNC {self.sync_index}>"

    def _reset(self) -> None:
        self.sync_index = -1
        self.deadline_index = self._first_deadline = 0
        self.stop_reason = StopReason.NONE
        self.records: deque[_CycleRecord] = deque(maxlen=1000)
        self.is_running = False
        self.unconfirmed: list[int] = []
        self.periods, self.uneven = 1, 0
        self._skips.reset()
        self._first_samples: list[Sample] | None = None
        self._samples: list[Sample] = []
        self.timing = CycleTiming(0, 0, 0, 0)

    def start(self) -> None:
        """Bring every drive from any state to OPERATION ENABLED with zero torque, each step confirmed.

        Raises:
            StartError: A step was not confirmed; all drives are left disabled. Where one of them does not answer, or is
                not the one of the configuration, nothing was sent but reads, and all are left as they were.
            StartStoppedError: A signal asked for the end; all drives are left disabled.
            SecondMasterError: Another master sends on a bus; all drives are left disabled.
            RigError: It failed, and a drive did not confirm that it is disabled.
        """
        self._reset()
        for bus in self.buses:
            bus.reserve()
        self.realtime.begin()
        self._mark_start(is_starting=True)
        try:
            start(self._exchange, [drive.bring_up() for drive in self.drives])
            self._begin_cycle()
        except BaseException as error:
            self.stop_reason, self.is_running = StopReason.EXCEPTION, False
            unconfirmed = self._disable(Trust.FULL)  # it was never given a torque
            if isinstance(error, RigError):
                self._require_no_other_master()  # another master explains a failed step
            if unconfirmed and isinstance(error, Exception):
                text = f"{cause_of(error)}; NOT confirmed to be disabled: {'; '.join(unconfirmed)}"
                raise RigError(text, self.records) from error
            raise
        self._require_no_other_master()

    def _begin_cycle(self) -> None:
        """Take over the drives, which are enabled from here on."""
        self._mark_start(is_starting=False)
        self._pace.skipped = 0
        self._first_deadline = self._pace.deadline + self._pace.shifted
        self.sync_index = 0
        self.is_running = True
        self._first_samples = [drive.sample(0) for drive in self.drives]
        for drive in self.drives:
            drive.watch_statusword()
        for line in self._sdo_lines:
            line.open()

    def _mark_start(self, *, is_starting: bool) -> None:
        """Let a signal end every wait on a bus, or none."""
        for bus in self.buses:
            bus.mark_start(is_starting=is_starting)

    # --- the cycle ----------------------------------------------------------------------------------------------------

    def sync(self) -> list[Sample]:
        """Wait for the next deadline, send SYNC, take the TPDOs and return one sample per axis.

        The first call after `start` returns the samples of SYNC 0, which `start` has sent.

        Raises:
            LinkError: More TPDOs were missed than the link policy allows, or the bus failed; the rig has stopped.
            DriveFaultError: A drive reported a fault or left its state; the rig has stopped.
        """
        if not self.is_running:
            raise self._not_running()
        exchange, pace = self._exchange, self._pace
        if self._first_samples is not None:
            self.periods, self.uneven = pace.periods, pace.uneven
            self._samples, self._first_samples = self._first_samples, None
            return self._samples
        try:
            exchange.sync()
        except LinkError as error:
            raise self._stopped(StopReason.SEND_FAILED, str(error)) from error
        self.sync_index = index = self.sync_index + 1
        self.deadline_index = pace.index_after(self._first_deadline)
        self._require_no_other_master()
        samples: list[Sample] = []
        self._samples = samples
        self.periods = periods = pace.periods
        self.uneven = pace.uneven
        for drive, others in self._needed:
            is_whole = all(other.is_complete for other in others)
            samples.append(drive.sample(index, periods, is_whole=is_whole))
        if not self._needed:
            for drive in self.drives:
                samples.append(drive.sample(index, periods))
        for drive in self.drives:
            reason = drive.fault(exchange.heard)
            if reason:
                raise self._ended_by(drive, reason)
        if periods > 1:  # last: the drive's own report of its watchdog is more specific
            self._count_skips(periods - 1)
        return samples

    def _ended_by(self, drive: TorqueAxis, reason: StopReason) -> RigError:
        """Stop because of a drive; return the exception.

        Where this computer stood still for longer than the drive's watchdog allows, that is the cause, and the drive's
        reaction is its result.
        """
        away = self._exchange.heard - self._pace.deadline + self.periods * self._period
        allowed = self.bus.master_silence_ns - self._exchange.beat_cycles * self._period
        if away <= allowed or reason not in _OF_A_WATCHDOG:
            return self._stopped(reason, self._describe(drive, reason), drive.axis.name)
        rule = STOP_TABLE[StopReason.SYNCS_SKIPPED]
        seen = f"{drive.axis.name} then: {reason.name}, {self.details(drive, reason)}"
        what = f"{rule.meaning} at SYNC {self.sync_index}: it stood still for {away * 1e-9:.3g} s; {seen}"
        return self._stopped(StopReason.SYNCS_SKIPPED, f"{what}; torque is zero; {rule.remedy}", drive.axis.name)

    def _count_skips(self, skipped: int) -> None:
        """Stop when too many SYNCs were skipped: meanwhile a drive holds its last torque."""
        if self._skips.lose(self.deadline_index, skipped):
            rule, limit = STOP_TABLE[StopReason.SYNCS_SKIPPED], 100.0 * self.bus.loss_limit
            what = f"{rule.meaning} at SYNC {self.sync_index}: {self.skipped_syncs} skipped in all"
            beyond = f"recently {self._skips.level:.0f} beyond bus.loss_limit ({limit:g} %)"
            raise self._stopped(StopReason.SYNCS_SKIPPED, f"{what}, {beyond}; torque is zero; {rule.remedy}")

    def _require_no_other_master(self) -> None:
        for seen in self._seen:
            if seen.intruder:
                rule = STOP_TABLE[StopReason.SECOND_MASTER]
                text = f"{seen.intruder} came from elsewhere: {rule.meaning}; torque is zero; {rule.remedy}"
                text += self.buses[self._seen.index(seen)].shared_hint()
                raise self._stopped(StopReason.SECOND_MASTER, text)

    def write_torques(self, torques: Sequence[float]) -> None:
        """Send one torque [N*m or N] per axis, after link policy and limiter, and the master's heartbeat when due.

        Raises:
            ControlError: A torque is not finite; zero was sent and the rig has stopped.
            InputError: There is not one torque for each axis; the rig has stopped.
            LinkError: A frame could not be sent; the rig has stopped.
        """
        if not self.is_running:
            raise self._not_running()
        drives, exchange = self.drives, self._exchange
        computed = exchange.now()
        try:
            if len(torques) != len(drives):
                text = f"write_torques: got {len(torques)} torques for {len(drives)} axes; give each axis one"
                raise InputError(text)
            commands = list(map(call, self._commands, torques))
            for drive, command in zip(drives, commands, strict=True):
                drive.write(command)
            exchange.beat()
        except ControlError as error:
            raise self._stopped(StopReason.CONTROLLER, str(error)) from error
        except LinkError as error:
            raise self._stopped(StopReason.SEND_FAILED, str(error)) from error
        except BaseException:
            self._stopped(StopReason.EXCEPTION, "")
            raise
        self.records.append(_tuple(_CycleRecord, (self._samples, commands)))
        woken, heard = exchange.woken, exchange.heard
        parts = (woken - self._pace.deadline, heard - woken, computed - heard, exchange.now() - computed)
        timing = self.timing  # at free pace time does not advance within a cycle
        self.timing = timing if parts == timing else _tuple(CycleTiming, parts)
        for line in self._sdo_lines:
            if line.busy:
                line.step()

    def sdo(self, axis: str | int) -> "BackgroundSdo":
        """Return SDO access to the drive of an axis, by name or number, during the running cycle and from any thread.

        The first call loads its dependencies; make it before `start` where a late SYNC matters.

        Raises:
            InputError: There is no such axis.
        """
        names = [drive.axis.name for drive in self.drives]
        place = names.index(axis) if axis in names else axis
        if not isinstance(place, int) or not 0 <= place < len(names):
            raise InputError(f"no axis {axis!r}; expected one of: {', '.join(names)}, or 0 to {len(names) - 1}")
        with self._making_lines:
            if not self._sdo_lines:  # one for each bus, made with the first request; open while the rig runs
                self._sdo_lines = tuple(bus.background() for bus in self.buses)
                for line in self._sdo_lines if self.is_running else ():
                    line.open()
                for line in () if self.is_running else self._sdo_lines:  # stopped in between
                    line.close()
        drive = self.drives[place]
        [line] = [line for bus, line in zip(self.buses, self._sdo_lines, strict=True) if drive in bus.drives]
        access: BackgroundSdo = line.access(drive)
        return access

    def _not_running(self) -> RigError:
        text = f"the rig is not running (last stop: {self.stop_reason.name}); call start()"
        return RigError(text, self.records)

    # --- stop ---------------------------------------------------------------------------------------------------------

    def stop(self, *, ramp: bool = True, reason: StopReason = StopReason.EXCEPTION) -> None:
        """End the run: torque to zero in one hold, drives disabled and pre-operational, confirmed.

        The holds of an operator's stop of a `Cycle` are booked before, see `Cycle.wind_down`.

        Args:
            ramp: True for an operator's stop without an account: a weight is held until its brake does. False after the
                holds of a `Cycle`, or when something is wrong.
            reason: Cause of the stop.

        Raises:
            RigError: A drive did not confirm that it is disabled, or a fault was met while a weight was held.
            HoldsContradictedError: The drives are disabled, and a drive's count of held torques contradicts the host's.
        """
        if not self.is_running:
            return
        try:
            if ramp:
                self._hold_weights()
        except Exception:
            if not self.is_running:  # the fault that was met has stopped it
                raise
            ramp = False  # zero torque and disable follow below all the same
        self.is_running = False
        self.stop_reason = StopReason.OPERATOR if ramp else reason
        unconfirmed = self._disable(Trust.FULL if self.stop_reason is StopReason.OPERATOR else Trust.SOME)
        if unconfirmed:
            text = f"not confirmed to be disabled: {'; '.join(unconfirmed)}; cut the power of the drive"
            raise RigError(text, self.records)
        contradicted = next((drive for drive in self.drives if drive.disagreement), None)
        if contradicted is not None and self.stop_reason is StopReason.OPERATOR:
            self.stop_reason, name = StopReason.HOLDS_CONTRADICTED, contradicted.axis.name
            rule = STOP_TABLE[self.stop_reason]
            text = f"{name}: {rule.meaning}: {contradicted.disagreement}; {rule.remedy} [{self.stop_reason.name}]"
            raise rule.error(text, self.records, name)

    def begin_stop(self) -> int:
        """Command every brake to set, once nothing but the weights acts; return the SYNCs for which they are held on.

        Raises:
            LinkError: It could not be sent; the rig has stopped.
        """
        try:
            return stop.set_brakes(self._exchange)
        except LinkError as error:
            raise self._stopped(StopReason.SEND_FAILED, str(error)) from error

    def _hold_weights(self) -> None:
        """Hold the weights until the brakes do, with every check of a run; nothing without a brake."""
        if self.has_brake:
            self._hold_weights_for(self.holds_to_act)
            self._hold_weights_for(self.begin_stop())

    def _hold_weights_for(self, holds: int) -> None:
        for _ in range(holds):
            self.sync()
            self.write_torques([drive.weight for drive in self.drives])

    @property
    def has_brake(self) -> bool:
        """Whether an axis has a brake."""
        return any(drive.axis.brake is not None for drive in self.drives)

    @property
    def holds_to_act(self) -> int:
        """Holds until every torque that was sent has acted, as late as is declared, and its last sample has come."""
        longest: int = max(drive.delay + drive.settling for drive in self.drives)
        return 2 + longest

    @property
    def is_still(self) -> bool:
        """Whether nothing but zero was sent for so long that no torque acts any more."""
        return not self.acting

    @property
    def acting(self) -> list[int]:
        """The axes to which another torque than zero was sent so recently that it may still act, by their number."""
        last = list(self.records)[-self.holds_to_act :]
        return [axis for axis in range(len(self.drives)) if any(record.torques_per_mille[axis] for record in last)]

    def end(self, reason: StopReason, what: str) -> RigError:
        """Send zero torque and stop at once for a reason found by the caller; return the exception.

        Args:
            reason: Reason of the stop.
            what: Place of the finding, with the values.
        """
        rule = STOP_TABLE[reason]
        text = f"{what}: {rule.meaning} at SYNC {self.sync_index}; torque is zero; {rule.remedy}"
        return self._stopped(reason, text)

    def _stopped(self, reason: StopReason, text: str, axis: str = "") -> RigError:
        """Stop at once and return the exception with the reason."""
        self.stop_reason = reason
        self.is_running = False
        error = STOP_TABLE[reason].error
        if reason in (StopReason.TPDO_LOST, StopReason.TPDO_CONTRADICTED):
            stop.hold_unseen(self._exchange)
        unconfirmed = self._disable(Trust.NONE if issubclass(error, LinkError) else Trust.SOME)
        if unconfirmed:
            text += f"; NOT confirmed to be disabled: {'; '.join(unconfirmed)}"
        text += "".join(f"; {of.axis.name}: {of.disagreement}" for of in self.drives if of.disagreement)
        return error(f"{text} [{reason.name}]", self.records, axis)

    def _disable(self, trust: Trust) -> list[str]:
        """Send zero and disable every drive, then release the operating system's privileges."""
        self._mark_start(is_starting=False)
        self.unconfirmed = list(range(len(self.drives)))
        try:
            for line in self._sdo_lines:
                line.close()
            problems = self._disabled(trust)
            self.unconfirmed = [axis for axis, problem in enumerate(problems) if problem]
            for drive, problem in zip(self.drives, problems, strict=True):
                if drive.is_ours and drive.sdo.changes:
                    restore(drive, problem)
                    drive.unrestored += drive.elsewhere
            return [f"{drive.axis.name}: {what}" for drive, what in zip(self.drives, problems, strict=True) if what]
        finally:
            self.realtime.end()

    def _disabled(self, trust: Trust) -> list[str]:
        """Disable every drive, tried once more where the stop itself failed, such as without memory."""
        try:
            return stop.disable(self._exchange, trust)
        except Exception:
            try:
                return stop.disable(self._exchange, Trust.NONE)
            except Exception as error:
                return [f"the stop failed: {cause_of(error)}"] * len(self.drives)

    def details(self, drive: TorqueAxis, reason: StopReason) -> str:
        """Return what was seen of a drive that is a reason to stop."""
        details = {
            StopReason.TPDO_LOST: self._missed(drive),
            StopReason.COMMAND_LOST: f"{self.bus.stop_cycles} SYNCs in a row",
            StopReason.FRAMES_LOST: self._lost(drive),
            StopReason.TPDO_CONTRADICTED: f"{drive.culprit}, {self._lost(drive)}",
            StopReason.TORQUE_CONTRADICTED: self._contradicted(drive),
            StopReason.HEARTBEAT_LOST: f"silent for more than {self.bus.drive_silence_ns / 1e6:g} ms",
            StopReason.EMERGENCY: str(drive.emergency),
            StopReason.POSITION_JUMP: f"limit {drive.axis.largest_speed:g} {drive.axis.unit}/s",
            StopReason.NMT_STATE_LEFT: drive.state_text,
            StopReason.HOLDS_CONTRADICTED: drive.disagreement,
        }
        return details.get(reason, f"state {drive.state.value}, statusword {drive.statusword:#06x}")

    def _describe(self, drive: TorqueAxis, reason: StopReason) -> str:
        rule = STOP_TABLE[reason]
        what = f"{drive.axis.name}: {rule.meaning} at SYNC {self.sync_index}: {self.details(drive, reason)}"
        remedy = drive.emergency_remedy(self.skipped_syncs)
        return f"{what}; torque is zero; {remedy or rule.remedy}"

    def _lost(self, drive: TorqueAxis) -> str:
        answered = f"{100.0 * drive.policy.success_rate():.4g} % of all SYNCs answered"
        return f"{answered}, limit bus.loss_limit ({100.0 * self.bus.loss_limit:g} % of the last ones lost)"

    def _contradicted(self, drive: TorqueAxis) -> str:
        found, unit = drive.check.last, "N" if drive.axis.unit == "m" else "N*m"
        if found is None:
            return ""
        read, *hull = (drive.scaling.torque(value) for value in found)
        wide = drive.check.tolerance * drive.quantum
        commanded = (
            f"{min(hull):.4g} .. {max(hull):.4g} {unit} commanded, 0 included (torque_tolerance {wide:.3g} {unit})"
        )
        return f"{drive.check.contradicted} SYNCs in a row, read {read:.4g} {unit}, {commanded}"

    def _missed(self, drive: TorqueAxis) -> str:
        others = next((others for one, others in self._needed if one is drive), ())
        names = ", ".join(other.axis.name for other in others)
        together = f" without the TPDOs of all of {names}, which render together" if names else ""
        missing = f" without {drive.culprit}" if drive.culprit and not names else ""
        return f"{drive.policy.missed} SYNCs in a row{missing}{together}, limit {self.bus.stop_cycles}"

    def reset_faults(self) -> None:
        """Reset the faults of all drives on the operator's request; leave every drive disabled.

        Raises:
            RigError: The rig is running.
            StartError: A fault stays, or a drive is not the one of the configuration.
        """
        if self.is_running:
            raise RigError("faults are not reset while the rig runs; call stop() first", self.records)
        bring_ups = [drive.bring_up() for drive in self.drives]
        for bring_up in bring_ups:
            bring_up.identify()
        for bring_up in bring_ups:
            bring_up.reset_fault()

    def read_objects(self, axis: int) -> "list[Finding]":
        """Return the limits, ramps and reactions stored in the drive of an axis; raise SdoError without an answer."""
        from canhaptic.drive.survey import read_objects

        return list(read_objects(self.drives[axis]))

    # --- what happened ------------------------------------------------------------------------------------------------

    @property
    def dry_run(self) -> bool:
        """Whether the drives are sent no torque, so that the run proves nothing."""
        return any(drive.dry_run for drive in self.drives)

    @property
    def skipped_syncs(self) -> int:
        """Deadlines of SYNC that were missed and skipped."""
        return self.deadline_index - max(0, self.sync_index)

    def link_statistics(self) -> dict[str, float]:
        """Return the counts of all links, the SYNCs skipped and the fraction of SYNCs that every axis answered."""
        counts: dict[str, float] = {"skipped_syncs": self.skipped_syncs}
        for bus in self.buses:
            for name, count in bus.statistics().items():
                counts[name] = counts.get(name, 0) + count
        counts["missed_tpdos"] = sum(drive.unheard for drive in self.drives)
        counts["success_rate"] = min((drive.policy.success_rate() for drive in self.drives), default=1.0)
        return counts

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self.stop(ramp=kind is None or not issubclass(kind, Exception))
