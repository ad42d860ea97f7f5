"""The process data of the simulated drive: its actions at a SYNC, on an RPDO, and on events."""

from collections import deque
from collections.abc import Callable
from functools import partial
from itertools import pairwise
from typing import Final

from canhaptic.canopen.objects import (
    COMMUNICATION_CYCLE_PERIOD,
    SYNC_COB_ID,
    SYNC_COUNTER_OVERFLOW,
    SYNC_FRAME_COB_ID,
    DataType,
    SdoAbort,
)
from canhaptic.sim.drive.can import emergency as emcy
from canhaptic.sim.drive.can.pdo import Pdo, find_pdos
from canhaptic.sim.drive.drive_parameters import SimulatedDriveParameters
from canhaptic.sim.drive.profile.object_store import ObjectStore
from canhaptic.sim.drive.profile.servo import Servo
from canhaptic.sim.drive.profile.state_machine import DriveState
from canhaptic.sim.drive.timers import Timers

_NS_PER_US: Final = 1000
_LARGEST_COUNTER: Final = 240  # of the SYNC
_SYNCS_REMEMBERED: Final = 5
_SYNC_GENERATOR: Final = 1 << 30  # bit of 0x1005: the device produces SYNC, which this one cannot

Content = bytes | bytearray
Handler = Callable[[Content], None]
_Send = Callable[[int, Content], None]


class ProcessData:
    """Every PDO of one drive.

    Args:
        store: The objects.
        servo: Power stage, which measures and follows the objects.
        timers: Timers of the node.
        emergency: Announces frames of a wrong length.
        parameters: Parameters of the drive.
        send: Called with COB-ID and content of a frame.
        on_loss: Called with an error code when RPDO or SYNC are overdue.
        on_change: Called when a write changes the routes.

    Attributes:
        is_operational: Whether the NMT state lets PDOs through.
    """

    def __init__(
        self,
        store: ObjectStore,
        servo: Servo,
        timers: Timers,
        emergency: emcy.EmergencyProducer,
        parameters: SimulatedDriveParameters,
        send: _Send,
        on_loss: Callable[[int], None],
        on_change: Callable[[], None],
    ) -> None:
        self.is_operational = False
        self._syncs = deque[int](maxlen=_SYNCS_REMEMBERED)  # times [ns]
        self._servo, self._timers, self._emergency = servo, timers, emergency
        self._send, self._on_loss = send, on_loss
        self._losses_to_fault = parameters.sync_losses_to_fault
        self._shows_next_torque = parameters.torque_read_back == "after_update"
        self._rpdos = find_pdos(store, is_transmit=False, on_change=on_change)
        self._tpdos = find_pdos(store, is_transmit=True, on_change=on_change)
        self._pdo_timers = {pdo: timers.add(self._time_out) for pdo in self._rpdos}
        self._pdo_timers |= {pdo: timers.add(partial(self._send_by_timer, pdo)) for pdo in self._tpdos}
        self._sync_timer = timers.add(self._lose_sync)
        self._sync_cob_id = store.optional(SYNC_COB_ID, DataType.UNSIGNED32)
        self._sync_cob_id.check = _check_sync_cob_id
        self._cycle_period = store.optional(COMMUNICATION_CYCLE_PERIOD, DataType.UNSIGNED32)
        self._sync_cob_id.changed = self._cycle_period.changed = on_change
        counter = store.find(SYNC_COUNTER_OVERFLOW)
        if counter is not None:
            counter.check = self._check_counter
        self.routes()

    def routes(self) -> dict[int, Handler]:
        """Apply the objects; return COB-ID -> handler."""
        for pdo in (*self._rpdos, *self._tpdos):
            pdo.compile()
        routes: dict[int, Handler] = {}
        for pdo in self._rpdos:
            if pdo.is_active:
                routes.setdefault(pdo.cob_id, self._rpdo_handler(pdo))
        routes[(self._sync_cob_id.number or SYNC_FRAME_COB_ID) & 0x7FF] = self._on_sync
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
        """Usual time between the last SYNCs [ns], robust to one lost or late; None before two."""
        steps = sorted(later - sooner for sooner, later in pairwise(self._syncs))
        return steps[(len(steps) - 1) // 2] if steps else None

    def send_events(self) -> None:
        """Send the event-driven TPDOs; those of transmission type 0 follow at the next SYNC."""
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
        if self._sync_rpdos:
            self._act_on_synchronous()

    def _act_on_synchronous(self) -> None:
        for pdo in self._sync_rpdos:
            if pdo.pending is not None:
                content, pdo.pending = pdo.pending, None
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
            if pdo.is_synchronous:
                pdo.pending = content
            else:
                pdo.load(content)

        return take  # a closure: a `partial` would send every frame through C and back

    def _time_out(self, _due: int) -> None:
        self._on_loss(emcy.RPDO_TIMEOUT)

    # --- TPDO by events ---------------------------------------------------------------------------------------------

    def _send_event(self, pdo: Pdo) -> None:
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

    def _send_by_timer(self, pdo: Pdo, _due: int) -> None:
        self._send_event(pdo)


def _check_sync_cob_id(value: int) -> SdoAbort | None:
    return SdoAbort.VALUE_RANGE if value & _SYNC_GENERATOR or not value & 0x7FF else None
