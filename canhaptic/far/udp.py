"""One UDP socket to one declared peer; nothing that it does can stop or delay a cycle."""

import socket
from collections.abc import Iterator
from contextlib import suppress

from canhaptic.errors import InputError
from canhaptic.far.packet import SIZE

_MOST = 16  # packets taken in one cycle


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

    def send(self, data: bytes) -> None:
        """Send a packet, or lose it."""
        with suppress(OSError):
            self._socket.send(data)

    def arrived(self) -> Iterator[bytes]:
        """Yield the packets that have arrived, 16 at most."""
        for _ in range(_MOST):
            try:
                yield self._socket.recv(SIZE + 1)
            except OSError:  # none, or an answer that no one listens there
                return

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()
