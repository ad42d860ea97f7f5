"""One axis in the cycle: its TPDOs in, its RPDO out, its heartbeat and EMCY. No steps, no waiting."""

from collections.abc import Callable
from typing import Final, NamedTuple

from canopen import ObjectDictionary

from canhaptic.canopen import objects as od
from canhaptic.drive.axis_parameters import AxisParameters, BusParameters
from canhaptic.drive.can.link import Link
from canhaptic.drive.can.pdo_codec import codec
from canhaptic.drive.can.pdo_map import AxisMap, PdoPlan, choose_map
from canhaptic.drive.can.sdo import SdoChannel
from canhaptic.drive.profile.fitness import require_fit
from canhaptic.drive.profile.limiter import TorqueLimiter
from canhaptic.drive.profile.link_policy import LinkPolicy, StopReason
from canhaptic.drive.profile.power_states import ENABLED_MASK, ENABLED_VALUE, FAULTED, PowerState, drive_state
from canhaptic.drive.profile.quirks import quirks_of
from canhaptic.drive.profile.scaling import axis_scaling
from canhaptic.signals import Sample

_SLOTS: Final = {od.STATUSWORD: 0, od.POSITION_ACTUAL: 1, od.TORQUE_DEMAND: 2, od.TORQUE_ACTUAL: 2}
_IN_ORDER: Final = (0, 1, 2)
_NMT_STATE: Final = 0x7F  # bit 7 of a heartbeat is reserved
_OPERATIONAL: Final = int(od.NmtState.OPERATIONAL)
_tuple: Final = tuple.__new__  # makes a sample at half the cost of calling its class
_NO_REASON: Final = StopReason.NONE  # bound once: to look a member up in its enum takes as long as all of `fault`
_LIMITED: Final = int(od.StatusBit.INTERNAL_LIMIT)
_FOLLOWS: Final = int(od.StatusBit.FOLLOWS_COMMAND)


class ReceivedEmergency(NamedTuple):
    """An EMCY as it came (CiA 301, 7.2.7)."""

    code: int  # 0x0000 means that the error is gone
    register: int  # 0x1001
    vendor: bytes

    def __str__(self) -> str:
        return f"EMCY {self.code:#06x}, error register {self.register:#04x}, vendor {self.vendor.hex(' ') or 'none'}"


class SyncWindow:
    """Which drives of one bus still owe a TPDO for the SYNC that was sent; open from SYNC to the TPDO timeout."""

    __slots__ = ("is_open", "pending")

    def __init__(self) -> None:
        self.is_open = False
        self.pending = 0


