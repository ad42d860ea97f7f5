"""The simulated drive: a CANopen slave with the CiA 402 profile, on any python-can bus, built from any EDS or DCF.

At a SYNC it samples the position and the torque held, sends the synchronous TPDOs, and THEN acts on the synchronous
RPDOs received since the last SYNC. An event-driven RPDO acts on arrival. It shares with the master only the constants
of the object dictionary: its SDO server, codecs, scaling and state machine are its own.
"""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Final

import can
from canopen.objectdictionary import ObjectDictionary, datatypes

from canhaptic.dictionary import read_dictionary
from canhaptic.object_dictionary import (
    ABORT_CONNECTION_OPTION,
    COMMUNICATION_CYCLE_PERIOD,
    ERROR_BEHAVIOUR,
    HEARTBEAT_BASE,
    NMT_COB_ID,
    SDO_REQUEST_BASE,
    SDO_RESPONSE_BASE,
    SYNC_COB_ID,
    SYNC_FRAME_COB_ID,
    NmtCommand,
    NmtState,
    SdoAbort,
)
from canhaptic.signals import Truth
from canhaptic.sim import emergency as emcy
from canhaptic.sim.drive_parameters import SimulatedDriveParameters
from canhaptic.sim.nmt_slave import HeartbeatConsumer, HeartbeatProducer, command_for
from canhaptic.sim.objects import ObjectStore
from canhaptic.sim.pdo import Pdo, find_pdos
from canhaptic.sim.sdo_server import SdoServer
from canhaptic.sim.servo import Motor, Servo
from canhaptic.sim.state_machine import DriveState
from canhaptic.sim.timers import Timers

_COMMUNICATION_OBJECTS: Final = range(0x1000, 0x2000)
_OPERATIONAL: Final = NmtState.OPERATIONAL
_NS_PER_US: Final = 1000
_SYNC_GENERATOR: Final = 1 << 30  # bit of 0x1005: the device produces SYNC, which this one cannot
_FAULT: Final = 1  # value of 0x6007; used when a dictionary has no such object

_TRANSIENT: Final = frozenset((DriveState.FAULT_REACTION_ACTIVE, DriveState.QUICK_STOP_ACTIVE))
_FAULTY: Final = frozenset((DriveState.FAULT_REACTION_ACTIVE, DriveState.FAULT))

_Content = bytes | bytearray
_Handler = Callable[[_Content], None]


