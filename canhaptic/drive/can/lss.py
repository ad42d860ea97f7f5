"""LSS (CiA 305): gives a node ID to one node, selected by its identity or alone on the bus.

Every service is one frame each way. Nodes are configured in NMT stopped; a new node ID takes effect at the next
communication reset and, once stored, at every power-on.
"""

from collections.abc import Callable, Sequence
from typing import Final

from canhaptic.canopen.objects import HEARTBEAT_BASE, NMT_COB_ID, NmtCommand
from canhaptic.drive.can.link import Link
from canhaptic.errors import LinkError

ANSWER = 0x7E4
_SWITCH_GLOBAL, _CONFIGURE_NODE_ID, _STORE = 0x04, 0x11, 0x17
_SELECT, _SELECTED = 0x40, 0x44  # vendor ID, product code, revision, serial number: 0x40 to 0x43
_IDENTIFY, _UNCONFIGURED = 0x4C, 0x50  # nodes without a node ID
_INQUIRE_IDENTITY, _INQUIRE_NODE_ID = 0x5A, 0x5E
_PARTS: Final = 4
_ERRORS: Final = {  # by service and error code
    (_CONFIGURE_NODE_ID, 1): "the node ID is out of its range",
    (_STORE, 1): "it cannot store",
    (_STORE, 2): "its memory failed",
}


class LssMaster:
    """Gives one node its node ID.

    Args:
        link: The bus; nothing else sends on it.
    """

    def __init__(self, link: Link) -> None:
        self._link = link

    def _send(self, service: int, data: bytes) -> None:
        self._link.send(0x7E5, (bytes([service]) + data).ljust(8, b"\0"))

    def _ask(self, service: int, data: bytes = b"", awaited: int | None = None) -> list[bytes]:
        """Send a request; return all answers to it that come in time."""
        answers: list[bytes] = []
        self._link.subscribe(ANSWER, lambda frame: answers.append(bytes(frame)))
        self._send(service, data)
        self._link.pump(self._link.clock.now() + 100_000_000)
        self._link.unsubscribe(ANSWER)
        return [answer for answer in answers if len(answer) == 8 and answer[0] == (awaited or service)]

    def has_unconfigured(self) -> bool:
        """Whether a node without a node ID answers; raise LinkError."""
        return bool(self._ask(_IDENTIFY, awaited=_UNCONFIGURED))

    def select(self, identity: Sequence[int] | None) -> tuple[list[int], int | None]:
        """Stop all nodes and switch one to configuration; return its identity and its node ID.

        Args:
            identity: Vendor ID, product code, revision and serial number; None: the only node on the bus.

        Raises:
            LinkError: No node answers, or several do.
        """
        self._link.send(NMT_COB_ID, bytes([NmtCommand.STOP, 0]))
        self.release()
        if identity is None:
            self._send(_SWITCH_GLOBAL, bytes([1]))
        else:
            for part, value in enumerate(identity[:-1]):
                self._send(_SELECT + part, value.to_bytes(4, "little"))
            if not self._ask(_SELECT + _PARTS - 1, identity[-1].to_bytes(4, "little"), _SELECTED):
                text = ", ".join(f"{value:#x}" for value in identity)
                raise LinkError(f"LSS: no node has the identity {text}; compare all four numbers of its 0x1018")
        node_id = self._only(self._ask(_INQUIRE_NODE_ID))[1]
        parts = [self._only(self._ask(_INQUIRE_IDENTITY + part)) for part in range(_PARTS)]
        return [int.from_bytes(answer[1:5], "little") for answer in parts], None if node_id == 255 else node_id

    @staticmethod
    def _only(answers: list[bytes]) -> bytes:
        if len(answers) != 1:
            seen = f"{len(answers)} nodes answer" if answers else "no node answers; check power, bit rate and cable"
            raise LinkError(f"LSS: {seen}, expected one; leave one alone on the bus, or name it with --identity")
        return answers[0]

    def configure(self, node_id: int) -> None:
        """Give the selected node a node ID; raise LinkError if it refuses."""
        self._confirm(_CONFIGURE_NODE_ID, bytes([node_id]))

    def store(self) -> None:
        """Store the selected node's ID so that it survives power-off; raise LinkError if it refuses."""
        self._confirm(_STORE)

    def _confirm(self, service: int, data: bytes = b"") -> None:
        code = self._only(self._ask(service, data))[1]
        if code:
            text = _ERRORS.get((service, code), f"error code {code}")
            raise LinkError(f"LSS: the node refused: {text}; see its manual, and use the vendor's tool")

    def release(self) -> None:
        """Switch all nodes back to waiting; raise LinkError."""
        self._send(_SWITCH_GLOBAL, bytes([0]))

    def restart(self, node_id: int) -> bool:
        """Reset the communication of all nodes; return whether one boots with this node ID; raise LinkError."""
        seen: list[object] = []
        self._link.subscribe(HEARTBEAT_BASE + node_id, seen.append)
        self._link.send(NMT_COB_ID, bytes([NmtCommand.RESET_COMMUNICATION, 0]))
        return self._link.wait_for(lambda: bool(seen), 5_000_000_000)


def give_node_id(
    link: Link,
    node_id: int,
    identity: Sequence[int] | None,
    confirm: Callable[[str], bool],
    tell: Callable[[str], None],
) -> bool:
    """Give one node its node ID, asking before each step that changes something; return whether it succeeded.

    Args:
        link: The bus.
        node_id: The node ID, 1 to 127.
        identity: Identity of the node; None: it is alone on the bus.
        confirm: Function that returns whether the person agrees.
        tell: Function that reports the findings.

    Raises:
        LinkError: No node answers, or several do, or the node refuses.
    """
    if not confirm("every node of this bus goes to NMT stopped; no drive may be enabled. Go on?"):
        return False
    master = LssMaster(link)
    try:
        found, before = master.select(identity)
        tell(f"  0x1018: {', '.join(f'{part:#010x}' for part in found)}; node ID {before or 'none'}")
        if not confirm(f"give this node the node ID {node_id}?"):
            return False
        master.configure(node_id)
        if confirm("let it store the node ID, over power-off?"):
            master.store()
    finally:
        master.release()
    has_booted = master.restart(node_id)
    tell(f"  node {node_id} " + ("has booted" if has_booted else "did not boot: switch its power off and on"))
    return has_booted
