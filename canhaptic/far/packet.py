"""One packet to a far side: 80 bytes, of which the last 16 are a tag over the others.

    "CH" version flags seq:u32 session:u64 sent:i64 received:i64 wanted:i64
    position:f64 velocity:f32 seen:u32 wall:f32 damping:f32 tag:16                             (little-endian)

Energies are totals of the session in whole picojoules. The flags hold the role, which is under the tag: a packet that
comes back to its sender is of its own role and is dropped. `seen` is the largest `seq` of the other side,
and `wall` where the sender has found one, if a flag says on which side of it the sender is. A program (`World`)
says the place and speed of its wall in `position` and `velocity`, its stiffness in `wall` and its damping in `damping`;
a rig tells it in `wall` the torque that acts.

The tag is keyed BLAKE2s. A session has a key of its own, made of the shared key and of fresh random numbers of both.
"""

import struct
from hashlib import blake2s
from hmac import compare_digest
from math import isfinite
from typing import Any, Final, NamedTuple

from canhaptic.kernels import new

SIZE: Final = 80
_VERSION: Final = 1
_BODY: Final = struct.Struct("<2sBBIQqqqdfIff")
_TAG: Final = 16
_MOST: Final = (1 << 63) - 1
ROLE, HELLO, READY, STOPPING, BELOW, ABOVE, TO_POINT = 1, 2, 4, 8, 16, 32, 64
"""Bits of the flags: role of the sender, packet of the handshake, sender has earned its start, sender stops, sender has
found a wall and is below it, or above it; what a program asks for is a spring to a point."""


class Packet(NamedTuple):
    """What one side says to the other; energies in [pJ]."""

    flags: int
    seq: int
    session: int
    sent: int  # of a HELLO: random number of the sender
    received: int  # of a HELLO: random number that it has seen of the other side; 0: none
    wanted: int
    position: float  # [m or rad]
    velocity: float  # [m/s or rad/s]
    seen: int
    wall: float = 0.0  # [m or rad]
    damping: float = 0.0  # of the wall of a program [N*s/m or N*m*s/rad]


def pack(packet: tuple[Any, ...], key: bytes) -> bytes:
    """Return the bytes of a packet, given as a `Packet` or a tuple of its fields, with their tag."""
    body = _BODY.pack(b"CH", _VERSION, *packet)
    return body + blake2s(body, digest_size=_TAG, key=key).digest()


def unpack(data: bytes, key: bytes) -> Packet | None:
    """Return an authentic packet; None for any other bytes, also for numbers that no packet may have."""
    if len(data) != SIZE or data[:3] != b"CH\x01":
        return None
    if not compare_digest(blake2s(data[:-_TAG], digest_size=_TAG, key=key).digest(), data[-_TAG:]):
        return None
    fields = _BODY.unpack_from(data)[2:]
    _, _, _, sent, received, wanted, position, velocity, _, wall, damping = fields
    if sent < 0 or received < 0 or wanted < 0 or not isfinite(position + velocity + wall + damping):
        return None
    return new(Packet, fields)


def whole(total: float) -> int:
    """Return a total [pJ] as a packet holds it."""
    return min(int(total), _MOST)


def sent_in(data: bytes) -> int:
    """Return the total sent [pJ] that bytes of a packet claim, read apart from `Packet`."""
    return int.from_bytes(data[16:24], "little", signed=True)
