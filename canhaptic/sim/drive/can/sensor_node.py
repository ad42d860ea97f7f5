"""A simulated force sensor with its own CAN node: it answers each SYNC with one frame, once it is operational."""

from collections.abc import Callable

from canopen import ObjectDictionary
from canopen.objectdictionary import ODRecord, ODVariable

from canhaptic.canopen import objects
from canhaptic.canopen.force_node import ForceNode
from canhaptic.canopen.objects import DataType, NmtCommand, NmtState
from canhaptic.sim.drive.can.nmt_slave import command_for
from canhaptic.sim.drive.can.process_data import Content
from canhaptic.sim.drive.can.sdo_server import SdoServer
from canhaptic.sim.drive.profile.object_store import ObjectStore, refuse_unless

_DEVICE_TYPE = 404  # CiA profile of transducers
_BY_ITSELF = 255  # its transmission type until a master writes another
_STATES = {NmtCommand.START: NmtState.OPERATIONAL, NmtCommand.STOP: NmtState.STOPPED}


class SensorNode:
    """A transducer on the bus.

    Args:
        node: Frame of the sensor.
        per_count: Value of one count [N or N*m; of a running impulse N*s or N*m*s].
        offset_counts: Counts at zero.
        read: Returns the present reading of the sensor.
        send: Called with COB-ID and content of a frame.

    Attributes:
        state: NMT state; a sensor without a node ID is operational at once.
    """

    def __init__(
        self,
        node: ForceNode,
        per_count: float,
        offset_counts: float,
        read: Callable[[], float],
        send: Callable[[int, Content], None],
    ) -> None:
        self._node, self._per_count, self._offset = node, per_count, offset_counts
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
        """Answer an SDO request: its device type, and the tare (0x6139:01)."""
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
        """Send its value, modulo its bits: a running impulse wraps as a counter does, a force saturates first."""
        is_asked = self._node.node_id is None or self._type.number == objects.SYNCHRONOUS_EVERY_SYNC
        if self.state is not NmtState.OPERATIONAL or not is_asked:
            return
        try:
            frame = self._node.frame_of((self._read() - self._zero) / self._per_count + self._offset)
        except (ValueError, OverflowError):  # no number: the frame stays away
            return
        self._send(self._node.frame_id, frame)


def _transducer() -> ObjectDictionary:
    """Dictionary of the transducer: 0x1000, 0x1800, 0x6125 and 0x6139."""
    dictionary = ObjectDictionary()  # type: ignore[no-untyped-call]
    device_type = ODVariable("Device type", objects.DEVICE_TYPE)
    device_type.data_type, device_type.access_type, device_type.default = DataType.UNSIGNED32, "ro", _DEVICE_TYPE
    dictionary.add_object(device_type)
    for index in (objects.TPDO_COMMUNICATION, objects.AUTOZERO, objects.AUTOTARE):
        record = ODRecord(f"Record {index:#06x}", index)
        is_pdo = index == objects.TPDO_COMMUNICATION
        members = [(0, DataType.UNSIGNED8, 2 if is_pdo else 1), (1, DataType.UNSIGNED32, 0)]
        for subindex, data_type, default in members + [(2, DataType.UNSIGNED8, _BY_ITSELF)] * is_pdo:
            member = ODVariable(f"Member {subindex}", index, subindex)
            member.data_type, member.access_type, member.default = data_type, "rw" if subindex else "ro", default
            record.add_member(member)
        dictionary.add_object(record)
    return dictionary