class SimulatedDrive:
    """One CiA 402 servo drive with its motor, driven by the master's clock (a `FarSide`).

    Args:
        bus: Its connection to the bus.
        node_id: 1..127.
        dictionary: Path of its EDS or DCF, or the dictionary read from it.
        motor: What it moves; stands still until the first SYNC that finds operation enabled.
        parameters: What the dictionary does not tell.
        sample_time_ns: Time between two SYNCs [ns]; a fault reaction or quick stop takes this long.

    Raises:
        DictionaryError: The dictionary cannot be read.
        ParameterError: Rated torque unknown, or an object in `parameters.objects` that does not exist.
    """

    def __init__(
        self,
        bus: can.BusABC,
        node_id: int,
        dictionary: str | Path | ObjectDictionary,
        motor: Motor,
        parameters: SimulatedDriveParameters,
        sample_time_ns: int,
    ) -> None:
        if not isinstance(dictionary, ObjectDictionary):
            dictionary = read_dictionary(dictionary, node_id)
        self.node_id = node_id
        self.frames_lost = 0  # frames that the bus refused to send
        self.nmt_state = NmtState.BOOT_UP
        self._bus = bus
        self._reaction_time = sample_time_ns
        self._sync_losses = parameters.sync_losses_to_fault
        self._shows_next_torque = parameters.torque_read_back == "after_update"
        self.store = ObjectStore(dictionary, parameters.object_values())
        self.servo = Servo(self.store, motor, parameters)
        self._timers = Timers()
        self._emergency = emcy.Emergency(self.store, node_id, self._send_emergency)
        self._sdo = SdoServer(self.store, parameters.sdo_size_indicated)
        self._routes: dict[int, _Handler] = {}
        self._are_routes_stale = True
        self._build_communication()
        self._boot_timer = self._timers.add(self._power_on)
        self._settle_timer = self._timers.add(self._settle)
        self._sync_timer = self._timers.add(self._lose_sync)
        self._timers.start(self._boot_timer, 0)

    def _build_communication(self) -> None:
        store, timers = self.store, self._timers
        self._producer = HeartbeatProducer(store, timers, self._send_heartbeat, self._now)
        self._consumer = HeartbeatConsumer(
            store, timers, self._now, self._lose_heartbeat, self._regain_heartbeat, self._change_routes
        )
        self._rpdos = find_pdos(store, is_transmit=False, on_change=self._change_routes)
        self._tpdos = find_pdos(store, is_transmit=True, on_change=self._change_routes)
        self._pdo_timers = {
            **{pdo: timers.add(partial(self._time_out, pdo)) for pdo in self._rpdos},
            **{pdo: timers.add(partial(self._send_by_timer, pdo)) for pdo in self._tpdos},
        }
        self._sync_cob_id = store.entry(SYNC_COB_ID, datatypes.UNSIGNED32)
        self._sync_cob_id.check = _check_sync_cob_id
        self._sync_cob_id.changed = self._change_routes
        self._cycle_period = store.entry(COMMUNICATION_CYCLE_PERIOD, datatypes.UNSIGNED32)
        self._cycle_period.changed = self._change_routes
        self._abort_option = store.find(ABORT_CONNECTION_OPTION)
        self._error_behaviour = store.entry(ERROR_BEHAVIOUR, datatypes.UNSIGNED8, 1)

    # --- the far side of the master's clock -------------------------------------------------------------------------

    def process(self, now: int) -> None:
        """Handles every frame waiting on the bus and every timer due up to `now` [ns]."""
        receive = self._bus.recv
        self.wake(now)
        while (message := receive(0)) is not None:
            self.take(message, now)
        self.run_timers(now)

    def wake(self, now: int) -> None:
        """Powers the drive on if this is its first moment; that comes before any frame."""
        if self._timers.earliest == 0:
            self.servo.now = now
            self._timers.fire(0)

    def take(self, message: can.Message, now: int) -> None:
        """Handles one frame at `now` [ns]."""
        if message.is_extended_id or message.is_remote_frame or message.is_error_frame:
            return
        if self._are_routes_stale:
            self._build_routes()
        handler = self._routes.get(message.arbitration_id)
        if handler is not None:
            self.servo.now = now
            handler(message.data)
            if self.servo.has_event or self.servo.fault_code:
                self._follow_up()

    def run_timers(self, now: int) -> None:
        """Does what is due up to `now` [ns]."""
        if now >= self._timers.earliest:
            self.servo.now = now
            self._timers.fire(now)
            self._follow_up()

    def next_due(self) -> int:
        """Returns when the next timer is due [ns]."""
        return self._timers.next_due()

    def truth(self) -> Truth:
        """Returns where the motor really is, and its energies, as of the last SYNC or change of torque."""
        return Truth(self.servo.motor.position, self.servo.motor.energy())

    def inject_fault(self, code: int = 0x5000) -> None:
        """Lets the drive fault with an error code (0x603F), as if its hardware had failed."""
        self._fault(code)
        self._follow_up()

    @property
    def state(self) -> DriveState:
        """State of the power drive system."""
        return self.servo.state

    @property
    def torque(self) -> float:
        """Torque in force at the axis [N*m or N]."""
        return self.servo.torque

    def _now(self) -> int:
        return self.servo.now

    def _send(self, cob_id: int, content: _Content) -> None:
        message = can.Message(
            timestamp=self.servo.now * 1e-9, arbitration_id=cob_id, is_extended_id=False, data=content
        )
        try:
            self._bus.send(message)
        except can.CanError:
            self.frames_lost += 1

    def _send_emergency(self, cob_id: int, content: bytes) -> None:
        if self.nmt_state in (NmtState.PRE_OPERATIONAL, _OPERATIONAL):
            self._send(cob_id, content)

    # --- routes from a COB-ID to its handler ------------------------------------------------------------------------

    def _change_routes(self) -> None:
        self._are_routes_stale = True

    def _build_routes(self) -> None:
        self._are_routes_stale = False
        for pdo in (*self._rpdos, *self._tpdos):
            pdo.compile()
        routes: dict[int, _Handler] = {}
        for rpdo in self._rpdos:
            if rpdo.is_active:
                routes.setdefault(rpdo.cob_id, partial(self._on_rpdo, rpdo))
        for cob_id, slot in self._consumer.watched().items():
            routes[cob_id] = partial(self._on_heartbeat, slot)
        sync_cob_id = self._sync_cob_id.number or SYNC_FRAME_COB_ID
        routes[sync_cob_id & 0x7FF] = self._on_sync
        routes[SDO_REQUEST_BASE + self.node_id] = self._on_sdo
        routes[NMT_COB_ID] = self._on_nmt
        self._routes = routes
        active = [pdo for pdo in self._tpdos if pdo.is_active]
        self._sync_tpdos = tuple(pdo for pdo in active if pdo.is_synchronous)
        self._event_tpdos = tuple(pdo for pdo in active if not pdo.is_synchronous)
        self._sync_rpdos = tuple(pdo for pdo in self._rpdos if pdo.is_active and pdo.is_synchronous)
        self.servo.measures_velocity = any(self.servo.velocity_entry in pdo.entries for pdo in active)
        self._sync_timeout = self._sync_losses * self._cycle_period.number * _NS_PER_US
        for timer in (*self._pdo_timers.values(), self._sync_timer):
            self._timers.stop(timer)
        for tpdo in self._event_tpdos:
            self._restart_event_timer(tpdo)

    # --- handlers ---------------------------------------------------------------------------------------------------

    def _on_sync(self, content: _Content) -> None:
        if len(content) > 1:
            self._emergency.announce(emcy.SYNC_LENGTH)
            return
        if self.nmt_state is not _OPERATIONAL:
            return
        servo = self.servo
        if self._sync_timeout:
            self._timers.start(self._sync_timer, servo.now + self._sync_timeout)
        servo.sample()
        if self._shows_next_torque:
            self._act_on_synchronous()
            servo.show_torque()
        for pdo in self._sync_tpdos:
            if pdo.counts_sync():
                self._send(pdo.cob_id, pdo.pack())
        self._act_on_synchronous()

    def _act_on_synchronous(self) -> None:
        for pdo in self._sync_rpdos:
            if pdo.pending is not None:
                content, pdo.pending = pdo.pending, None
                pdo.load(content)

    def _on_rpdo(self, pdo: Pdo, content: _Content) -> None:
        if self.nmt_state is not _OPERATIONAL:
            return
        if len(content) < pdo.length:
            pdo.was_short = True
            self._emergency.announce(emcy.PDO_TOO_SHORT)
            return
        if pdo.was_short:
            pdo.was_short = False
            self._emergency.withdraw(emcy.PDO_TOO_SHORT)
        if pdo.event_time:
            self._timers.start(self._pdo_timers[pdo], self.servo.now + pdo.event_time)
        if pdo.is_synchronous:
            pdo.pending = content
        else:
            pdo.load(content)

    def _on_sdo(self, content: _Content) -> None:
        if self.nmt_state is NmtState.STOPPED:
            return
        answer = self._sdo.answer(bytes(content))
        if answer is not None:
            self._send(SDO_RESPONSE_BASE + self.node_id, answer)

    def _on_heartbeat(self, slot: int, content: _Content) -> None:
        if len(content) == 1:
            self._consumer.hear(slot)

    def _on_nmt(self, content: _Content) -> None:
        command = command_for(bytes(content), self.node_id)
        if command is NmtCommand.START:
            self._start()
        elif command is NmtCommand.STOP:
            self._leave_operational(NmtState.STOPPED)
        elif command is NmtCommand.PRE_OPERATIONAL:
            self._leave_operational(NmtState.PRE_OPERATIONAL)
        elif command is NmtCommand.RESET_COMMUNICATION:
            self._leave_operational(NmtState.PRE_OPERATIONAL)
            self._boot(_COMMUNICATION_OBJECTS)
        elif command is NmtCommand.RESET_NODE:
            self._power_on(self.servo.now)

    # --- NMT --------------------------------------------------------------------------------------------------------

    def _power_on(self, _due: int) -> None:
        self.store.reset()
        self._emergency.reset()
        self.servo.reset()
        self.servo.settle()
        self._boot(range(0))

    def _boot(self, reset: range) -> None:
        """Starts communication: boot-up, then PRE-OPERATIONAL."""
        self.store.reset(reset)
        self._emergency.show()
        self._timers.stop_all()
        self._sdo.reset()
        self._consumer.restart()
        self.nmt_state = NmtState.BOOT_UP
        self._send_heartbeat()
        self.nmt_state = NmtState.PRE_OPERATIONAL
        self._producer.restart()
        if self.servo.state in _TRANSIENT:
            self._timers.start(self._settle_timer, self.servo.now + self._reaction_time)
        self._build_routes()

    def _start(self) -> None:
        if self.nmt_state is not _OPERATIONAL:
            self.nmt_state = _OPERATIONAL
            if self.servo.state not in _FAULTY:
                self._emergency.withdraw(emcy.COMMUNICATION)
            for pdo in (*self._rpdos, *self._tpdos):
                pdo.reset()
            self.servo.has_event = True  # every event-driven TPDO is sent once

    def _leave_operational(self, state: NmtState) -> None:
        if self.nmt_state is _OPERATIONAL and self.servo.is_powered:
            self._abort_connection(emcy.COMMUNICATION)
        self.nmt_state = state
        for timer in (*self._pdo_timers.values(), self._sync_timer):
            self._timers.stop(timer)

    def _send_heartbeat(self) -> None:
        self._send(HEARTBEAT_BASE + self.node_id, bytes((self.nmt_state,)))

    # --- faults and watchdogs ---------------------------------------------------------------------------------------

    def _lose_heartbeat(self) -> None:
        self._abort_connection(emcy.HEARTBEAT_LOST)
        behaviour = self._error_behaviour.number
        if self.nmt_state is _OPERATIONAL and behaviour in (0, 2):
            self._leave_operational(NmtState.STOPPED if behaviour == 2 else NmtState.PRE_OPERATIONAL)

    def _regain_heartbeat(self) -> None:
        if self.servo.state not in _FAULTY:
            self._emergency.withdraw(emcy.HEARTBEAT_LOST)

    def _time_out(self, _pdo: Pdo, _due: int) -> None:
        if self.nmt_state is _OPERATIONAL:
            self._abort_connection(emcy.RPDO_TIMEOUT)

    def _lose_sync(self, _due: int) -> None:
        if self.nmt_state is _OPERATIONAL and self.servo.state is DriveState.OPERATION_ENABLED:
            self._fault(emcy.SYNC_LOST)

    def _abort_connection(self, code: int) -> None:
        self._emergency.announce(code)
        option = self._abort_option
        self.servo.abort_connection(_FAULT if option is None or option.value is None else option.number)

    def _fault(self, code: int) -> None:
        self._emergency.announce(code)
        self.servo.fault()

    def _settle(self, _due: int) -> None:
        self.servo.settle()

    # --- events -----------------------------------------------------------------------------------------------------

    def _follow_up(self) -> None:
        """Does what a change of state brings with it: faults announced, reactions timed, event-driven TPDOs."""
        servo = self.servo
        if servo.fault_code:
            code, servo.fault_code = servo.fault_code, 0
            self._fault(code)
        if not servo.has_event:
            return
        servo.has_event = False
        if servo.state in _TRANSIENT and not self._timers.is_running(self._settle_timer):
            self._timers.start(self._settle_timer, servo.now + self._reaction_time)
        if servo.was_reset:
            servo.was_reset = False
            self._emergency.withdraw()
        if self.nmt_state is not _OPERATIONAL:
            return
        for pdo in self._sync_tpdos:
            pdo.is_due = True
        for pdo in self._event_tpdos:
            self._send_event(pdo)

    def _send_event(self, pdo: Pdo) -> None:
        now = self.servo.now
        if now < pdo.not_before:
            self._timers.start(self._pdo_timers[pdo], pdo.not_before)
            return
        self.servo.measure()
        pdo.not_before = now + pdo.inhibit_time
        self._send(pdo.cob_id, pdo.pack())
        self._restart_event_timer(pdo)

    def _restart_event_timer(self, pdo: Pdo) -> None:
        if pdo.event_time:
            self._timers.start(self._pdo_timers[pdo], self.servo.now + pdo.event_time)

    def _send_by_timer(self, pdo: Pdo, _due: int) -> None:
        if self.nmt_state is _OPERATIONAL and not pdo.is_synchronous:
            self._send_event(pdo)


def _check_sync_cob_id(value: int) -> SdoAbort | None:
    return SdoAbort.VALUE_RANGE if value & _SYNC_GENERATOR or not value & 0x7FF else None
