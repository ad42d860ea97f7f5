"""The process data of the simulated drive: PDO mapping, and the actions at a SYNC, on an RPDO and on events.

The mapping follows CiA 301, 7.5.2.35-38; every PDO has a precompiled codec.
"""

import struct
from collections import deque
from collections.abc import Callable
from functools import partial
from itertools import pairwise
from operator import attrgetter
from typing import Final, cast

from canhaptic.canopen import objects
from canhaptic.canopen.objects import DataType, SdoAbort
from canhaptic.sim.drive import SimulatedDriveParameters
from canhaptic.sim.drive.profile import emergency as emcy
from canhaptic.sim.drive.profile.object_store import Entry, ObjectStore, refuse_unless
from canhaptic.sim.drive.profile.servo import Servo
from canhaptic.sim.drive.profile.state_machine import DriveState
from canhaptic.sim.drive.profile.timers import Timers

_PDOS: Final = 512
_EXTENDED_FRAME: Final = 1 << 29
_LARGEST_SYNCHRONOUS: Final = 240  # transmission types 0..240 follow the SYNC, 254 and 255 events
_MAX_BITS: Final = 64
_ANY: Final = 1 << 63  # no integer of a PDO is beyond it
_value_of: Final = attrgetter("value")
_FORBIDDEN: Final = frozenset(
    (*range(0x080), *range(0x101, 0x181), *range(0x581, 0x600), *range(0x601, 0x680), *range(0x6E0, 0x800))
)
"""CAN identifiers that no PDO may use (CiA 301, table 28)."""
_RECORDS: Final = {
    False: (objects.RPDO_COMMUNICATION, objects.RPDO_MAPPING),
    True: (objects.TPDO_COMMUNICATION, objects.TPDO_MAPPING),
}
"""Whether a PDO is a TPDO -> index of the first communication object and of the first mapping object."""
_NS_PER_MS: Final = 1_000_000
_NS_PER_INHIBIT_UNIT: Final = 100_000


