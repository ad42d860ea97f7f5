"""A servo drive on a CAN bus: its TPDOs, RPDO, heartbeat and EMCY, and the CANopen part of its start.

The start sets the NMT state, heartbeats, the drive's watchdog of the master, and the PDO map.
"""

import zlib
from collections.abc import Callable, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any, Final

from canopen import ObjectDictionary

from canhaptic.canopen import objects as od
from canhaptic.canopen.objects import is_writable
from canhaptic.drive.axis_parameters import LARGEST_U16, AxisParameters, CanBusParameters
from canhaptic.drive.can import pdo_map
from canhaptic.drive.can.link import Link
from canhaptic.drive.can.pdo_map import AxisMap, codec, require_fit
from canhaptic.drive.can.sdo import SdoChannel, download
from canhaptic.drive.profile.bring_up import BringUp, Confirmation
from canhaptic.drive.profile.torque_axis import CycleRules, ReceivedEmergency, TorqueAxis
from canhaptic.errors import SdoError, StartError

if TYPE_CHECKING:
    from canhaptic.drive.can.sensor_node import SensorNode

_SLOTS: Final = {od.STATUSWORD: 0, od.POSITION_ACTUAL: 1, od.TORQUE_DEMAND: 2, od.TORQUE_ACTUAL: 2}
_DOUBT: Final = 1 << 30  # of the frames awaited: order after SYNC is not sure
_WATCH: Final = 1 << 29  # the same: others may come, so that the window stays open to its end
_OPERATIONAL: Final = int(od.NmtState.OPERATIONAL)


class SyncWindow:
    """Window of one bus, from a SYNC to the TPDO timeout, in which its drives answer.

    Attributes:
        pending: Number of drives that have not answered yet.
        synced: Time of that SYNC [ns].
        latest: Time after a SYNC until which an answer that follows a missing one counts for this SYNC [ns].
    """

    __slots__ = ("is_open", "latest", "pending", "synced")

    def __init__(self) -> None:
        self.is_open = False
        self.pending = self.synced = self.latest = 0


