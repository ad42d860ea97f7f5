"""A session with a far side: it begins with fresh random numbers of both, and ends with silence or a stop.

A restart of either side, an old packet, a wrong key and an own packet that came back all fail the same test: the tag of
the session. The totals of a session are never continued in another one. Nothing here knows a socket or a clock: time is
counted in sample times.
"""

from collections.abc import Callable
from hashlib import blake2s
from typing import Any, Final

from canhaptic.far.packet import HELLO, ROLE, STOPPING, Packet, pack, sent_in, unpack

_OPEN: Final = b"canhaptic, loopback: no secret"
"""Key of a link on the loopback that declares none: its tags are checksums."""
_HELLO_EVERY: Final = 20  # sample times
_KEPT: Final = (1 << 62) - 1
"""Bits of the number of a session that a log keeps."""
_LAST: Final = (1 << 32) - 2
"""Largest number of a packet of a session, which a packet has 32 bits for: 49 days at 1 kHz."""
_TIMES: Final = 1024  # packets whose time of sending is kept, for the round trip


class Session:
    """Packets of one link, and what is known of it.

    Args:
        secret: Key that both sides share; empty on the loopback.
        silence: Sample times without a new authentic packet after which the session ends.
        most_owed: Largest total received, less the total sent, that counts [pJ].
        fresh: Returns a random number of 63 bits, not 0.
        send: Hands bytes to the network.

    Attributes:
        is_alive: Whether a session is alive.
        refused: Packets dropped: of strangers, mutated, of another session, own ones that came back.
        heard: Authentic packets of this session.
        seen: Largest `seq` among them.
        lost: Packets of it that have not arrived so far.
        round_trip: Newest time to the other side and back [sample times]; -1: not known.
        sessions: Sessions that have begun.
        most_received: Largest total sent by the other side in any authentic packet of this session [pJ].
        most_sent: Largest total of this side that was handed to the network in it [pJ].
    """

    def __init__(
        self, secret: bytes, silence: int, most_owed: float, fresh: Callable[[], int], send: Callable[[bytes], None]
    ) -> None:
        self._secret, self._silence, self._most_owed = secret or _OPEN, silence, most_owed
        self._fresh, self._send, self._closed = fresh, send, 0.0
        self._key, self._id, self._role, self._own, self._other = b"", 0, 0, fresh(), 0
        self._id_bytes = b""
        self.is_alive = False
        self.refused = self.heard = self.sessions = self.most_received = self.most_sent = 0
        self.seen = self._first = self.round_trip = -1
        self._seq = self._quiet = self._now = self._greet_at = 0
        self._sent_at = [0] * _TIMES

    @property
    def number(self) -> int:
        """Number of the session, the same on both sides; 0 without one."""
        return self._id & _KEPT if self.is_alive else 0

    @property
    def is_greeted(self) -> bool:
        """Whether the other side asks for a new session."""
        return not self.is_alive and self._other != 0

    @property
    def next_sequence(self) -> int:
        """Number of the packet that `say` sends next; -1 without a session."""
        return self._seq if self.is_alive else -1

    @property
    def lost(self) -> int:
        """Packets of this session that were sent and have not arrived."""
        return max(0, self.seen - self._first + 1 - self.heard) if self.heard else 0

    @property
    def supplied(self) -> float:
        """Energy received in all sessions less what was sent, by the bytes of the packets [pJ]."""
        return self._closed + min(self.most_received, self.most_sent + self._most_owed) - self.most_sent

    def take(self, data: bytes, *, may_begin: bool) -> Packet | None:
        """Return a packet of the session that is newer in some part; None for all others.

        Args:
            data: Bytes that arrived.
            may_begin: Whether this side is ready for a new session.
        """
        if self.is_alive:
            return self._heard(data)
        if may_begin and self._other and (packet := self._begun(data)) is not None:
            return packet
        hello = unpack(data, self._secret)
        if hello is None or not hello.flags & HELLO or hello.sent in (0, self._own):
            self.refused += 1
            return None
        self._other = hello.sent
        if may_begin and hello.received == self._own:
            self._begin()
        return None

    def _keys(self) -> tuple[bytes, int, int]:
        """Return key, number and own role of the session of both random numbers."""
        both = b"".join(number.to_bytes(8, "little") for number in sorted((self._own, self._other)))
        key = blake2s(both, key=self._secret).digest()
        return key, int.from_bytes(blake2s(key, digest_size=8).digest(), "little"), int(self._own > self._other)

    def _begin(self) -> None:
        self._key, self._id, self._role = self._keys()
        self._id_bytes = self._id.to_bytes(8, "little")
        self.is_alive, self._quiet, self.seen, self._seq, self.heard = True, 0, -1, 0, 0
        self.round_trip = self._first = -1
        self.sessions += 1

    def _begun(self, data: bytes) -> Packet | None:
        """Begin the session that the other side has begun already, if a packet of it proves that."""
        key, number, _ = self._keys()
        packet = unpack(data, key)
        if packet is None or packet.session != number:
            return None
        self._begin()
        return self._heard(data)

    def _heard(self, data: bytes) -> Packet | None:
        of_session = data[8:16] == self._id_bytes  # before the tag, which costs more to look at
        packet = unpack(data, self._key) if of_session else None
        if packet is None or packet.flags & ROLE == self._role:
            self.refused += 1
            return None
        flags, seq, _, _, _, _, _, _, seen, _, _ = packet
        if (sent := sent_in(data)) > self.most_received:
            self.most_received = sent
        if seq < self._first or self._first < 0:
            self._first = seq
        self.heard += 1
        if flags & STOPPING:
            self.end()
        if seq > self.seen:  # one that is sent again keeps no session alive
            self.seen, self._quiet = seq, 0
            if self._seq - _TIMES < seen < self._seq:
                self.round_trip = self._now - self._sent_at[seen % _TIMES]
        return packet

    def pass_time(self, periods: int) -> None:
        """Let sample times pass; the session ends after too many without a packet, and before its numbers do."""
        self._now += periods
        self._quiet += periods
        if self.is_alive and (self._quiet > self._silence or self._seq > _LAST):
            self.end()

    def end(self) -> None:
        """End the session: its key is forgotten, and the next one needs new random numbers of both."""
        self._closed = self.supplied
        self.is_alive, self._key, self._own, self._other = False, b"", self._fresh(), 0
        self.most_received = self.most_sent = 0

    def say(self, packet: tuple[Any, ...], *, may_begin: bool = True) -> None:
        """Send a packet of the session; without one, a greeting every 20 sample times.

        Args:
            packet: What this side says, as the fields of a `Packet`.
            may_begin: Whether it is ready for a new session; only then a greeting answers that of the other side.
        """
        if not self.is_alive:
            if self._now >= self._greet_at:
                self._greet_at = self._now + _HELLO_EVERY
                heard = self._other if may_begin else 0
                self._send(pack(Packet(HELLO, 0, 0, self._own, heard, 0, 0.0, 0.0, 0), self._secret))
            return
        seq = self._seq
        self._seq, self._sent_at[seq % _TIMES] = seq + 1, self._now
        seen = self.seen if self.seen > 0 else 0
        flags, _, _, sent, received, wanted, position, velocity, _, wall, damping = packet
        known = flags | self._role, seq, self._id, sent, received, wanted, position, velocity, seen, wall, damping
        data = pack(known, self._key)
        if (told := sent_in(data)) > self.most_sent:
            self.most_sent = told
        self._send(data)
