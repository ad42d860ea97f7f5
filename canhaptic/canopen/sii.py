"""Reader of EtherCAT slave information (SII; ETG.1000.6, 5.4, and ETG.2010): what the EEPROM of a drive states.

It names the device and its fixed process data, and never its objects: those the drive itself tells.
"""

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from canhaptic.canopen.eds import dictionary_content
from canhaptic.canopen.esi import EsiDictionary, add_process_data
from canhaptic.errors import DictionaryError

_CONFIGURATION: Final = 14  # [bytes] that the check sum covers
_POLYNOMIAL: Final = 0x07
_IDENTITY: Final = 0x10
_CATEGORIES: Final = 0x80
_STRINGS, _TX_PDO, _RX_PDO, _END = 10, 50, 51, 0xFFFF
_PDO: Final = struct.Struct("<HBBBBH")  # index, entries, sync manager, DC, name, flags
_ENTRY: Final = struct.Struct("<HBBBBH")  # index, subindex, name, type, bits, flags
_NO_MANAGER: Final = 0xFF
_PDOS: Final = {_RX_PDO: range(0x1600, 0x1800), _TX_PDO: range(0x1A00, 0x1C00)}


def is_sii(path: Path) -> bool:
    """Return whether a file is named as the content of an EEPROM: `.bin`, or that compressed by gzip."""
    return path.name.lower().removesuffix(".gz").endswith(".bin")


def check_sum(content: bytes) -> int:
    """Return the CRC-8 of the configuration area, from 0xFF."""
    crc = 0xFF
    for byte in content:
        crc ^= byte
        for _ in range(8):
            crc = ((crc << 1) ^ _POLYNOMIAL) & 0xFF if crc & 0x80 else crc << 1
    return crc


def read_sii(path: str | Path) -> EsiDictionary:
    """Return the device of an EEPROM, with the process data that it lists.

    Args:
        path: The content of the EEPROM, or one compressed by gzip.

    Raises:
        DictionaryError: The file cannot be read, is too short, or its check sum is wrong.
    """
    path = Path(path)
    content = dictionary_content(path)
    if len(content) < _CATEGORIES:
        raise DictionaryError(f"{path}: got {len(content)} bytes, expected the content of an EEPROM (SII), 128 or more")
    found, stated = check_sum(content[:_CONFIGURATION]), content[_CONFIGURATION]
    if found != stated:
        raise DictionaryError(
            f"{path}: check sum: got {stated:#04x}, expected {found:#04x}; the EEPROM is empty or damaged: write it "
            "again with the vendor's tool"
        )
    vendor, product, revision, _ = struct.unpack_from("<IIII", content, _IDENTITY)
    categories = dict(_categories(content))
    device = EsiDictionary((vendor, product, revision), _title(categories.get(_STRINGS, b"")))
    for kind, indices in _PDOS.items():
        pdos = [of for of in _pdos(categories.get(kind, b"")) if of[0] in indices]
        add_process_data(device, pdos, is_output=kind == _RX_PDO)
    return device


def _categories(content: bytes) -> Iterator[tuple[int, bytes]]:
    at = _CATEGORIES
    while at + 4 <= len(content):
        kind, words = struct.unpack_from("<HH", content, at)
        if kind == _END or at + 4 + 2 * words > len(content):
            return
        yield kind, content[at + 4 : at + 4 + 2 * words]
        at += 4 + 2 * words


def _title(strings: bytes) -> str:
    """Return the first string; "" without a readable one."""
    text = strings[2 : 2 + strings[1]].decode("latin-1") if len(strings) > 1 and strings[0] else ""
    return text if text.isprintable() else ""


def _pdos(body: bytes) -> Iterator[tuple[int, list[int], bool]]:
    """Yield index, mappings and assignment of each PDO of a category."""
    at = 0
    while at + _PDO.size <= len(body):
        index, count, manager, _, _, _ = _PDO.unpack_from(body, at)
        at += _PDO.size
        rows = [
            _ENTRY.unpack_from(body, at + n * _ENTRY.size) for n in range(min(count, (len(body) - at) // _ENTRY.size))
        ]
        at += count * _ENTRY.size
        yield index, [of << 16 | sub << 8 | bits for of, sub, _, _, bits, _ in rows], manager != _NO_MANAGER