class ServoDrive(TorqueAxis):
    """A drive that is a CANopen node.

    Args:
        link: Link to its bus.
        axis: Parameters of the axis.
        dictionary: Object dictionary of the drive.
        bus: Parameters of the bus.
        dry_run: Whether every RPDO carries a target torque of 0.
        lateness: Longest time from a hold's begin until its torque has settled [s].

    Attributes:
        map: PDOs of the drive.
        nmt_state: NMT state in its last heartbeat; None before the first.
        window: Window of the present SYNC, shared by the drives of a bus; set by the exchange.
        guarding: Life guarding that another master left armed, in words; "" where there was none.
        further_frames: Frames of a sample, in words, that are no TPDOs of the drive.
        sensor: Force sensor of the axis that is a CANopen node; None without one.

    Raises:
        DictionaryError: The dictionary is not fit for the mode of the drive.
    """

    axis: AxisParameters
    dictionary: ObjectDictionary
    sdo: SdoChannel

    def __init__(
        self, link: Link, axis: AxisParameters, dictionary: ObjectDictionary, bus: CanBusParameters, *,
        dry_run: bool = False, lateness: float = 0.0,
    ) -> None:  # fmt: skip
        require_fit(dictionary, axis, bus)
        self.link, self.bus = link, bus
        self.map: AxisMap = pdo_map.choose_map(dictionary, axis)
        sdo = SdoChannel(link, axis.node_id, dictionary, axis.name, round(axis.sdo_timeout * 1e9))
        is_synchronous, times = bus.rpdo == "synchronous", (bus.sample_time_ns, bus.sample_time)
        cycles, losses = (bus.hold_cycles, bus.stop_cycles), (bus.loss_limit, lateness)
        rules = CycleRules(*times, *cycles, is_synchronous, bus.drive_silence_ns, *losses)
        super().__init__(axis, dictionary, sdo, rules, self.map.read_back, dry_run)
        self.window, self.guarding = SyncWindow(), ""
        self._statistics = link.statistics
        self._rpdo_cob_id = self.map.rpdo.cob_id
        image = codec(self.map.rpdo.entries, [od.CONTROLWORD, axis.causality.target])
        is_first = self.map.rpdo.entries[0].index == od.CONTROLWORD
        pack: Callable[[int, int], bytes] = image.pack if is_first else lambda word, torque: image.pack(torque, word)
        self._pack = (lambda controlword, _torque: pack(controlword, 0)) if dry_run else pack  # behind the limiter's 0
        place = axis.causality.force.place
        self._listen({**_SLOTS, **({place[0]: 2} if place else {})})
        self.sensor = self._listen_to_sensor()
        self.reset()

    def signature(self) -> str:
        """Return a text that identifies drive, serial number, process data and rate: a hold test is valid for it only.

        Raises:
            SdoError: The drive does not answer.
        """
        parts = []
        for subindex in range(1, 5):  # vendor, product, revision, serial number
            try:
                parts.append(f"{self.sdo.probe(od.IDENTITY, subindex):x}")
            except SdoError as error:
                if error.code is None:
                    raise
                parts.append("0")  # not there
        plans = (self.map.rpdo, *self.map.tpdos)
        mapped = repr([(plan.cob_id, [(entry.index, entry.subindex) for entry in plan.entries]) for plan in plans])
        cycle = f"{self.bus.rate:g}Hz-{self.bus.rpdo}-{self.quirks.syncs_late}"
        return "-".join([*parts, f"{zlib.crc32(mapped.encode()):x}", cycle])

    def bring_up(self) -> "CanBringUp":
        """Return the steps that start the drive in its mode."""
        return CanBringUp(self)

    def reset(self) -> None:
        """Clear everything received and commanded."""
        super().reset()
        self.nmt_state = None
        self._toggle = -1  # bit 7 of the last answer to a guard request; -1: none yet
        self._stage: list[Any] = [0, 0, 0]  # statusword, position counts, torque per mille: of the SYNC that is open
        self._pending = 0  # one bit for each TPDO that may come now
        self._doubt = 0  # `_DOUBT` where the SYNC before was not answered, `_WATCH` where one was answered differently
        self._watches = 0  # SYNCs for which the window stays open to its end

    @property
    def nmt_state(self) -> int | None:
        """NMT state in the last heartbeat; None before the first."""
        return self._nmt_state

    @nmt_state.setter
    def nmt_state(self, state: int | None) -> None:
        self._nmt_state = state
        self.is_operational = state == _OPERATIONAL

    # --- in ---------------------------------------------------------------------------------------------------------

    def expect_tpdos(self) -> None:
        """Open the window of a SYNC for this drive."""
        self._pending = self._all_tpdos | self._doubt
        self.is_complete = False

    def refuse_tpdos(self) -> None:
        """Close the window: a later TPDO must not count for the next SYNC."""
        awaited = self._pending & ~_WATCH
        if awaited:
            late = f"{self.part(self._all_tpdos)} as soon after SYNC as before: what comes may answer an older SYNC"
            self.culprit = late if awaited == _DOUBT else self.part(awaited)
            self._doubt |= _DOUBT  # what comes after the next SYNC may answer this one
        if self._pending & _WATCH:
            self.is_contested = self.is_contested and not awaited and not self.is_complete
            self._watches -= 1
            if self._watches <= 0:
                self._doubt &= ~_WATCH
        self._pending = 0

    def part(self, bits: int) -> str:
        """Return the names of the frames of a sample whose bits are set."""
        names = (*(f"TPDO {plan.cob_id:#05x}" for plan in self.map.tpdos), *self.further_frames)
        return ", ".join(name for n, name in enumerate(names) if bits >> n & 1)

    # --- out --------------------------------------------------------------------------------------------------------

    def write(self, torque_per_mille: int) -> None:
        """Send controlword and target torque as one image.

        Raises:
            LinkError: It could not be sent.
        """
        self._commanded = torque_per_mille
        self.link.send(self._rpdo_cob_id, self._pack(self.controlword, torque_per_mille))

    def disable_unconfirmed(self) -> None:
        """Send the SDO 0x6040 = `stop_word` and await no answer: it acts even where RPDOs or SYNCs are lost.

        Raises:
            LinkError: It could not be sent.
        """
        self._write_unconfirmed(od.CONTROLWORD, 0, self.stop_word.to_bytes(2, "little"))

    def command_brake(self, *, is_open: bool) -> None:
        """Open or set a brake operated by the host, and await no answer; raise LinkError.

        Nothing is sent before the outputs were read: zeros would command those that are not ours.
        """
        brake = self.axis.brake
        if brake is not None and self.outputs is not None:
            value = brake.outputs(self.outputs, is_open=is_open)
            self._write_unconfirmed(od.DIGITAL_OUTPUTS, 1, value.to_bytes(4, "little"))

    def _write_unconfirmed(self, index: int, subindex: int, data: bytes) -> None:
        self.link.send(od.SDO_REQUEST_BASE + self.axis.node_id, next(download(index, subindex, data)))

    def command_nmt(self, command: od.NmtCommand) -> None:
        """Send an NMT command to this node only.

        Raises:
            LinkError: It could not be sent.
        """
        self.link.send(od.NMT_COB_ID, bytes([command, self.axis.node_id]))

    def leave_operational(self) -> None:
        """Command NMT pre-operational to drive and sensor; raise LinkError."""
        if self.sensor is not None:
            self.sensor.command(od.NmtCommand.PRE_OPERATIONAL)
        self.command_nmt(od.NmtCommand.PRE_OPERATIONAL)

    def await_pre_operational(self) -> None:
        """Return when the heartbeat shows pre-operational, or has been silent for too long; raise LinkError."""
        if self.map.watchdog == "life_guarding":
            self.guard()
        self.link.wait_for(lambda: self.nmt_state == od.NmtState.PRE_OPERATIONAL, self.bus.drive_silence_ns)

    def guard(self) -> None:
        """Request the NMT state, for which the drive waits too where it is guarded; raise LinkError."""
        self.link.request(od.HEARTBEAT_BASE + self.axis.node_id)

    def disarm(self) -> None:
        """Switch the drive's watchdog off, so that the end of the master's frames is no fault; raise SdoError."""
        if self.map.watchdog == "heartbeat":
            self.sdo.write(od.CONSUMER_HEARTBEAT_TIME, 1, 0)
        elif self.map.watchdog == "life_guarding":
            self.sdo.write(od.GUARD_TIME, 0, 0)

    @property
    def state_text(self) -> str:
        """NMT state in the last heartbeat, in words."""
        return f"NMT state {self.nmt_state}"

    def emergency_remedy(self, skipped: int) -> str:
        """Return the remedy for the EMCY of the drive; "" where only the drive's manual explains it.

        Args:
            skipped: Number of SYNCs that this computer skipped.
        """
        from canhaptic.canopen.code_texts import emcy_remedy

        code = 0 if self.emergency is None else self.emergency.code
        watched = {
            "heartbeat": "the heartbeat of this computer",
            "life_guarding": "the guard requests of this computer",
        }.get(self.map.watchdog, "a heartbeat or guard requests, which this computer does not send to it,")
        guarding = self.guarding or "its 0x100C and 0x100D show none"
        return emcy_remedy(code, self.bus.master_silence_ns * 1e-9, skipped, watched, guarding)

    # --- what the link hands in ---------------------------------------------------------------------------------

    def now(self) -> int:
        """Return the time of the link's clock [ns]."""
        return self.link.clock.now()

    def pump(self, deadline: int) -> None:
        """Handle the frames of the bus until `deadline` [ns]; raise LinkError."""
        self.link.wait_for(lambda: False, deadline - self.now())

    def _listen(self, places: Mapping[int, int]) -> None:
        self._all_tpdos = (1 << len(self.map.tpdos)) - 1
        self.further_frames = list[str]()
        found: set[int] = set()
        for number, plan in enumerate(self.map.tpdos):
            wanted = [e.index for e in plan.entries if e.index in places and places[e.index] not in found]
            if self.map.read_back == "demand":
                wanted = [index for index in wanted if index != od.TORQUE_ACTUAL]
            found.update(places[index] for index in wanted)
            slots = tuple(places[index] for index in wanted)
            image = codec(plan.entries, wanted)
            self.link.subscribe(plan.cob_id, self._handler(1 << number, slots, image.size, image.unpack))
        take = self._take_guard_answer if self.map.watchdog == "life_guarding" else self._take_heartbeat
        self.link.subscribe(od.HEARTBEAT_BASE + self.axis.node_id, take)
        self.link.subscribe(od.EMCY_BASE + self.axis.node_id, self._take_emergency)

    def _listen_to_sensor(self) -> "SensorNode | None":
        """Make the frame of a sensor with its own node one more part of the sample; return what commands it."""
        node = self.axis.causality.force.node
        if node is None:
            return None
        bit, value_in = self._all_tpdos + 1, node.value_in
        self._all_tpdos |= bit
        self.further_frames.append(f"frame {node.frame_id:#05x} of the force sensor")
        take = self._handler(bit, (2,), node.frame_length, lambda data: (value_in(data),))
        self.link.subscribe(node.frame_id, take)
        if node.node_id is None:
            return None
        from canhaptic.drive.can.sensor_node import SensorNode

        return SensorNode(self.link, self, node, node.node_id)

    def _handler(
        self, bit: int, slots: tuple[int, ...], length: int, unpack: Callable[[bytearray], tuple[Any, ...]]
    ) -> Callable[[bytearray], None]:
        """Return the handler of one frame of a sample, whose values go into these places of it."""
        alone = bit if slots == (0, 1, 2) and len(self.map.tpdos) == 1 else -1

        def take(data: bytearray) -> None:
            if len(data) != length:
                self._statistics.short += 1
                return
            if not self._pending & bit:
                self._take_surplus(bit, slots, unpack(data))
                return
            if self._pending == alone:  # `_take_part` in short: this runs for every drive in every cycle
                self._values = values = unpack(data)
                self.statusword = values[0]
                self._pending, self.is_complete = 0, True
                self.window.pending -= 1
                return
            for slot, value in zip(slots, unpack(data), strict=True):
                self._stage[slot] = value
            self._take_part(bit)

        return take

    def _take_part(self, bit: int) -> None:
        """Record one frame of a sample, whose values are staged; the last one completes it."""
        self._pending ^= bit
        if self._pending & ~(_DOUBT | _WATCH):
            return
        if self._pending & _DOUBT and self.now() - self.window.synced > self.window.latest:
            self._statistics.late += 1
            return
        self._pending &= _WATCH
        self._doubt &= _WATCH
        self._values = tuple(self._stage)
        self.is_complete, self.statusword = True, self._values[0]
        if not self._pending:
            self.window.pending -= 1

    def _take_surplus(self, bit: int, slots: tuple[int, ...], values: tuple[float, ...]) -> None:
        """Count a second frame for one SYNC. Where its content is another one, the sample is lost.

        If it was given out already, the account doubts it, and the windows of the next SYNCs stay open to their ends.
        """
        taken = self._values if self.is_complete else self._stage
        if any(taken[slot] != value for slot, value in zip(slots, values, strict=True)):
            self.culprit = f"{self.part(bit)} with different content for one SYNC"
            if self._is_synchronous:  # else a torque that waits acts late
                self._doubt, self._watches = self._doubt | _WATCH, self.bus.stop_cycles
            if self.window.is_open:
                self.is_complete, self.is_contested = False, True
            elif self.is_complete and self.policy.cycles:
                other = dict(zip(slots, values, strict=True))
                self.contest(*(other.get(slot, taken[slot]) for slot in (1, 2)))
        self._count_surplus(bit)

    def _count_surplus(self, bit: int) -> None:
        if self.window.is_open:
            self._statistics.duplicate += 1
        else:
            self._statistics.late += 1
            self.unasked += 1
            self.culprit = self.part(bit)

    def _take_heartbeat(self, data: bytearray) -> None:
        if len(data) != 1:
            self._statistics.short += 1
            return
        state = data[0] & 0x7F  # bit 7 is reserved
        if state != self._nmt_state:
            self.nmt_state = state
        self.alive_at = self.link.clock.now()

    def _take_guard_answer(self, data: bytearray) -> None:
        """Take a heartbeat with a toggle bit: one whose bit has not changed is no new sign of life (CiA 301)."""
        alive_at = self.alive_at
        self._take_heartbeat(data)
        toggle = data[0] & 0x80 if data and data[0] else -1  # a boot-up begins anew
        if toggle == self._toggle >= 0:
            self.alive_at = alive_at
            self._statistics.duplicate += 1
        self._toggle = toggle

    def _take_emergency(self, data: bytearray) -> None:
        padded = bytes(data).ljust(3, b"\0")  # some drives send fewer than eight bytes; canopen drops those
        emergency = ReceivedEmergency(int.from_bytes(padded[:2], "little"), padded[2], bytes(data[3:]))
        if emergency.code and self.emergency is None:
            self.emergency = emergency


