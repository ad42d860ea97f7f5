"""A simulated force sensor with its own CAN node: it answers each SYNC with one frame, once it is operational."""

from collections.abc import Callable
from typing import Any, cast

from canopen.objectdictionary import ODVariable

from canhaptic.canopen import objects
from canhaptic.canopen.attached_devices import ForceNode
from canhaptic.canopen.objects import DataType, NmtCommand, NmtState
from canhaptic.sim.drive import MotionScaling
from canhaptic.sim.drive.can.nmt_slave import command_for
from canhaptic.sim.drive.can.process_data import Content
from canhaptic.sim.drive.can.sdo_server import SdoServer
from canhaptic.sim.drive.profile.object_store import ObjectStore, refuse_unless

_DEVICE_TYPE = 404  # CiA profile of transducers
_BY_ITSELF = 255  # its transmission type until a master writes another
_STATES = {NmtCommand.START: NmtState.OPERATIONAL, NmtCommand.STOP: NmtState.STOPPED}


class SensorNode:
    """A force sensor as a node of its own on the bus.

    Args:
        scales: Scaling of the sensor and layout of its frame.
        read: Returns the present reading of the sensor.
        send: Called with COB-ID and content of a frame.

    Attributes:
        state: NMT state; a sensor without a node ID is operational at once.
    """

    def __init__(self, scales: MotionScaling, read: Callable[[], float], send: Callable[[int, Content], None]) -> None:
        self._scales, self._node = scales, cast(ForceNode, scales.force_node)
        self._read, self._send = read, send
        self._zero = 0.0  # force that was taken for zero [N or N*m]
        self.state = NmtState.BOOT_UP
        store = ObjectStore(_transducer(), {})
        self._sdo = SdoServer(store)
        self._type = store.entry(objects.TPDO_COMMUNICATION, DataType.UNSIGNED8, 2)
        for index, signature in (
            (objects.AUTOTARE, objects.TARE_SIGNATURE),
            (objects.AUTOZERO, objects.ZERO_SIGNATURE),
        ):
            entry = store.entry(index, DataType.UNSIGNED32, 1)
            entry.check, entry.changed = refuse_unless(signature.__eq__), self._tare

    @property
    def request_cob_id(self) -> int | None:
        """COB-ID of SDO requests to the sensor; None for a sensor that is not a CANopen node."""
        return None if self._node.node_id is None else objects.SDO_REQUEST_BASE + self._node.node_id

    def take_sdo(self, content: Content) -> None:
        """Answer an SDO request, such as for the device type or the tare (0x6139:01)."""
        answer = None if self.state is NmtState.STOPPED else self._sdo.answer(bytes(content))
        if answer is not None and self._node.node_id is not None:
            self._send(objects.SDO_RESPONSE_BASE + self._node.node_id, answer)

    def _tare(self) -> None:
        self._zero = self._read()

    def power_on(self) -> None:
        """Boot; a CANopen node sends its boot-up message."""
        node = self._node
        if node.node_id is None:
            self.state = NmtState.OPERATIONAL
            return
        self._sdo.reset()
        self.state = NmtState.PRE_OPERATIONAL
        self._send(objects.HEARTBEAT_BASE + node.node_id, bytes((NmtState.BOOT_UP,)))

    def take_nmt(self, content: Content) -> None:
        """Execute an NMT command addressed to the sensor."""
        if self._node.node_id is None or (command := command_for(bytes(content), self._node.node_id)) is None:
            return
        if command in (NmtCommand.RESET_NODE, NmtCommand.RESET_COMMUNICATION):
            self.power_on()
        else:
            self.state = _STATES.get(command, NmtState.PRE_OPERATIONAL)

    def take_sync(self) -> None:
        """Send the present value, cut to its number of bits, so that a running impulse wraps like a counter."""
        is_asked = self._node.node_id is None or self._type.number == objects.SYNCHRONOUS_EVERY_SYNC
        if self.state is not NmtState.OPERATIONAL or not is_asked:
            return
        try:
            scaled = (self._read() - self._zero) / self._scales.force_per_count
            frame = self._node.frame_of(scaled + self._scales.force_offset_counts)
        except (ValueError, OverflowError):  # no number: the frame stays away
            return
        self._send(self._node.frame_id, frame)


def _transducer() -> Any:
    """Dictionary of the transducer: 0x1000, 0x1800, 0x6125 and 0x6139."""
    values = {(objects.DEVICE_TYPE, 0): _DEVICE_TYPE, (objects.TPDO_COMMUNICATION, 2): _BY_ITSELF}
    for index, count in ((objects.TPDO_COMMUNICATION, 2), (objects.AUTOZERO, 1), (objects.AUTOTARE, 1)):
        values |= {(index, 0): count, (index, 1): 0}
    dictionary = {place: ODVariable("Object", *place) for place in values}
    for (index, subindex), variable in dictionary.items():
        is_long = subindex == 1 or index == objects.DEVICE_TYPE
        variable.data_type = DataType.UNSIGNED32 if is_long else DataType.UNSIGNED8
        variable.access_type, variable.default = "rw" if subindex else "ro", values[index, subindex]
    return dictionary
