"""One struct codec per PDO: its bytes as one image, so that no value is ever torn and no offset can shift."""

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from canhaptic.canopen.objects import DataType
from canhaptic.errors import DictionaryError

_UNSIGNED_FORMATS: Final = {8: "B", 16: "H", 32: "I", 64: "Q"}
_LONGEST: Final = 64  # bits of a classic CAN frame


@dataclass(frozen=True, slots=True)
class MappedObject:
    """One entry of a PDO mapping (CiA 301, 7.5.2.36)."""

    index: int
    subindex: int
    bits: int
    signed: bool = False

    @property
    def entry(self) -> int:
        """The UNSIGNED32 of the mapping object: index, subindex, length in bits."""
        return self.index << 16 | self.subindex << 8 | self.bits

    @property
    def data_type(self) -> DataType:
        """The integer type of this length and sign."""
        return DataType[f"{'INTEGER' if self.signed else 'UNSIGNED'}{self.bits}"]

    def __str__(self) -> str:
        """`0x6064:00/32`."""
        return f"{self.index:#06x}:{self.subindex:02x}/{self.bits}"


def decode_entry(entry: int) -> MappedObject:
    """Return the mapped object of an UNSIGNED32 mapping entry; its sign is not in there."""
    return MappedObject(entry >> 16, entry >> 8 & 0xFF, entry & 0xFF)


def codec(entries: Sequence[MappedObject], wanted: Sequence[int]) -> struct.Struct:
    """Return the struct of a PDO that yields, in the order of the PDO, the values of the wanted indices.

    Args:
        entries: Mapped objects, in order.
        wanted: Indices to decode; the bytes of others are skipped.

    Raises:
        DictionaryError: A wanted object is not byte-aligned or of an odd length, or the PDO is longer than 8 bytes.
    """
    layout, offset, skipped = "<", 0, 0
    for entry in entries:
        if entry.index in wanted:
            if skipped % 8 or entry.bits not in _UNSIGNED_FORMATS:
                raise DictionaryError(f"mapped object {entry} at bit {offset} is not a byte-aligned integer; map it so")
            letter = _UNSIGNED_FORMATS[entry.bits]
            layout += f"{skipped // 8}x" + (letter.lower() if entry.signed else letter)
            skipped = 0
        else:
            skipped += entry.bits
        offset += entry.bits
    if offset > _LONGEST or offset % 8:
        raise DictionaryError(f"a PDO of {offset} bits cannot be decoded, expected whole bytes up to {_LONGEST} bits")
    return struct.Struct(f"{layout}{skipped // 8}x")
