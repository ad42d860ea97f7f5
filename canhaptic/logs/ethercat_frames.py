"""EtherCAT frames of a capture, read and decoded: pcap and pcapng of any program, also compressed by gzip.

It shares no code with a master or a simulated drive. Each datagram is decoded by itself (ETG.1000.4, 5.4): states and
their refusals, objects by mailbox, process data.
"""

import struct
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Final, NamedTuple

from canhaptic.canopen.code_texts import emcy_text, sdo_abort_text
from canhaptic.errors import LogFormatError
from canhaptic.files import require_regular

_GZIP: Final = b"\x1f\x8b"
_PCAPNG: Final = b"\x0a\x0d\x0d\x0a"
_PCAP: Final = {
    b"\xd4\xc3\xb2\xa1": ("<", 1000), b"\x4d\x3c\xb2\xa1": ("<", 1), b"\xa1\xb2\xc3\xd4": (">", 1000),
    b"\xa1\xb2\x3c\x4d": (">", 1),
}  # fmt: skip
"""First bytes of a pcap -> order of its bytes, and nanoseconds of its unit of time."""
_LITTLE: Final = b"\x4d\x3c\x2b\x1a"  # byte order mark of pcapng
_INTERFACE, _ENHANCED = 1, 6  # blocks
_RESOLUTION: Final = 9  # option of an interface
_LARGEST: Final = 1 << 28  # [bytes] of a capture
_ETHERNET: Final = 1
_ETHERTYPE: Final = b"\x88\xa4"
_FIRST, _HEAD, _TAIL = 16, 10, 2  # [bytes]
_LENGTH, _MORE = 0x7FF, 0x8000
_AL_CONTROL, _AL_STATUS = 0x0120, 0x0130
_ERROR: Final = 0x10
_COE: Final = 3
_MEMORY: Final = 0x1000
COMMANDS: Final = ("NOP", "APRD", "APWR", "APRW", "FPRD", "FPWR", "FPRW", "BRD", "BWR", "BRW", "LRD", "LWR", "LRW",
                   "ARMW", "FRMW")  # fmt: skip
"""Command of a datagram -> its name."""
_READS: Final = frozenset((1, 4, 7))
_WRITES: Final = frozenset((2, 5, 8))
_STATES: Final = {1: "INIT", 2: "PRE-OP", 3: "BOOT", 4: "SAFE-OP", 8: "OP"}


class CapturedFrame(NamedTuple):
    """An Ethernet frame of a capture."""

    time: int  # [ns]
    content: bytes


class FrameDatagram(NamedTuple):
    """One datagram of a frame."""

    command: int
    address: int
    offset: int
    data: bytes
    counter: int


def read_capture(path: str | Path) -> list[CapturedFrame]:
    """Return the Ethernet frames of a capture, in its order.

    Raises:
        LogFormatError: The file is missing, is no capture of Ethernet, or is damaged.
    """
    path = Path(path)
    try:
        require_regular(path)  # a pipe would never answer
        content = path.read_bytes()
        if content[:2] == _GZIP:
            unpacker = zlib.decompressobj(wbits=31)
            content = unpacker.decompress(content, _LARGEST)
            if unpacker.unconsumed_tail or not unpacker.eof:
                raise LogFormatError(
                    f"{path}: got more than {_LARGEST >> 20} MiB or a cut file, expected a whole capture"
                )
    except (OSError, zlib.error) as error:
        raise LogFormatError(f"{path}: cannot be read ({error}); give a pcap or pcapng file") from error
    try:
        if content[:4] == _PCAPNG:
            return list(_of_pcapng(content))
        if content[:4] in _PCAP:
            return list(_of_pcap(content))
    except (struct.error, ValueError) as error:
        raise LogFormatError(f"{path}: is damaged ({error}); record it again") from error
    raise LogFormatError(f"{path}: is no pcap or pcapng; record with tcpdump, Wireshark or --bus-log")


def _of_pcap(content: bytes) -> Iterator[CapturedFrame]:
    order, unit = _PCAP[content[:4]]
    (kind,) = struct.unpack_from(f"{order}I", content, 20)
    if kind != _ETHERNET:
        raise ValueError(f"link type {kind}, expected Ethernet")
    at, head = 24, struct.Struct(f"{order}IIII")
    while at < len(content):
        seconds, rest, size, _ = head.unpack_from(content, at)
        at += head.size
        if at + size > len(content):
            raise ValueError("its last frame is cut")
        yield CapturedFrame(seconds * 1_000_000_000 + rest * unit, content[at : at + size])
        at += size


