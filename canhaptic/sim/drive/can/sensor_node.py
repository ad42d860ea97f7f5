"""A simulated force sensor with a node of its own: it answers each SYNC with one frame, once it is operational."""

from collections.abc import Callable

from canopen import ObjectDictionary
from canopen.objectdictionary import ODRecord, ODVariable

from canhaptic.canopen.force_node import ForceNode
from canhaptic.canopen.objects import (
    AUTOTARE,
    DEVICE_TYPE,
    HEARTBEAT_BASE,
    SDO_REQUEST_BASE,
    SDO_RESPONSE_BASE,
    TARE_SIGNATURE,
    DataType,
    NmtCommand,
    NmtState,
    SdoAbort,
)
from canhaptic.sim.drive.can.nmt_slave import command_for
from canhaptic.sim.drive.can.process_data import Content
from canhaptic.sim.drive.can.sdo_server import SdoServer
from canhaptic.sim.drive.profile.object_store import ObjectStore

_DEVICE_TYPE = 404  # CiA profile of transducers
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
        autotare = store.entry(AUTOTARE, DataType.UNSIGNED32, 1)
        autotare.check, autotare.changed = self._refuse_signature, self._tare

    @property
    def request_cob_id(self) -> int | None:
        """COB-ID of SDO requests to it; None for a sensor that is no CANopen node."""
        return None if self._node.node_id is None else SDO_REQUEST_BASE + self._node.node_id

    def take_sdo(self, content: Content) -> None:
        """Answer an SDO request: its device type, and the tare (0x6139:01)."""
        answer = None if self.state is NmtState.STOPPED else self._sdo.answer(bytes(content))
        if answer is not None and self._node.node_id is not None:
            self._send(SDO_RESPONSE_BASE + self._node.node_id, answer)

    @staticmethod
    def _refuse_signature(value: int) -> SdoAbort | None:
        return None if value == TARE_SIGNATURE else SdoAbort.VALUE_RANGE

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
        self._send(HEARTBEAT_BASE + node.node_id, bytes((NmtState.BOOT_UP,)))

    def take_nmt(self, content: Content) -> None:
        """Follow an NMT command addressed to it."""
        if self._node.node_id is None or (command := command_for(bytes(content), self._node.node_id)) is None:
            return
        if command in (NmtCommand.RESET_NODE, NmtCommand.RESET_COMMUNICATION):
            self.power_on()
        else:
            self.state = _STATES.get(command, NmtState.PRE_OPERATIONAL)

    def take_sync(self) -> None:
        """Send its value, modulo its bits: a running impulse wraps as a counter does, a force saturates first."""
        if self.state is not NmtState.OPERATIONAL:
            return
        node = self._node
        try:
            counts = round((self._read() - self._zero) / self._per_count + self._offset)
        except (ValueError, OverflowError):  # no number: the frame stays away
            return
        size = node.bits // 8
        value = (counts % (1 << node.bits)).to_bytes(size, node.order)
        self._send(node.frame_id, bytes(node.first_byte) + value + bytes(node.frame_length - node.end))


def _transducer() -> ObjectDictionary:
    """Dictionary of the transducer: 0x1000 and 0x6139."""
    dictionary = ObjectDictionary()  # type: ignore[no-untyped-call]
    device_type = ODVariable("Device type", DEVICE_TYPE)
    device_type.data_type, device_type.access_type, device_type.default = DataType.UNSIGNED32, "ro", _DEVICE_TYPE
    dictionary.add_object(device_type)
    autotare = ODRecord("AI autotare", AUTOTARE)
    for subindex, data_type, default in ((0, DataType.UNSIGNED8, 1), (1, DataType.UNSIGNED32, 0)):
        member = ODVariable(f"Member {subindex}", AUTOTARE, subindex)
        member.data_type, member.access_type, member.default = data_type, "ro" if subindex == 0 else "rw", default
        autotare.add_member(member)
    dictionary.add_object(autotare)
    return dictionary