class ServoDrive:
    """The master's picture of one drive.

    Args:
        link: The bus it is on.
        axis: Its parameters.
        dictionary: Its object dictionary.
        bus: The parameters of the bus.

    Attributes:
        statusword: Of the last complete set of TPDOs.
        is_complete: Whether every TPDO of the last SYNC came in its window.
        nmt_state: As its last heartbeat said; None before the first.
        read_back_bound: Of a torque that is measured (0x6077): sum over the holds of its largest difference from that
            of the hold before and from the one sent, times the displacement [J]. The true torque of a hold lies
            between them unless the current loop overshoots, so that the energy booked is not farther from the true
            one. 0 where the demand is read back, which is exact, or nothing, which is believed.
        longest_hold: The most sample times for which one torque was held since the last `reset`: 1 where all went well,
            more where SYNCs were skipped, their TPDOs missed, or RPDOs lost as far as the demand read back tells; what
            came together counts together.
        longest_gap: The most sample times between two SYNCs since the last `reset`: 1 where none was skipped.
        emergency: The first EMCY with an error code since the last `reset`; None when there was none.

    Raises:
        DictionaryError: The dictionary is not fit for cyclic torque.
    """

    def __init__(self, link: Link, axis: AxisParameters, dictionary: ObjectDictionary, bus: BusParameters) -> None:
        self.link = link
        self.axis = axis
        self.bus = bus
        self.dictionary = dictionary
        require_fit(dictionary, axis)
        self.quirks = quirks_of(axis.quirks)
        self.map: AxisMap = choose_map(dictionary, axis)
        self.sdo = SdoChannel(link, axis.node_id, dictionary, axis.name, round(axis.sdo_timeout * 1e9))
        self.scaling = axis_scaling(axis, axis.rated_torque or 1.0)
        self.limiter = TorqueLimiter(axis.torque_limit, bus.sample_time, axis.torque_rate_limit, axis.power_limit)
        self.policy = LinkPolicy(bus.hold_cycles, bus.stop_cycles)
        self.window = SyncWindow()  # shared by the drives of a bus; the rig sets it
        self.answers = False  # an SDO was answered since the last start
        self._statistics = link.statistics
        self._clock = link.clock
        self._is_synchronous = bus.rpdo == "synchronous"
        self._reads_demand, self._reads_nothing = self.map.read_back == "demand", self.map.read_back == "none"
        self._shows_next = axis.demand_reported == "after"
        self._measures = self.map.read_back == "actual"
        self._tolerance = axis.torque_tolerance / self.quirks.torque_resolution  # counts of 0x6077
        self._rpdo_cob_id = self.map.rpdo.cob_id
        self._pack = self._packer(self.map.rpdo)
        self._silence = bus.drive_silence_ns
        self._sample_time, self._stop_cycles = bus.sample_time, bus.stop_cycles
        self._largest_step = (axis.speed_limit or float("inf")) * bus.sample_time
        self._listen()
        self.reset()

    def reset(self) -> None:
        """Forgets everything heard and commanded."""
        self.statusword = 0
        self.nmt_state: int | None = None
        self.last_heartbeat = self._clock.now()
        self.emergency: ReceivedEmergency | None = None
        self.controlword = int(od.Controlword.DISABLE_VOLTAGE)
        self._stage = [0, 0, 0]  # statusword, position counts, torque per mille: of the SYNC that is open
        self._values: tuple[int, ...] | list[int] = (0, 0, 0)
        self._pending = 0  # one bit for each TPDO that may come now
        self.is_complete = False
        self.read_back_bound = 0.0
        self._spread = 0  # per mille: how far the measured torque is from what it was, and from what was sent
        self.scaling.reset()
        self.limiter.reset()
        self.policy.reset()
        self._commanded = 0  # per mille: sent last
        self._acting = 0  # per mille: believed to act now, with a synchronous RPDO
        self._reported = 0  # per mille: of the TPDO before
        self._held_before = 0  # per mille: read back for the hold before
        self._heeded = 0  # per mille: of the last command that a measured torque has shown
        self._unheeded = 0  # holds in a row in which an old torque stood although another was sent
        self._watched, self._expected = ENABLED_MASK, ENABLED_VALUE  # bits of the statusword while the rig runs
        self._deviant = self._deviant_at = 0  # SYNCs in a row in which bit 11 or 12 was not as expected; the last one
        self._held = 0.0  # torque when the first TPDO went missing [N*m or N]
        self._step = 0.0  # mean displacement per sample time since the last TPDO [rad or m]
        self._periods = 0  # sample times since the last TPDO
        self.longest_hold = self.longest_gap = 1
        self._is_late = False  # a SYNC was skipped before the last one
        self._stood = 0  # sample times since the torque read back was a new one
        self._last = Sample(-1, 0.0, 0.0, 0, fresh=False)

    # --- in ---------------------------------------------------------------------------------------------------------

    def expect_tpdos(self) -> None:
        """Opens the window of a SYNC for this drive."""
        self._pending = self._all_tpdos
        self.is_complete = False

    def refuse_tpdos(self) -> None:
        """Closes the window: what comes now is too late for its SYNC and must not pass for the next."""
        self._pending = 0

    @property
    def position_counts(self) -> int:
        """0x6064 of the last complete set of TPDOs."""
        return self._values[1]

    @property
    def reported_per_mille(self) -> int:
        """Torque of the last complete set of TPDOs; 0 when none is mapped."""
        return self._values[2]

    @property
    def state(self) -> PowerState:
        """Power state of the last statusword."""
        return drive_state(self.statusword)

    def sample(self, sync_index: int, periods: int = 1) -> Sample:
        """Returns what the drive reported for the SYNC that was just answered, or not.

        Args:
            sync_index: Of that SYNC.
            periods: Sample times since the SYNC before; more than 1 when SYNCs were skipped.
        """
        self._periods += periods
        self._is_late = periods > 1
        if periods > self.longest_gap:
            self.longest_gap = periods
        if not self.is_complete:
            if self.policy.missed == 0:
                self._held = self.limiter.last
            self.policy.miss()
            self.longest_hold = max(self.longest_hold, self._periods)
            self._acting = self._commanded
            self._last = self._last._replace(sync_index=sync_index, fresh=False)
            return self._last
        self.policy.hear()
        statusword, counts, reported = self._values
        scaling = self.scaling
        position = scaling.position(counts)
        torque = scaling.torque(self._applied_per_mille(reported))
        last = self._last
        periods, self._periods = self._periods, 0
        self._step = (position - last.position) / periods if last.sync_index >= 0 else 0.0
        if periods > self.longest_hold and last.sync_index >= 0:
            self.longest_hold = periods
        if self._measures and last.sync_index >= 0:
            self.read_back_bound += self._spread * scaling.torque_quantum * abs(position - last.position)
        self._last = sample = _tuple(Sample, (sync_index, position, torque, statusword, True))
        return sample

    def _applied_per_mille(self, reported: int) -> int:
        """Returns the torque of the hold that ended: read back, or believed where nothing is read back."""
        believed = self._acting if self._is_synchronous else self._commanded
        self._acting = self._commanded
        if self._reads_nothing:
            return believed
        if self._shows_next:
            reported, self._reported = self._reported, reported
        if not self._reads_demand:
            self._judge_measured(reported, believed)
        elif reported == believed or reported != self._held_before or self._values[0] & _LIMITED:
            self._unheeded, self._stood = 0, self._periods
        else:
            self._unheeded += 1
            self._stood += self._periods
            self.longest_hold = max(self.longest_hold, self._stood)
        if self._measures:
            self._spread = max(abs(reported - believed), abs(reported - self._held_before))
        self._held_before = reported
        return reported

    def _judge_measured(self, measured: int, believed: int) -> None:
        """Counts holds in which a measured torque stood near an old command although another, far from it, was sent.

        Where the two are near each other it tells nothing, and the count stays.
        """
        tolerance = self._tolerance
        if abs(measured - believed) <= tolerance:
            self._heeded, self._unheeded = believed, 0
        elif abs(measured - self._heeded) > tolerance or self._values[0] & _LIMITED:
            self._unheeded = 0
        elif abs(believed - self._heeded) > 2.0 * tolerance:
            self._unheeded += 1

    def watch_statusword(self) -> None:
        """Watches more than the state from now on, the rig being enabled.

        A drive that shows that it follows its target (bit 12) must go on to do so. One whose torque is not read back
        must not begin to limit it (bit 11).
        """
        follows = self.statusword & _FOLLOWS
        limits = 0 if self.map.read_back != "none" or self.statusword & _LIMITED else _LIMITED
        self._watched, self._expected = ENABLED_MASK | follows | limits, ENABLED_VALUE | follows

    def fault(self, now: int) -> StopReason:
        """Returns why the rig must stop because of this drive; NONE while all is well."""
        if (
            self.emergency is not None
            or self.statusword & self._watched != self._expected
            or self.nmt_state != _OPERATIONAL
        ) and (reason := self._state_fault()):
            return reason
        if now - self.last_heartbeat > self._silence:
            return StopReason.HEARTBEAT_LOST
        if not -self._largest_step <= self._step <= self._largest_step:
            return StopReason.POSITION_JUMP
        if self.policy.missed >= self._stop_cycles:
            return StopReason.TPDO_LOST
        if self._unheeded >= self._stop_cycles:
            return StopReason.COMMAND_LOST
        return _NO_REASON

    def _state_fault(self) -> StopReason:
        if self.emergency is not None:
            return StopReason.EMERGENCY
        if self.state in FAULTED:
            return StopReason.DRIVE_FAULT
        if self.statusword & ENABLED_MASK != ENABLED_VALUE:
            return StopReason.STATE_LEFT
        if self.nmt_state != _OPERATIONAL:
            return StopReason.NMT_STATE_LEFT
        return self._deviation()

    def _deviation(self) -> StopReason:
        """Bears with bit 11 or 12 for as long as with a TPDO that is missing before the torque is ramped down."""
        cycle = self.policy.cycles
        self._deviant = self._deviant + 1 if self._deviant_at == cycle - 1 else 1
        self._deviant_at = cycle
        if self._deviant <= self.bus.hold_cycles:
            return StopReason.NONE
        if (self.statusword ^ self._expected) & self._watched & _FOLLOWS:
            return StopReason.NOT_FOLLOWING
        return StopReason.TORQUE_LIMITED

    # --- out --------------------------------------------------------------------------------------------------------

    def command_per_mille(self, torque: float) -> int:
        """Returns the target torque (0x6071) for what the controller asks [N*m or N], after policy and limiter.

        While TPDOs are missing, the torque that was held when the first went missing, or what is left of it on its
        ramp, is a bound: less of it may be asked for, as the operator's stop does, and never more. After a skipped SYNC
        the last torque is: a controller takes the motion of several sample times for that of one, and brakes as hard.

        Raises:
            ControlError: The torque is not finite.
        """
        policy, limiter = self.policy, self.limiter
        if (policy.missed or self._is_late) and torque - torque == 0.0:  # one that is not finite must reach the limiter
            held = self._held * policy.share() if policy.missed else limiter.last
            torque = max(min(held, 0.0), min(max(held, 0.0), torque))
        torque = limiter.limit(torque, self._step / self._sample_time)
        return self.scaling.torque_per_mille(torque, limiter.low, limiter.high)

    def write(self, torque_per_mille: int) -> None:
        """Sends controlword and target torque as one image.

        Raises:
            LinkError: It could not be sent.
        """
        self._commanded = torque_per_mille
        pack = self._pack
        self.link.send(self._rpdo_cob_id, pack(self.controlword, torque_per_mille))

    @staticmethod
    def _packer(rpdo: PdoPlan) -> Callable[[int, int], bytes]:
        image = codec(rpdo.entries, [od.CONTROLWORD, od.TARGET_TORQUE])
        if rpdo.entries[0].index == od.CONTROLWORD:
            return image.pack
        return lambda controlword, torque: image.pack(torque, controlword)

    # --- what the link hands in ---------------------------------------------------------------------------------

    def _listen(self) -> None:
        self._all_tpdos = (1 << len(self.map.tpdos)) - 1
        found: set[int] = set()
        for number, plan in enumerate(self.map.tpdos):
            wanted = [e.index for e in plan.entries if e.index in _SLOTS and _SLOTS[e.index] not in found]
            if self.map.read_back == "demand":
                wanted = [index for index in wanted if index != od.TORQUE_ACTUAL]
            found.update(_SLOTS[index] for index in wanted)
            self.link.subscribe(plan.cob_id, self._tpdo_handler(plan, 1 << number, wanted))
        self.link.subscribe(od.HEARTBEAT_BASE + self.axis.node_id, self._take_heartbeat)
        self.link.subscribe(od.EMCY_BASE + self.axis.node_id, self._take_emergency)

    def _tpdo_handler(self, plan: PdoPlan, bit: int, wanted: list[int]) -> Callable[[bytearray], None]:
        image = codec(plan.entries, wanted)
        unpack, length = image.unpack, image.size
        slots = tuple(_SLOTS[index] for index in wanted)
        is_whole = slots == _IN_ORDER and len(self.map.tpdos) == 1

        def take(data: bytearray) -> None:
            if len(data) != length:
                self._statistics.short += 1
                return
            if not self._pending & bit:
                self._count_surplus()
                return
            if is_whole:
                self._values = unpack(data)
            else:
                for slot, value in zip(slots, unpack(data), strict=True):
                    self._stage[slot] = value
                if self._pending != bit:
                    self._pending ^= bit
                    return
                self._values = list(self._stage)
            self._pending = 0
            self.is_complete = True
            self.statusword = self._values[0]
            self.window.pending -= 1

        return take

    def _count_surplus(self) -> None:
        if self.window.is_open:
            self._statistics.duplicate += 1
        else:
            self._statistics.late += 1

    def _take_heartbeat(self, data: bytearray) -> None:
        if len(data) != 1:
            self._statistics.short += 1
            return
        self.nmt_state = data[0] & _NMT_STATE
        self.last_heartbeat = self._clock.now()

    def _take_emergency(self, data: bytearray) -> None:
        padded = bytes(data).ljust(3, b"\0")  # some drives send fewer than eight bytes; canopen drops those
        emergency = ReceivedEmergency(int.from_bytes(padded[:2], "little"), padded[2], bytes(data[3:]))
        if emergency.code and self.emergency is None:
            self.emergency = emergency
