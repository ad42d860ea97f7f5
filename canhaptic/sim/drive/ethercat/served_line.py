"""The simulated drives of a line behind a network interface, for a master in another process or of another make.

Frames arrive on a raw socket, pass the drives as on a cable, and leave as they come back: what the master's interface
would see of real drives. The drives run in real time.
"""

import select
import socket
from typing import Final

from canhaptic.errors import LinkError
from canhaptic.host import capabilities
from canhaptic.sim.drive.ethercat.cable import Cable

_ETHERCAT: Final = 0x88A4
_LARGEST: Final = 2048  # [bytes]
_OUTGOING: Final = 4  # kind of a packet that this side has sent
_BUFFER: Final = 1 << 20  # [bytes] that wait while this process does


class ServedLine:
    """A cable behind an interface: what arrives there passes its drives.

    Args:
        cable: The drives.
        interface: Name of the network interface, such as one end of a veth pair.

    Raises:
        LinkError: The interface cannot be opened.
    """

    def __init__(self, cable: Cable, interface: str) -> None:
        self._cable, self._interface = cable, interface
        with capabilities.raised():
            try:
                self._socket = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(_ETHERCAT))
                self._socket.bind((interface, _ETHERCAT))
            except (OSError, AttributeError) as error:  # the second where it is not Linux
                if hasattr(self, "_socket"):
                    self._socket.close()
                raise LinkError(capabilities.opening_objection(interface)) from error
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER)
        self._socket.setblocking(False)
        self.next_due = cable.next_due

    def fileno(self) -> int:
        """Return the descriptor on which frames are awaited."""
        return self._socket.fileno()

    def recv(self, timeout: float | None = None) -> bytes | None:
        """Return the next frame of a master, or None when none came within `timeout` [s].

        Raises:
            OSError: The interface is down or gone.
        """
        if timeout and not select.select([self._socket], [], [], timeout)[0]:
            return None
        try:
            frame, (_, _, kind, _, _) = self._socket.recvfrom(_LARGEST)
        except BlockingIOError:
            return None
        return None if kind == _OUTGOING else frame

    def process(self, now: int, frame: bytes | None = None) -> None:
        """Run the drives up to `now` [ns], and pass a frame along them.

        Raises:
            OSError: The interface is down or gone.
        """
        if frame is None:
            self._cable.process(now)
        elif (answer := self._cable.exchange(frame, now)) is not None:
            self._socket.send(answer)

    def shutdown(self) -> None:
        """Close the interface."""
        self._socket.close()
