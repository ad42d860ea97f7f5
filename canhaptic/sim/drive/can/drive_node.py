"""The simulated drive: a CANopen slave with the CiA 402 profile, on any python-can bus, built from any EDS or DCF.

At a SYNC it samples the position and the torque held, sends the synchronous TPDOs, and THEN acts on the synchronous
RPDOs received since the last SYNC. An event-driven RPDO acts on arrival. It shares with the master only the constants
of the object dictionary: its SDO server, codecs, scaling and state machine are its own.

A `DrivesOnBus` runs all drives on one connection to the bus, and receives each frame once; `AllDrives` spans buses.
"""

from collections import deque
from collections.abc import Callable, Sequence, Sized
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import can
from canopen.objectdictionary import ObjectDictionary

from canhaptic.canopen import objects
from canhaptic.canopen.data_frame import DataFrame
from canhaptic.canopen.eds import read_dictionary
from canhaptic.canopen.objects import DataType, NmtCommand, NmtState
from canhaptic.signals import Truth
from canhaptic.sim.drive import SimulatedDriveParameters
from canhaptic.sim.drive.can.nmt_slave import (
    HeartbeatConsumer,
    HeartbeatProducer,
    LifeGuard,
    command_for,
)
from canhaptic.sim.drive.can.process_data import Content, Handler, ProcessData
from canhaptic.sim.drive.can.sdo_server import SdoServer
from canhaptic.sim.drive.profile import emergency as emcy
from canhaptic.sim.drive.profile.object_store import ObjectStore
from canhaptic.sim.drive.profile.power_stage import servo_of
from canhaptic.sim.drive.profile.reactions import Reactions
from canhaptic.sim.drive.profile.servo import Motor, Servo
from canhaptic.sim.drive.profile.state_machine import DriveState
from canhaptic.sim.drive.profile.timers import TimedDrives, Timers

if TYPE_CHECKING:
    from canhaptic.sim.drive.can.sensor_node import SensorNode

_COMMUNICATION_OBJECTS: Final = range(0x1000, 0x2000)
_FAULT: Final = 1  # value of 0x6007; used when a dictionary has no such object
_PRE_OPERATIONAL, _STOPPED = 0, 2  # values of 0x1029: where a lost heartbeat leads
_tuple: Final = tuple.__new__  # makes a truth at half the cost of calling its class
_FAULTY: Final = frozenset((DriveState.FAULT_REACTION_ACTIVE, DriveState.FAULT))