class Pdo:
    """One PDO: its communication and mapping objects, which check what is written to them, and its codec.

    Args:
        store: Object store.
        number: Number of the PDO, from 0.
        is_transmit: Whether it is a TPDO, from the drive's point of view.
        on_change: Called when a communication or mapping object was written.

    Attributes:
        pack: Function that packs a TPDO with the present values.
        is_active: Whether its COB-ID is valid and its map is not empty.
        cob_id: CAN identifier.
        transmission_type: Transmission type: 0..240, 254, 255.
        entries: The mapped objects, in order.
        length: Length of its frame [bytes].
        event_time: Longest silence of a TPDO, or timeout of an RPDO [ns]; 0 for none.
        inhibit_time: Shortest interval between frames of a TPDO [ns].
    """

    def __init__(self, store: ObjectStore, number: int, is_transmit: bool, on_change: Callable[[], None]) -> None:
        communication, mapping = (first + number for first in _RECORDS[is_transmit])
        self._store, self._is_transmit = store, is_transmit
        self._cob_id = cast(Entry, store.find(communication, 1))  # `_pdos_of` made sure that both exist
        self._type, self._inhibit, self._event_timer = (
            store.find(communication, place) or Entry(communication, place, DataType.UNSIGNED16) for place in (2, 3, 5)
        )  # one that the dictionary lacks has no value
        self._count = cast(Entry, store.find(mapping, 0))
        self._slots: list[Entry] = []
        while (slot := store.find(mapping, len(self._slots) + 1)) is not None:
            slot.check = self._check_slot
            self._slots.append(slot)
        self._cob_id.check, self._count.check = self._check_cob_id, self._check_count
        self._type.check = refuse_unless(lambda value: value <= _LARGEST_SYNCHRONOUS or value in (254, 255))
        self._inhibit.check = refuse_unless(lambda _value: not self._exists(), SdoAbort.DEVICE_STATE)
        for entry in (self._cob_id, self._type, self._inhibit, self._event_timer, self._count, *self._slots):
            entry.changed = on_change
        self.compile()

    def compile(self) -> None:
        """Rebuild the codec from the objects."""
        cob_id = objects.COB_ID_INVALID if self._cob_id.value is None else self._cob_id.number
        self.entries = entries = self._mapped()
        image = struct.Struct("<" + "".join(entry.code for entry in entries))
        self.pack: Callable[[], bytes] = lambda: image.pack(*map(_value_of, entries))
        self._unpack, self.length = image.unpack_from, image.size
        self.is_active = not cob_id & objects.COB_ID_INVALID and bool(self.entries)
        for entry in self.entries if self.is_active else ():
            if entry.value is None:
                entry.value = 0  # a frame has no room for "no data"
        self.cob_id = cob_id & 0x7FF
        kind = self._type.value
        self.transmission_type = kind if isinstance(kind, int) else objects.EVENT_DRIVEN
        self.is_synchronous = self.transmission_type <= _LARGEST_SYNCHRONOUS
        self.event_time = _NS_PER_MS * self._event_timer.number
        self.inhibit_time = _NS_PER_INHIBIT_UNIT * self._inhibit.number
        # Too large a torque is for the drive's limiter, which shows it; any other value out of range is ignored.
        self._ranges = [(-_ANY, _ANY) if e.index == objects.TARGET_TORQUE else (e.low, e.high) for e in self.entries]
        self._hooks = tuple(dict.fromkeys(e.changed for e in self.entries if e.changed is not None))
        self.reset()

    def reset(self) -> None:
        """Clear the record of frames received, sent and announced."""
        self.pending: bytes | bytearray | None = None  # of a synchronous RPDO, until the next SYNC
        self.later = deque[bytes | bytearray | None]()  # of a drive that acts later still
        self.was_short = False  # of an RPDO: the last frame was refused
        self.is_due = False  # of a TPDO of type 0: something happened since the last SYNC
        self.not_before = 0  # of a TPDO: end of its inhibit time [ns]
        self._syncs = 0

    def load(self, content: bytes | bytearray) -> None:
        """Write the values of an RPDO to its mapped objects, and let the drive act on them."""
        for entry, value, (low, high) in zip(self.entries, self._unpack(content), self._ranges, strict=True):
            if low <= value <= high:
                entry.value = value
        for hook in self._hooks:
            hook()

    def counts_sync(self) -> bool:
        """Count a SYNC and return whether a synchronous TPDO is due at it."""
        if self.transmission_type == 0:
            is_due, self.is_due = self.is_due, False
            return is_due
        self._syncs = (self._syncs + 1) % self.transmission_type
        return self._syncs == 0

    def _mapped(self) -> tuple[Entry, ...]:
        """Return the mapped objects; none when the map of the dictionary cannot be used."""
        entries = []
        for slot in self._slots[: self._count.number]:
            entry = self._object(slot.number)
            if entry is None or not entry.code or 8 * entry.size != slot.number & 0xFF:
                return ()
            entries.append(entry)
        return tuple(entries) if sum(entry.size for entry in entries) * 8 <= _MAX_BITS else ()

    def _object(self, mapping: int) -> Entry | None:
        return self._store.find(mapping >> 16, mapping >> 8 & 0xFF)

    # --- what may be written ----------------------------------------------------------------------------------------

    def _exists(self) -> bool:
        """Whether bit 31 must be set before the PDO is changed; a PDO with a read-only COB-ID is changed directly."""
        is_valid = self._cob_id.value is not None and not self._cob_id.number & objects.COB_ID_INVALID
        return is_valid and self._cob_id.writable

    def _check_cob_id(self, value: int) -> SdoAbort | None:
        is_valid = not value & objects.COB_ID_INVALID
        if self._exists() and is_valid and (value ^ self._cob_id.number) & 0x1FFF_FFFF:
            return SdoAbort.DEVICE_STATE
        is_refused = value & _EXTENDED_FRAME or value & 0x7FF in _FORBIDDEN
        return SdoAbort.VALUE_RANGE if is_valid and is_refused else None

    def _check_slot(self, value: int) -> SdoAbort | None:
        if self._exists():
            return SdoAbort.DEVICE_STATE
        if self._count.number:
            return SdoAbort.UNSUPPORTED_ACCESS
        return self._check_mapping(value) if value else None

    def _check_mapping(self, value: int) -> SdoAbort | None:
        entry = self._object(value)
        if entry is None:
            return SdoAbort.NO_OBJECT
        is_mappable = entry.transmittable if self._is_transmit else entry.receivable
        is_whole = entry.code and 8 * entry.size == value & 0xFF
        return None if is_mappable and is_whole else SdoAbort.NOT_MAPPABLE

    def _check_count(self, value: int) -> SdoAbort | None:
        if self._exists():
            return SdoAbort.DEVICE_STATE
        if value > len(self._slots):
            return SdoAbort.PDO_LENGTH
        mappings = [slot.number for slot in self._slots[:value]]
        for mapping in mappings:
            if (abort := self._check_mapping(mapping)) is not None:
                return abort
        return SdoAbort.PDO_LENGTH if sum(mapping & 0xFF for mapping in mappings) > _MAX_BITS else None


