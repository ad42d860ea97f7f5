"""A simulated force sensor with a node of its own: it answers each SYNC with one frame, once it is operational."""

from collections.abc import Callable

from canhaptic.canopen.force_node import ForceNode
from canhaptic.canopen.objects import HEARTBEAT_BASE, NmtCommand, NmtState
from canhaptic.sim.drive.can.nmt_slave import command_for
from canhaptic.sim.drive.can.process_data import Content

_STATES = {NmtCommand.START: NmtState.OPERATIONAL, NmtCommand.STOP: NmtState.STOPPED}


class SensorNode:
    """A transducer on the bus.

    Args:
        node: Its frame.
        per_count: Of one count [N or N*m; of a running impulse N*s or N*m*s].
        offset_counts: Counts at zero.
        read: Returns what the sensor shows now.
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
        self.state = NmtState.BOOT_UP

    def power_on(self) -> None:
        """Boots; a CANopen node says so."""
        node = self._node
        if node.node_id is None:
            self.state = NmtState.OPERATIONAL
            return
        self.state = NmtState.PRE_OPERATIONAL
        self._send(HEARTBEAT_BASE + node.node_id, bytes((NmtState.BOOT_UP,)))

    def take_nmt(self, content: Content) -> None:
        """Follows an NMT command that is for it."""
        if self._node.node_id is None or (command := command_for(bytes(content), self._node.node_id)) is None:
            return
        if command in (NmtCommand.RESET_NODE, NmtCommand.RESET_COMMUNICATION):
            self.power_on()
        else:
            self.state = _STATES.get(command, NmtState.PRE_OPERATIONAL)

    def take_sync(self) -> None:
        """Sends its value, modulo its bits: a running impulse wraps as a counter does, a force is cut before."""
        if self.state is not NmtState.OPERATIONAL:
            return
        node, counts = self._node, round(self._read() / self._per_count + self._offset)
        size = node.bits // 8
        value = (counts % (1 << node.bits)).to_bytes(size, node.order)
        self._send(node.frame_id, bytes(node.first_byte) + value + bytes(node.frame_length - node.end))