class CanBringUp(BringUp):
    """Configures one CANopen drive, step by step."""

    _drive: ServoDrive

    def identify(self) -> None:
        """Read which drive and which sensor these are, and write nothing to them; raise StartError."""
        super().identify()
        if self._drive.sensor is not None:
            self._drive.sensor.identify(self)

    def refusal(self, name: str, seen: str, expected: str, remedy: str = "") -> StartError:
        """Return the error of a step; two nodes with the same ID take precedence as the cause."""
        drive = self._drive
        if drive.sdo.is_doubled:
            name, seen, expected = "node ID", "more than one answer to each SDO request", "one"
            remedy = f"two nodes have the node ID {drive.axis.node_id}; give one of them another"
        elif drive.sdo.is_late:
            limit, took = drive.axis.sdo_timeout, drive.sdo.lateness * 1e-9
            name, seen = "presence", f"answers to SDO requests after {took:.3g} s"
            expected, remedy = (
                f"within {limit:g} s (sdo_timeout)",
                f"raise sdo_timeout, for example to {2 * took:.1g} s",
            )
        return super().refusal(name, seen, expected, remedy)

    def _command_pre_operational(self) -> None:
        self._drive.leave_operational()

    def _wake(self) -> None:
        """Command pre-operational unless heartbeats show a state with SDO: a node in NMT STOPPED takes none."""
        if self._drive.nmt_state not in (od.NmtState.PRE_OPERATIONAL, od.NmtState.OPERATIONAL):
            self._drive.command_nmt(od.NmtCommand.PRE_OPERATIONAL)

    def _explain_absence(self) -> None:
        """Ask for nodes without a node ID (LSS, CiA 305, 6.4.6), which take no SDO."""
        from canhaptic.drive.can.lss import LssMaster

        if LssMaster(self._drive.link).has_unconfigured():
            wanted, remedy = (
                f"node {self._drive.axis.node_id}",
                "give it its node ID (canhaptic commission --node-id, or the vendor's ",
            )
            raise self.refusal("presence", "a node without a node ID (LSS)", wanted, f"{remedy}tool), and store it")

    def _monitor(self) -> None:
        """Switch on the drive's heartbeat; where it is guarded, off: its answers to guard requests take its place."""
        drive, index = self._drive, od.PRODUCER_HEARTBEAT_TIME
        drive.nmt_state = None
        if drive.map.watchdog == "life_guarding":
            if is_writable(drive.dictionary, index, 0):
                self._write_confirmed("heartbeat", index, 0, 0)
            return
        self._clear_guarding()
        self._write_confirmed("heartbeat", od.PRODUCER_HEARTBEAT_TIME, 0, self._drive.bus.heartbeat_ms)

    def _clear_guarding(self) -> None:
        """Switch off guarding that another master left armed: without its requests the drive would fault."""
        drive = self._drive
        drive.guarding = ""
        if not drive.identifies:  # nor did an older master
            return
        with self.step("watchdog"):
            time = self._read_if_there(od.GUARD_TIME)
            if not time:
                return
            factor = self._read_if_there(od.LIFE_TIME_FACTOR)
            left = drive.sdo.clear(od.GUARD_TIME) and drive.sdo.clear(od.LIFE_TIME_FACTOR)
        found = f"0x100C was {time} ms and 0x100D {factor} at the start"
        drive.guarding = f"{found}, and {'the drive keeps them' if left else 'this start cleared them'}"

    def _await_pre_operational(self) -> None:
        drive = self._drive
        if drive.sdo.is_late:
            raise self.refusal("", "", "")
        if drive.map.watchdog == "life_guarding":
            with self.step("bus"):
                drive.guard()
        timeout = round(drive.axis.step_timeout * 1e9) + drive.bus.heartbeat_ms * 1_000_000
        with self.step("heartbeat"):
            confirmed = drive.link.wait_for(lambda: drive.nmt_state == od.NmtState.PRE_OPERATIONAL, timeout)
        if not confirmed:
            raise self.overdue("heartbeat", _nmt_name(drive.nmt_state), "a heartbeat with PRE_OPERATIONAL")

    def _arm(self) -> None:
        """Write 0x1016, or 0x100C and 0x100D; the drive counts from the next heartbeat or request (CiA 301, 7.2.8)."""
        bus, means = self._drive.bus, self._drive.map.watchdog
        if means == "life_guarding":
            self._write_confirmed("watchdog", od.LIFE_TIME_FACTOR, 0, bus.life_time_factor)
            self._write_confirmed("watchdog", od.GUARD_TIME, 0, bus.guard_time_ms)
        if means != "heartbeat":
            return
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
        if self._drive.sdo.is_doubled or self._drive.sdo.is_late:
            raise self.refusal("node ID", "", "")
        self._sync_period()
        drive = self._drive
        rpdo_type = pdo_map.rpdo_transmission_type(drive.bus, drive.axis)
        self._confirm_hold()
        with self.step("PDO map"):
            expect, deadline = partial(self.expect, "PDO map"), self._rpdo_deadline()
            pdo_map.write_map(drive.sdo, drive.map, rpdo_type, expect, deadline, clears=drive.identifies)

    def _rpdo_deadline(self) -> int | None:
        """Return how long the drive may miss RPDOs [ms]: its watchdog, or where no read-back shows them; else None."""
        drive = self._drive
        milliseconds = drive.bus.master_silence_ns // 1_000_000
        is_needed = drive.map.watchdog == "rpdo_timer" or (drive.read_back == "none" and drive.axis.watchdog)
        return milliseconds if is_needed and milliseconds <= LARGEST_U16 else None

    def command_operational(self) -> None:
        """Send NMT start to the drive and to a sensor with its own node; raise StartError."""
        drive, sensor = self._drive, self._drive.sensor
        if sensor is not None:
            sensor.configure(self)
        with self.step("bus"):
            drive.command_nmt(od.NmtCommand.START)
            if sensor is not None:
                sensor.command(od.NmtCommand.START)

    def operational(self) -> Confirmation:
        """Confirmation that a heartbeat shows OPERATIONAL."""
        drive, wanted = self._drive, "a heartbeat with OPERATIONAL"
        is_given, seen = lambda: drive.is_operational, lambda: _nmt_name(drive.nmt_state)
        return Confirmation("NMT operational", wanted, is_given, seen, self.command_operational)

    def process_data(self) -> Confirmation:
        """Confirmation that every TPDO, and the frame of a sensor with its own node, arrives after a SYNC."""
        drive = self._drive
        wanted = ", and ".join(("every TPDO after a SYNC", *drive.further_frames))
        is_given, seen = lambda: drive.is_complete, lambda: f"no {drive.culprit} of the right length"
        return Confirmation("PDO exchange", wanted, is_given, seen, lambda: None)


def _nmt_name(state: int | None) -> str:
    if state is None:
        return "no heartbeat"
    return od.NmtState(state).name if state in od.NmtState.__members__.values() else f"NMT state {state:#04x}"
