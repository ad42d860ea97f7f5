"""EtherCAT frames and their datagrams (ETG.1000.4, 5.3), as bytes."""

import struct
from collections.abc import Sequence
from enum import IntEnum
from typing import Final, NamedTuple

_HEAD: Final = struct.Struct("<BBHHHH")  # command, index, address, offset, length and flags, interrupts
_COUNTER: Final = struct.Struct("<H")
_ETHERNET: Final = b"\xff" * 6 + b"\x10" * 6 + b"\x88\xa4"  # to all; the first drive sets bit 1 of the source
_TYPE: Final = 0x1000  # of an EtherCAT frame: datagrams
_LENGTH, _MORE = 0x7FF, 0x8000
_SHORTEST: Final = 60  # [bytes] without the check sum
FIRST: Final = len(_ETHERNET) + 2  # place of the first datagram
HEAD: Final = _HEAD.size
TAIL: Final = _COUNTER.size
_LARGEST: Final = 1498  # [bytes] of all datagrams


class Command(IntEnum):
    """Commands of datagrams that this package sends."""

    READ_AT = 1  # APRD: of the drive at a position
    WRITE_AT = 2  # APWR
    READ = 4  # FPRD: of the drive with a station address
    WRITE = 5  # FPWR
    READ_ALL = 7  # BRD: OR of all drives
    WRITE_ALL = 8  # BWR
    SPREAD = 14  # FRMW: read of one drive, written to all after it


class Datagram(NamedTuple):
    """One datagram: to send, or as it came back."""

    command: int
    address: int
    offset: int
    data: bytes
    counter: int = 0


def frame_of(index: int, datagrams: Sequence[Datagram]) -> bytes:
    """Return the Ethernet frame of datagrams, without its check sum.

    Args:
        index: Number of the frame, 0..255, which every datagram carries.
        datagrams: At least one.
    """
    parts, last = [], len(datagrams) - 1
    for place, (command, address, offset, data, _) in enumerate(datagrams):
        length = len(data) | (_MORE if place < last else 0)
        parts += [_HEAD.pack(command, index, address, offset, length, 0), data, b"\0\0"]
    body = b"".join(parts)
    if len(body) > _LARGEST:
        raise ValueError(f"datagrams of {len(body)} bytes do not fit a frame, which has {_LARGEST}")
    return (_ETHERNET + _COUNTER.pack(_TYPE | len(body)) + body).ljust(_SHORTEST, b"\0")


def answers_of(frame: bytes, index: int, datagrams: Sequence[Datagram]) -> list[Datagram] | None:
    """Return the datagrams that came back; None where the frame is not the answer to these.

    Args:
        frame: What was received.
        index: Number of the frame that was sent.
        datagrams: What was sent.
    """
    at, found = FIRST, list[Datagram]()
    if frame[12:14] != _ETHERNET[12:]:
        return None
    for sent in datagrams:
        stop = at + HEAD + len(sent.data)
        if len(frame) < stop + TAIL:
            return None
        command, number, address, offset, length, _ = _HEAD.unpack_from(frame, at)
        if (command, number, length & _LENGTH) != (sent.command, index, len(sent.data)):
            return None
        found.append(Datagram(command, address, offset, frame[at + HEAD : stop], *_COUNTER.unpack_from(frame, stop)))
        at = stop + TAIL
    return found
