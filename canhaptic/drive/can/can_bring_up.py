"""CANopen part of the start of a drive: NMT, heartbeats, the watchdog of the master, the PDO map."""

from functools import partial

from canhaptic.canopen import objects as od
from canhaptic.canopen.objects import NmtCommand, NmtState
from canhaptic.drive.axis_parameters import LARGEST_U16
from canhaptic.drive.can.pdo_map import rpdo_transmission_type, write_map
from canhaptic.drive.can.servo_drive import ServoDrive
from canhaptic.drive.profile.bring_up import BringUp, Confirmation
from canhaptic.errors import StartError


class CanBringUp(BringUp):
    """Configures one CANopen drive, step by step."""

    _drive: ServoDrive

    def refusal(self, name: str, seen: str, expected: str, remedy: str = "") -> StartError:
        """Return the error of a step; two nodes with the same ID take precedence as the cause."""
        drive = self._drive
        if drive.sdo.is_doubled:
            name, seen, expected = "node ID", "more than one answer to each SDO request", "one"
            remedy = f"two nodes have the node ID {drive.axis.node_id}; give one of them another"
        return super().refusal(name, seen, expected, remedy)

    def _command_pre_operational(self) -> None:
        self._drive.leave_operational()

    def _explain_absence(self) -> None:
        """Ask for nodes without a node ID (LSS, CiA 305, 6.4.6), which take no SDO."""
        from canhaptic.drive.can.lss import LssMaster

        if LssMaster(self._drive.link).has_unconfigured():
            wanted, remedy = f"node {self._drive.axis.node_id}", "give it its node ID (canhaptic lss, or the vendor's "
            raise self.refusal("presence", "a node without a node ID (LSS)", wanted, f"{remedy}tool), and store it")

    def _monitor(self) -> None:
        """Request heartbeats."""
        self._drive.nmt_state = None
        self._write_confirmed("heartbeat", od.PRODUCER_HEARTBEAT_TIME, 0, self._drive.bus.heartbeat_ms)

    def _await_pre_operational(self) -> None:
        drive = self._drive
        timeout = round(drive.axis.step_timeout * 1e9) + drive.bus.heartbeat_ms * 1_000_000
        with self.step("heartbeat"):
            confirmed = drive.link.wait_for(lambda: drive.nmt_state == NmtState.PRE_OPERATIONAL, timeout)
        if not confirmed:
            raise self.refusal("heartbeat", _nmt_name(drive.nmt_state), "a heartbeat with PRE_OPERATIONAL")

    def _arm(self) -> None:
        """Write 0x1016; the consumer counts from the first heartbeat (CiA 301, 7.2.8.3.2.2), which the cycle sends."""
        bus = self._drive.bus
        milliseconds = bus.master_silence_ns // 1_000_000
        if milliseconds > LARGEST_U16:
            raise self.refusal("watchdog", f"{milliseconds} ms", f"at most {LARGEST_U16} ms (0x1016 is 16 bits)")
        self._write_confirmed("watchdog", od.CONSUMER_HEARTBEAT_TIME, 1, bus.consumer_heartbeat)

    def _sync_period(self) -> None:
        """Compare 0x1006 with the sample time: a drive set to another period misses our SYNCs."""
        drive, index = self._drive, od.COMMUNICATION_CYCLE_PERIOD
        listed = drive.dictionary.get_variable(index)
        if listed is None or not listed.readable or index in drive.left_out:
            return
        with self.step("SYNC period"):
            seen = self._read_if_there(index)
        wanted, rest = divmod(drive.sample_time_ns, 1000)
        if not seen or (seen == wanted and not rest):  # listed, but not in the drive: then it times no SYNC
            return
        if not listed.writable:
            text = f"{drive.sdo.describe(index)} = {seen} us"
            raise self.refusal("SYNC period", text, f"{drive.sample_time_ns / 1000:g} us or 0 (off)")
        self._write_confirmed("SYNC period", index, 0, 0 if rest else wanted)

    def _map(self) -> None:
        if self._drive.sdo.is_doubled:
            raise self.refusal("node ID", "", "")
        self._sync_period()
        drive = self._drive
        rpdo_type = rpdo_transmission_type(drive.bus, drive.axis)
        if drive.axis.hold_checked:
            with self.step("identity"):
                if drive.axis.hold_checked == drive.signature():
                    drive.hold = f"checked at {'this start' if drive.axis.check_hold else 'commissioning'}"
        with self.step("PDO map"):
            write_map(drive.sdo, drive.map, rpdo_type, partial(self.expect, "PDO map"), self._rpdo_deadline())

    def _rpdo_deadline(self) -> int | None:
        """Return how long the drive itself tolerates lost RPDOs [ms], where no read-back shows them to the master."""
        milliseconds = self._drive.bus.master_silence_ns // 1_000_000
        is_needed = self._drive.read_back == "none" and self._drive.axis.watchdog
        return milliseconds if is_needed and milliseconds <= LARGEST_U16 else None

    def command_operational(self) -> None:
        """Send NMT start; raise StartError."""
        with self.step("bus"):
            self._drive.command_nmt(NmtCommand.START)

    def operational(self) -> Confirmation:
        """Confirmation by a heartbeat with OPERATIONAL."""
        drive = self._drive
        return Confirmation(
            "NMT operational",
            "a heartbeat with OPERATIONAL",
            lambda: drive.is_operational,
            lambda: _nmt_name(drive.nmt_state),
            self.command_operational,
        )

    def process_data(self) -> Confirmation:
        """Confirmation by every TPDO after a SYNC."""
        drive = self._drive
        return Confirmation(
            "PDO exchange",
            "every TPDO after a SYNC",
            lambda: drive.is_complete,
            lambda: f"no {drive.culprit} of the right length",
            lambda: None,
        )


def _nmt_name(state: int | None) -> str:
    """Name of an NMT state in a heartbeat."""
    if state is None:
        return "no heartbeat"
    return NmtState(state).name if state in NmtState.__members__.values() else f"NMT state {state:#04x}"