class SimulatedDrive:
    """One CiA 402 servo drive with its motor; a `DrivesOnBus` hands it frames and time.

    Args:
        bus: Connection of the drive to the bus.
        node_id: Node ID, 1..127.
        dictionary: Path of its EDS or DCF, or the dictionary read from it.
        motor: Motor that it drives; at rest until the first SYNC in OPERATION ENABLED.
        parameters: Values that the dictionary does not state.
        sample_time_ns: Interval of the SYNCs [ns], until two have arrived and it is measured. A fault reaction or
            quick stop takes 1.5 intervals.

    Attributes:
        nmt_state: NMT state of the drive.
        store: Objects of the drive.
        servo: Power stage of the drive.
        timers: Timers of the drive's own actions.
        on_routes_changed: Called when the set of COB-IDs it listens to may have changed.
        frames_lost: Frames that the bus refused to send.

    Raises:
        DictionaryError: The dictionary cannot be read.
        ParameterError: The rated torque is unknown, or `parameters.objects` names an object that does not exist.
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
        self.frames_lost = 0
        self.nmt_state = NmtState.BOOT_UP
        self._bus = bus
        self._sample_time = sample_time_ns
        absent = parameters.absent_places()
        self.store = store = ObjectStore(dictionary, parameters.object_values(), absent, parameters.refused_values())
        store.guard_storage()
        self.servo, self._sensor = self._servo_and_sensor(motor, parameters)
        self.timers = timers = Timers()
        self.on_routes_changed: Callable[[], None] = lambda: None
        self._emergency_cob_id = store.optional(objects.EMCY_COB_ID, DataType.UNSIGNED32)
        self._emergency = emcy.EmergencyProducer(store, self._send_emergency)
        self._sdo = SdoServer(store, parameters.sdo_size_indicated)
        self._producer = HeartbeatProducer(store, timers, self._send_heartbeat, self._now)
        self._consumer = HeartbeatConsumer(
            store, timers, self._now, self._lose_heartbeat, self._regain_heartbeat, self._change_routes
        )
        self.guard = LifeGuard(store, timers, self._now, self._send_state, self._lose_heartbeat, self._regain_heartbeat)
        self._process_data = ProcessData(
            store, self.servo, timers, self._emergency, parameters, self._send, self._lose, self._change_routes
        )
        self._abort_option = store.find(objects.ABORT_CONNECTION_OPTION)
        self._error_behaviour = store.optional(objects.ERROR_BEHAVIOUR, DataType.UNSIGNED8, 1)
        self._channel = getattr(bus, "channel_id", None)
        self._routes: dict[int, Handler] = {}
        self._are_routes_stale = True
        self._reactions = Reactions(self.servo, self._emergency, timers, self._sync_period, self.servo.settle)
        timers.start(timers.add(self._power_on), 0)

    def _servo_and_sensor(self, motor: Any, parameters: SimulatedDriveParameters) -> "tuple[Servo, SensorNode | None]":
        """Return the power stage, and a force sensor with its own node."""
        servo = servo_of(self.store, motor, parameters)
        if (scales := servo.sensor_on_bus) is None:
            return servo, None
        from canhaptic.sim.drive.can.sensor_node import SensorNode

        return servo, SensorNode(scales, motor.read_force, self._send)

    # --- what a group of drives asks of each ------------------------------------------------------------------------

    def wake(self, now: int) -> None:
        """Power the drive on if it is not yet; called before any frame is handled."""
        if self.timers.earliest == 0:
            self.servo.now = now
            self.timers.fire(0)

    def handler(self, cob_id: int) -> Handler | None:
        """Handler of frames with this COB-ID, valid until the routes change; None if the drive ignores them."""
        if self._are_routes_stale:
            self._build_routes()
        return self._routes.get(cob_id)

    def truth(self) -> Truth:
        """True position and energies of the motor, as of the last SYNC or change of torque."""
        motor = self.servo.motor
        return _tuple(Truth, (motor.position, motor.energy()))

    def inject_fault(self, code: int = 0x5000) -> None:
        """Inject a fault with an error code (0x603F), as if hardware had failed."""
        self.servo.fault_code = code
        self.follow_up()

    @property
    def state(self) -> DriveState:
        """State of the power drive system."""
        return self.servo.state

    @property
    def torque(self) -> float:
        """Torque held at the axis [N*m or N]."""
        return self.servo.torque

    def _now(self) -> int:
        return self.servo.now

    def _send(self, cob_id: int, content: Content) -> None:
        message = DataFrame()
        message.timestamp = self.servo.now * 1e-9
        message.arbitration_id = cob_id
        message.channel = self._channel
        message.data = bytearray(content)
        message.dlc = len(content)
        try:
            self._bus.send(message)
        except can.CanError:
            self.frames_lost += 1

    def _send_emergency(self, content: Content) -> None:
        cob_id = self._emergency_cob_id.number or objects.EMCY_BASE + self.node_id
        may_send = self.nmt_state in (NmtState.PRE_OPERATIONAL, NmtState.OPERATIONAL)
        if may_send and not cob_id & objects.COB_ID_INVALID:
            self._send(cob_id & 0x7FF, content)

    def _send_heartbeat(self) -> None:
        self._send_state(0)

    def _send_state(self, toggle: int) -> None:
        self._send(objects.HEARTBEAT_BASE + self.node_id, bytes((self.nmt_state | toggle,)))

    # --- frames -----------------------------------------------------------------------------------------------------

    def _change_routes(self) -> None:
        self._are_routes_stale = True
        self.on_routes_changed()

    def _build_routes(self) -> None:
        self._are_routes_stale = False
        routes = self._process_data.routes()
        for cob_id, slot in self._consumer.watched().items():
            routes[cob_id] = partial(self._consumer.hear, slot)
        routes[objects.SDO_REQUEST_BASE + self.node_id] = self._on_sdo
        routes[objects.NMT_COB_ID] = self._on_nmt
        if self._sensor is not None:
            sync = objects.SYNC_FRAME_COB_ID
            routes[sync] = partial(self._on_sync_with_sensor, self._sensor, routes.get(sync))
            if self._sensor.request_cob_id is not None:
                routes[self._sensor.request_cob_id] = self._sensor.take_sdo
        self._routes = routes
        self.on_routes_changed()

    def _on_sdo(self, content: Content) -> None:
        if self.nmt_state is NmtState.STOPPED:
            return
        answer = self._sdo.answer(bytes(content))
        if answer is not None:
            self._send(objects.SDO_RESPONSE_BASE + self.node_id, answer)

    def _on_sync_with_sensor(self, sensor: "SensorNode", handler: Handler | None, content: Content) -> None:
        if handler is not None:
            handler(content)
        sensor.take_sync()

    def _on_nmt(self, content: Content) -> None:
        if self._sensor is not None:
            self._sensor.take_nmt(content)
        command = command_for(bytes(content), self.node_id)
        if command is NmtCommand.START:
            self._start()
        elif command is NmtCommand.RESET_NODE:
            self._power_on(self.servo.now)
        elif command is not None:
            self._leave_operational(NmtState.STOPPED if command is NmtCommand.STOP else NmtState.PRE_OPERATIONAL)
            if command is NmtCommand.RESET_COMMUNICATION:
                self.store.reset(_COMMUNICATION_OBJECTS)
                self._emergency.show()
                self._boot()

    # --- NMT --------------------------------------------------------------------------------------------------------

    def _power_on(self, _due: int) -> None:
        self._process_data.stop()
        self.store.reset()
        self._emergency.reset()
        self.servo.reset()
        self.servo.settle()
        self._boot()
        if self._sensor is not None and self._sensor.state is NmtState.BOOT_UP:
            self._sensor.power_on()

    def _boot(self) -> None:
        """Start communication: boot-up, then PRE-OPERATIONAL."""
        self.timers.stop_all()
        self._sdo.reset()
        self._consumer.restart()
        self.guard.restart()
        self.nmt_state = NmtState.BOOT_UP
        self._send_heartbeat()
        self.nmt_state = NmtState.PRE_OPERATIONAL
        self._producer.restart()
        self._reactions.restart()
        self._build_routes()

    def _start(self) -> None:
        if self.nmt_state is not NmtState.OPERATIONAL:
            self.nmt_state = NmtState.OPERATIONAL
            if self.servo.state not in _FAULTY:
                self._emergency.withdraw(emcy.COMMUNICATION)
            self._process_data.start()

    def _leave_operational(self, state: NmtState) -> None:
        if self.nmt_state is NmtState.OPERATIONAL and self.servo.is_powered:
            self._lose(emcy.COMMUNICATION)
        self.nmt_state = state
        self._process_data.stop()

    # --- faults -----------------------------------------------------------------------------------------------------

    def _lose(self, code: int) -> None:
        """React to a lost connection: EMCY, then the reaction of 0x6007."""
        self._emergency.announce(code)
        if code == emcy.SYNC_LOST:  # the drive's own interpolation fails, independent of 0x6007
            self.servo.fault()
            return
        option = self._abort_option
        self.servo.abort_connection(_FAULT if option is None or option.value is None else option.number)

    def _lose_heartbeat(self) -> None:
        self._lose(emcy.HEARTBEAT_LOST)
        behaviour = self._error_behaviour.number
        if self.nmt_state is NmtState.OPERATIONAL and behaviour in (_PRE_OPERATIONAL, _STOPPED):
            self.nmt_state = NmtState.STOPPED if behaviour == _STOPPED else NmtState.PRE_OPERATIONAL
            self._process_data.stop()

    def _regain_heartbeat(self) -> None:
        if self.servo.state not in _FAULTY:
            self._emergency.withdraw(emcy.HEARTBEAT_LOST)

    def _sync_period(self) -> int:
        return self._process_data.sync_period() or self._sample_time

    def follow_up(self) -> None:
        """Act on a change of state: announce faults, time reactions, send event-driven TPDOs."""
        if self._reactions.follow() and self._process_data.is_operational:
            self._process_data.send_events()


class DrivesOnBus(TimedDrives):
    """Simulated drives on one bus connection (a `SimulatedPeer`); they do not receive each other's frames.

    Args:
        bus: The connection that the drives were made with.
        drives: Drives with different node IDs.
    """

    def __init__(self, bus: can.BusABC, drives: Sequence[SimulatedDrive]) -> None:
        self._waiting: Sized = "unknown"  # empty only where the bus shows what waits
        self._take: Callable[[], can.Message | None] = partial(bus.recv, 0.0)
        if isinstance(waiting := getattr(bus, "waiting", None), deque):
            self._waiting, self._take = waiting, waiting.popleft
        self.drives: tuple[SimulatedDrive, ...] = tuple(drives)
        self._asleep = list(self.drives)
        self._hearers: dict[int, tuple[tuple[SimulatedDrive, Handler], ...]] = {}  # by COB-ID
        for drive in self.drives:
            drive.on_routes_changed = self._hearers.clear

    def process(self, now: int, message: can.Message | None = None) -> None:
        """Handle every frame waiting on the bus and every timer due up to `now` [ns].

        Args:
            now: Time [ns].
            message: Frame already received; None if there is none.
        """
        while self._asleep:
            self._asleep.pop(0).wake(now)
        take, waiting = self._take, self._waiting
        while message is not None or (waiting and (message := take()) is not None):
            if not (message.is_extended_id or message.is_remote_frame or message.is_error_frame):
                hearers = self._hearers.get(message.arbitration_id)
                if hearers is None:
                    found = ((drive, drive.handler(message.arbitration_id)) for drive in self.drives)
                    hearers = tuple((drive, handler) for drive, handler in found if handler is not None)
                    self._hearers[message.arbitration_id] = hearers
                for drive, handler in hearers:
                    servo = drive.servo
                    servo.now = now
                    handler(message.data)
                    if servo.has_event or servo.fault_code:
                        drive.follow_up()
            elif message.is_remote_frame and not message.is_extended_id:
                self._pass_request(now, message.arbitration_id)
            message = None
        for drive in self.drives:
            if now >= drive.timers.earliest:
                drive.servo.now = now
                drive.timers.fire(now)
                drive.follow_up()

    def _pass_request(self, now: int, cob_id: int) -> None:
        for drive in self.drives:
            if cob_id == objects.HEARTBEAT_BASE + drive.node_id:
                drive.servo.now = now
                drive.guard.answer()
                drive.follow_up()


class AllDrives(NamedTuple):
    """The drives of several buses."""

    drives: tuple[SimulatedDrive, ...]  # in the order of the axes


Drives = DrivesOnBus | AllDrives
"""Simulated drives of a rig, on one bus or several."""
