"""One axis in the cycle: its TPDOs in, its RPDO out, its heartbeat and EMCY. No steps, no waiting."""

from collections.abc import Callable
from typing import Final, NamedTuple

from canopen import ObjectDictionary

from canhaptic import object_dictionary as od
from canhaptic.drive.cia402 import ENABLED_MASK, ENABLED_VALUE, DriveState, drive_state
from canhaptic.drive.fitness import require_fit
from canhaptic.drive.limiter import TorqueLimiter
from canhaptic.drive.link import Link
from canhaptic.drive.link_policy import LinkPolicy, StopReason
from canhaptic.drive.parameters import AxisParameters, BusParameters
from canhaptic.drive.pdo_codec import codec
from canhaptic.drive.pdo_map import AxisMap, PdoPlan, choose_map
from canhaptic.drive.quirks import quirks_of
from canhaptic.drive.scaling import axis_scaling
from canhaptic.drive.sdo import SdoChannel
from canhaptic.signals import Sample

_SLOTS: Final = {od.STATUSWORD: 0, od.POSITION_ACTUAL: 1, od.TORQUE_DEMAND: 2, od.TORQUE_ACTUAL: 2}
_IN_ORDER: Final = (0, 1, 2)
_NMT_STATE: Final = 0x7F  # bit 7 of a heartbeat is reserved
_OPERATIONAL: Final = int(od.NmtState.OPERATIONAL)
_LIMITED: Final = int(od.StatusBit.INTERNAL_LIMIT)


class Emergency(NamedTuple):
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
        self._reads_demand = self.map.read_back == "demand"
        self._rpdo_cob_id = self.map.rpdo.cob_id
        self._pack = self._packer(self.map.rpdo)
        self._silence = bus.drive_silence_ns
        self._largest_step = (axis.speed_limit or float("inf")) * bus.sample_time
        self._listen()
        self.reset()

    def reset(self) -> None:
        """Forgets everything heard and commanded."""
        self.statusword = 0
        self.nmt_state: int | None = None
        self.last_heartbeat = self._clock.now()
        self.emergency: Emergency | None = None
        self.controlword = int(od.Controlword.DISABLE_VOLTAGE)
        self._stage = [0, 0, 0]  # statusword, position counts, torque per mille: of the SYNC that is open
        self._values: tuple[int, ...] | list[int] = (0, 0, 0)
        self._pending = 0  # one bit for each TPDO that may come now
        self.is_complete = False
        self.scaling.reset()
        self.limiter.reset()
        self.policy.reset()
        self._commanded = 0  # per mille: sent last
        self._acting = 0  # per mille: believed to act now, with a synchronous RPDO
        self._reported = 0  # per mille: of the TPDO before
        self._held_before = 0  # per mille: read back for the hold before
        self._unheeded = 0  # holds in a row in which an old torque stood although another was sent
        self._held = 0.0  # torque when the first TPDO went missing [N*m or N]
        self._step = 0.0  # mean displacement per sample time since the last TPDO [rad or m]
        self._periods = 0  # sample times since the last TPDO
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
    def state(self) -> DriveState:
        """Power state of the last statusword."""
        return drive_state(self.statusword)

    def sample(self, sync_index: int, periods: int = 1) -> Sample:
        """Returns what the drive reported for the SYNC that was just answered, or not.

        Args:
            sync_index: Of that SYNC.
            periods: Sample times since the SYNC before; more than 1 when SYNCs were skipped.
        """
        self._periods += periods
        if not self.is_complete:
            if self.policy.missed == 0:
                self._held = self.limiter.last
            self.policy.count(heard=False)
            self._acting = self._commanded
            self._last = self._last._replace(sync_index=sync_index, fresh=False)
            return self._last
        self.policy.count(heard=True)
        statusword, counts, reported = self._values
        scaling = self.scaling
        position = scaling.position(counts)
        torque = scaling.torque(self._applied_per_mille(reported))
        last = self._last
        self._step = (position - last.position) / self._periods if last.sync_index >= 0 else 0.0
        self._periods = 0
        self._last = sample = Sample(sync_index, position, torque, statusword, True)
        return sample

    def _applied_per_mille(self, reported: int) -> int:
        """Returns the torque of the hold that ended: read back, or believed where nothing is read back."""
        believed = self._acting if self._is_synchronous else self._commanded
        self._acting = self._commanded
        if self.map.read_back == "none":
            return believed
        if self.axis.demand_reported == "after":
            reported, self._reported = self._reported, reported
        if reported == believed or reported != self._held_before or self._values[0] & _LIMITED:
            self._unheeded = 0
        elif self._reads_demand:  # a torque that is measured may differ for ever
            self._unheeded += 1
        self._held_before = reported
        return reported

    def fault(self, now: int) -> StopReason:
        """Returns why the rig must stop because of this drive; NONE while all is well."""
        if (
            self.emergency is not None
            or self.statusword & ENABLED_MASK != ENABLED_VALUE
            or self.nmt_state != _OPERATIONAL
        ):
            return self._state_fault()
        if now - self.last_heartbeat > self._silence:
            return StopReason.HEARTBEAT_LOST
        if not -self._largest_step <= self._step <= self._largest_step:
            return StopReason.POSITION_JUMP
        if self.policy.missed >= self.bus.stop_cycles:
            return StopReason.TPDO_LOST
        if self._unheeded >= self.bus.stop_cycles:
            return StopReason.COMMAND_LOST
        return StopReason.NONE

    def _state_fault(self) -> StopReason:
        if self.emergency is not None:
            return StopReason.EMERGENCY
        if self.state in (DriveState.FAULT, DriveState.FAULT_REACTION_ACTIVE):
            return StopReason.DRIVE_FAULT
        if self.statusword & ENABLED_MASK != ENABLED_VALUE:
            return StopReason.STATE_LEFT
        return StopReason.NMT_STATE_LEFT

    # --- out --------------------------------------------------------------------------------------------------------

    def command_per_mille(self, torque: float) -> int:
        """Returns the target torque (0x6071) for what the controller asks [N*m or N], after policy and limiter.

        While TPDOs are missing, the torque that was held when the first went missing, or what is left of it on its
        ramp, is a bound: less of it may be asked for, as the operator's stop does, and never more.

        Raises:
            ControlError: The torque is not finite.
        """
        if self.policy.missed and torque - torque == 0.0:  # a torque that is not finite must reach the limiter
            held = self._held * self.policy.share()
            torque = max(min(held, 0.0), min(max(held, 0.0), torque))
        limiter = self.limiter
        torque = limiter.limit(torque, self._step / self.bus.sample_time)
        return self.scaling.torque_per_mille(torque, limiter.low, limiter.high)

    def write(self, torque_per_mille: int) -> None:
        """Sends controlword and target torque as one image.

        Raises:
            LinkError: It could not be sent.
        """
        self._commanded = torque_per_mille
        self.link.send(self._rpdo_cob_id, self._pack(self.controlword, torque_per_mille))

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
        emergency = Emergency(int.from_bytes(padded[:2], "little"), padded[2], bytes(data[3:]))
        if emergency.code and self.emergency is None:
            self.emergency = emergency