def _of_pcapng(content: bytes) -> Iterator[CapturedFrame]:
    order = "<" if content[8:12] == _LITTLE else ">"
    units, at = list[tuple[int, int]](), 0  # of each interface: link type, units of time in a second
    while at < len(content):
        kind, size = struct.unpack_from(f"{order}II", content, at)
        if size < 12 or at + size > len(content):
            raise ValueError(f"a block of {size} bytes at {at}")
        body = content[at + 8 : at + size - 4]
        if kind == _INTERFACE:
            units.append((struct.unpack_from(f"{order}H", body)[0], _units_of(order, body)))
        elif kind == _ENHANCED:
            number, high, low, length = struct.unpack_from(f"{order}IIII", body)
            if number >= len(units) or 20 + length > len(body):
                raise ValueError(f"a packet of {length} bytes of interface {number}")
            link, unit = units[number]
            if link == _ETHERNET:
                yield CapturedFrame((high << 32 | low) * 1_000_000_000 // unit, body[20 : 20 + length])
        at += size


def _units_of(order: str, body: bytes) -> int:
    """Return the units of time in a second of an interface; by default a million."""
    at = 8
    while at + 4 <= len(body):
        code, length = struct.unpack_from(f"{order}HH", body, at)
        if code == 0:
            break
        if code == _RESOLUTION and length:
            value = body[at + 4]
            return 1 << (value & 0x7F) if value & 0x80 else int(10 ** (value & 0x7F))
        at += 4 + (length + 3) // 4 * 4
    return 1_000_000


def is_ethercat(frame: bytes) -> bool:
    """Return whether an Ethernet frame is one of EtherCAT."""
    return frame[12:14] == _ETHERTYPE


def datagrams_of(frame: bytes) -> list[FrameDatagram] | None:
    """Return the datagrams of a frame; None where it is no EtherCAT frame, or a damaged one."""
    if not is_ethercat(frame):
        return None
    at, more, found = _FIRST, True, list[FrameDatagram]()
    while more:
        if at + _HEAD + _TAIL > len(frame):
            return None
        command, _, address, offset, length, _ = struct.unpack_from("<BBHHHH", frame, at)
        stop, more = at + _HEAD + (length & _LENGTH), bool(length & _MORE)
        if stop + _TAIL > len(frame):
            return None
        (counter,) = struct.unpack_from("<H", frame, stop)
        found.append(FrameDatagram(command, address, offset, frame[at + _HEAD : stop], counter))
        at = stop + _TAIL
    return found


def command_name(command: int) -> str:
    """Return the name of a command, such as `LRW`; "unknown" for one that no standard names."""
    return COMMANDS[command] if command < len(COMMANDS) else "unknown"


def state_words(status: int) -> str:
    """Return the name of a state in AL status or AL control."""
    return _STATES.get(status & 0x0F, f"{status & 0x0F:#x}")


def datagram_text(of: FrameDatagram, al_text: Callable[[int], str] = lambda _: "") -> str:
    """Return in words what a datagram carries; "" where its name and addresses say it all.

    Args:
        of: The datagram.
        al_text: Returns the words for an AL status code.
    """
    if of.offset == _AL_CONTROL and of.command in _WRITES and of.data:
        return f"asks for {state_words(of.data[0])}"
    if of.offset == _AL_STATUS and of.command in _READS and of.data and of.counter:
        text = f"is in {state_words(of.data[0])}"
        if of.data[0] & _ERROR and len(of.data) >= 6:
            code = int.from_bytes(of.data[4:6], "little")
            text += f", refused or left: AL code {code:#06x} {al_text(code)}".rstrip()
        return text
    if 10 <= of.command <= 12:
        return f"process data of {len(of.data)} bytes"
    if of.offset >= _MEMORY and of.command in (1, 2, 4, 5) and of.counter:
        return mail_text(of.data)
    return ""


def mail_text(mail: bytes) -> str:
    """Return in words a mail of CoE; "" for any other content."""
    if len(mail) < 16 or mail[5] & 0x0F != _COE:
        return ""
    service, command, index, subindex = struct.unpack_from("<HBHB", mail, 6)
    place = f"{index:#06x}:{subindex:02x}"
    if service >> 12 == 1:
        (code,) = struct.unpack_from("<H", mail, 8)
        return f"emergency {code:#06x}: {emcy_text(code)}"
    return _sdo_text(place, command, mail, is_request=service >> 12 == 2) if service >> 12 in (2, 3) else ""


def _sdo_text(place: str, command: int, mail: bytes, *, is_request: bool) -> str:
    if command == 0x80:
        (code,) = struct.unpack_from("<I", mail, 12)
        return f"abort of {place}: {sdo_abort_text(code)} ({code:#010x})"
    if command >> 5 == 2 and is_request:
        return f"reads {place}"
    if command >> 5 == 2 or (command >> 5 == 1 and is_request):
        value = mail[12 : 16 - (command >> 2 & 3 if command & 1 else 0)] if command & 2 else mail[16:]
        return f"{'writes' if is_request else 'is'} {place} = {value.hex()}"
    return f"confirms {place}" if command == 0x60 else "a segment"