def _pdos_of(store: ObjectStore, is_transmit: bool, on_change: Callable[[], None]) -> tuple[Pdo, ...]:
    """Return every PDO that the dictionary describes with both its objects."""
    communication, mapping = _RECORDS[is_transmit]
    return tuple(
        Pdo(store, number, is_transmit, on_change)
        for number in range(_PDOS)
        if store.find(communication + number, 1) is not None and store.find(mapping + number, 0) is not None
    )


_NS_PER_US: Final = 1000
_LARGEST_COUNTER: Final = 240  # of the SYNC
_SYNCS_REMEMBERED: Final = 5
_SYNC_GENERATOR: Final = 1 << 30  # bit of 0x1005: the device produces SYNC, which this one cannot

Content = bytes | bytearray
Handler = Callable[[Content], None]


class ProcessData:
    """Every PDO of one drive.

    Args:
        store: Object store.
        servo: Power stage, which measures and follows the objects.
        timers: Timers of the node.
        emergency: EMCY producer, for frames of a wrong length.
        parameters: Parameters of the drive.
        send: Called with COB-ID and content of a frame.
        on_loss: Called with an error code when an RPDO or the SYNC is overdue.
        on_change: Called when a write changes the routes.

    Attributes:
        is_operational: Whether the NMT state permits PDOs.
    """

    def __init__(
        self,
        store: ObjectStore,
        servo: Servo,
        timers: Timers,
        emergency: emcy.EmergencyProducer,
        parameters: SimulatedDriveParameters,
        send: Callable[[int, Content], None],
        on_loss: Callable[[int], None],
        on_change: Callable[[], None],
    ) -> None:
        self.is_operational = False
        self._syncs = deque[int](maxlen=_SYNCS_REMEMBERED)  # times [ns]
        self._servo, self._timers, self._emergency = servo, timers, emergency
        self._send, self._on_loss = send, on_loss
        self._losses_to_fault = parameters.sync_losses_to_fault
        self._shows_next_torque = parameters.torque_read_back == "after_update"
        self._acts_at_once, self._syncs_late = parameters.acts_at_once, parameters.syncs_late
        self._rpdos = _pdos_of(store, is_transmit=False, on_change=on_change)
        self._tpdos = _pdos_of(store, is_transmit=True, on_change=on_change)
        self._pdo_timers = {pdo: timers.add(lambda _due: on_loss(emcy.RPDO_TIMEOUT)) for pdo in self._rpdos}
        self._pdo_timers |= {pdo: timers.add(partial(self._send_event, pdo)) for pdo in self._tpdos}
        self._sync_timer = timers.add(self._lose_sync)
        self._sync_cob_id = store.optional(objects.SYNC_COB_ID, DataType.UNSIGNED32)
        self._sync_cob_id.check = refuse_unless(lambda value: value & 0x7FF and not value & _SYNC_GENERATOR)
        self._cycle_period = store.optional(objects.COMMUNICATION_CYCLE_PERIOD, DataType.UNSIGNED32)
        self._sync_cob_id.changed = self._cycle_period.changed = on_change
        if (counter := store.find(objects.SYNC_COUNTER_OVERFLOW)) is not None:
            counter.check = self._check_counter
        self.routes()

    def routes(self) -> dict[int, Handler]:
        """Apply the communication and mapping objects; return the handler of each COB-ID."""
        for pdo in (*self._rpdos, *self._tpdos):
            pdo.compile()
        routes: dict[int, Handler] = {}
        for pdo in self._rpdos:
            if pdo.is_active:
                routes.setdefault(pdo.cob_id, self._rpdo_handler(pdo))
        routes[(self._sync_cob_id.number or objects.SYNC_FRAME_COB_ID) & 0x7FF] = self._on_sync
        active = [pdo for pdo in self._tpdos if pdo.is_active]
        self._sync_tpdos = tuple(pdo for pdo in active if pdo.is_synchronous)
        self._event_tpdos = tuple(pdo for pdo in active if not pdo.is_synchronous)
        self._sync_rpdos = tuple(pdo for pdo in self._rpdos if pdo.is_active and pdo.is_synchronous)
        self._servo.measures_velocity = any(self._servo.velocity_entry in pdo.entries for pdo in active)
        self._sync_timeout = self._losses_to_fault * self._cycle_period.number * _NS_PER_US
        self._stop_timers()
        for pdo in self._event_tpdos:
            self._restart_event_timer(pdo)
        return routes

    def start(self) -> None:
        """Enable PDOs; every event-driven TPDO is sent once."""
        self.is_operational = True
        self._syncs.clear()
        for pdo in (*self._rpdos, *self._tpdos):
            pdo.reset()
        self._servo.has_event = True

    def stop(self) -> None:
        """Disable PDOs."""
        self.is_operational = False
        self._stop_timers()

    def sync_period(self) -> int | None:
        """Median interval of the last SYNCs [ns], robust to one lost or late SYNC; None before two SYNCs."""
        steps = sorted(later - sooner for sooner, later in pairwise(self._syncs))
        return steps[(len(steps) - 1) // 2] if steps else None

    def send_events(self) -> None:
        """Send the event-driven TPDOs; TPDOs of transmission type 0 follow at the next SYNC."""
        for pdo in self._sync_tpdos:
            pdo.is_due = True
        for pdo in self._event_tpdos:
            self._send_event(pdo)

    def _stop_timers(self) -> None:
        for timer in (*self._pdo_timers.values(), self._sync_timer):
            self._timers.stop(timer)

    # --- SYNC -------------------------------------------------------------------------------------------------------

    def _on_sync(self, content: Content) -> None:
        if len(content) > 1:  # a counter is allowed, and not used
            self._emergency.announce(emcy.SYNC_LENGTH)
            return
        if not self.is_operational:
            return
        servo = self._servo
        self._syncs.append(servo.now)
        if self._sync_timeout:
            self._timers.start(self._sync_timer, servo.now + self._sync_timeout)
        servo.sample()
        if self._shows_next_torque:
            self._act_on_synchronous()
            servo.show_torque()
        send = self._send
        for pdo in self._sync_tpdos:
            if pdo.transmission_type == 1 or pdo.counts_sync():  # 1: at every SYNC
                send(pdo.cob_id, pdo.pack())
        if self._sync_rpdos and not self._shows_next_torque:
            self._act_on_synchronous()

    def _act_on_synchronous(self) -> None:
        for pdo in self._sync_rpdos:
            content, pdo.pending = pdo.pending, None
            if self._syncs_late:
                pdo.later.append(content)
                content = pdo.later.popleft() if len(pdo.later) > self._syncs_late else None
            if content is not None:
                pdo.load(content)

    def _check_counter(self, value: int) -> SdoAbort | None:
        """Refuse a counter while a cycle period is set, and the values 1 and above 240 (CiA 301, 7.5.2.22)."""
        if self._cycle_period.number:
            return SdoAbort.DEVICE_STATE
        return SdoAbort.VALUE_RANGE if value == 1 or value > _LARGEST_COUNTER else None

    def _lose_sync(self, _due: int) -> None:
        if self._servo.state is DriveState.OPERATION_ENABLED:
            self._on_loss(emcy.SYNC_LOST)

    # --- RPDO -------------------------------------------------------------------------------------------------------

    def _rpdo_handler(self, pdo: Pdo) -> Handler:
        def take(content: Content) -> None:
            if not self.is_operational:
                return
            if len(content) < pdo.length:
                pdo.was_short = True
                self._emergency.announce(emcy.PDO_TOO_SHORT)
                return
            if pdo.was_short:
                pdo.was_short = False
                self._emergency.withdraw(emcy.PDO_TOO_SHORT)
            if pdo.event_time:
                self._timers.start(self._pdo_timers[pdo], self._servo.now + pdo.event_time)
            if pdo.is_synchronous and not self._acts_at_once:
                pdo.pending = content
            else:
                pdo.load(content)

        return take  # a closure: a `partial` would send every frame through C and back

    # --- TPDO by events ---------------------------------------------------------------------------------------------

    def _send_event(self, pdo: Pdo, _due: int = 0) -> None:
        now = self._servo.now
        if now < pdo.not_before:
            self._timers.start(self._pdo_timers[pdo], pdo.not_before)
            return
        self._servo.measure()
        pdo.not_before = now + pdo.inhibit_time
        self._send(pdo.cob_id, pdo.pack())
        self._restart_event_timer(pdo)

    def _restart_event_timer(self, pdo: Pdo) -> None:
        if pdo.event_time and self.is_operational:
            self._timers.start(self._pdo_timers[pdo], self._servo.now + pdo.event_time)
