"""The EEPROM of a simulated EtherCAT drive: slave information (SII; ETG.1000.6, 5.4, and ETG.2010)."""

import struct
from typing import Final, NamedTuple

from canhaptic.canopen.sii import check_sum

_CONFIGURATION_BYTES: Final = 14  # that the check sum covers
_KILOBITS: Final = 15  # size of the memory, minus one
_COE: Final = 4  # mailbox protocol
_END: Final = b"\xff\xff"


class Mailboxes(NamedTuple):
    """Start and length of the mailboxes [bytes]: out to the drive, and in from it."""

    out: int = 0x1000
    out_size: int = 128
    into: int = 0x1080
    into_size: int = 128


MAILBOXES: Final = Mailboxes()
OUTPUT_START: Final = 0x1100  # of the three buffers of sync manager 2
INPUT_START: Final = 0x1400  # of those of sync manager 3
SYNC_MANAGERS: Final = (
    (MAILBOXES.out, MAILBOXES.out_size, 0x26, 1),
    (MAILBOXES.into, MAILBOXES.into_size, 0x22, 2),
    (OUTPUT_START, 0, 0x64, 3),
    (INPUT_START, 0, 0x20, 4),
)
"""Start, length, control byte and kind (mailbox out, in; outputs, inputs) of each sync manager."""


def slave_information(identity: tuple[int, int, int, int], name: str, *, has_information: bool) -> bytes:
    """Return the content of the EEPROM.

    Args:
        identity: Vendor, product, revision and serial number.
        name: Name of the device.
        has_information: Whether the drive answers SDO information.
    """
    head = bytearray(0x80)
    head[0] = 0x80
    head[_CONFIGURATION_BYTES] = check_sum(bytes(head[:_CONFIGURATION_BYTES]))
    struct.pack_into("<IIII", head, 0x10, *identity)
    struct.pack_into("<HHHHH", head, 0x30, *MAILBOXES, _COE)
    struct.pack_into("<HH", head, 0x7C, _KILOBITS, 1)
    text = name.encode("latin-1", errors="replace")[:255]
    general = bytearray(32)
    general[3] = 1  # name: the first string
    general[5] = 0x0D | 2 * has_information  # SDO, PDO assignment and configuration
    managers = b"".join(struct.pack("<HHBBBB", start, size, control, 0, 1, kind) for start, size, control, kind in
                        SYNC_MANAGERS)  # fmt: skip
    return b"".join((
        bytes(head),
        _category(10, bytes((1, len(text))) + text),
        _category(30, bytes(general)),
        _category(40, bytes((1, 2, 3, 0))),
        _category(41, managers),
        _END,
    ))  # fmt: skip


def _category(kind: int, body: bytes) -> bytes:
    body += b"\xff" * (len(body) % 2)
    return struct.pack("<HH", kind, len(body) // 2) + body
