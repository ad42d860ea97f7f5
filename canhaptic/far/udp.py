"""One UDP socket to one declared peer; nothing that it does can stop or delay a cycle."""

import select
import socket
from collections.abc import Callable, Iterator

from canhaptic.errors import InputError
from canhaptic.far.packet import SIZE

_MOST = 8  # packets taken in one cycle: a peer may be so many times as fast; a flood costs no more


class UdpLink:
    """A connected socket: the kernel drops what any other sender sends.

    Args:
        listen: Own address.
        peer: Address of the other side.

    Raises:
        InputError: The own address cannot be used.
    """

    def __init__(self, listen: tuple[str, int], peer: tuple[str, int]) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.bind(listen)
            self._socket.connect(peer)
        except OSError as error:
            self._socket.close()
            own, other = (":".join(map(str, place)) for place in (listen, peer))
            text = f"far: cannot use {own} towards {other} ({error.strerror or error})"
            raise InputError(f"{text}; give as `listen` an address of this computer that is free") from error
        self._socket.setblocking(False)
        self._receive, self._send, self._has_more = self._socket.recv, self._socket.send, _look_of(self._socket)

    def send(self, data: bytes) -> None:
        """Send a packet, or lose it."""
        try:  # noqa: SIM105 - in each cycle: `suppress` costs a fifth of the call
            self._send(data)
        except OSError:
            pass

    def arrived(self) -> Iterator[bytes]:
        """Yield the packets that have arrived, 8 at most."""
        receive = self._receive
        try:
            yield receive(SIZE + 1)
            for _ in range(_MOST - 1 if self._has_more(0) else 0):
                yield receive(SIZE + 1)
        except OSError:  # none, or an answer that no one listens there
            return

    def wait(self, seconds: float) -> None:
        """Wait until a packet is there, or for a time [s]."""
        select.select([self._socket], [], [], seconds)

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


def _look_of(of: socket.socket) -> Callable[[int], object]:
    """Return what tells whether a socket has more, for a third of what an empty `recv` costs; it may say so wrongly."""
    if not hasattr(select, "poll"):
        return lambda _: True
    poll = select.poll()
    poll.register(of, select.POLLIN)
    return poll.poll
