"""Objects of one drive by the mailbox (CoE), as integers: an `ObjectAccess` over a `Segment`."""

from typing import Final

from canhaptic.canopen.objects import DataType, Dictionary
from canhaptic.drive.ethercat.segment import Segment
from canhaptic.drive.profile.torque_axis import COMMANDS, Written, note_write
from canhaptic.errors import SdoError

_SIZES: Final = {
    DataType.BOOLEAN: (1, False),
    **{DataType[f"INTEGER{bits}"]: (bits // 8, True) for bits in range(8, 65, 8)},
    **{DataType[f"UNSIGNED{bits}"]: (bits // 8, False) for bits in range(8, 65, 8)},
}


class CoeAccess:
    """Reads and writes objects of one drive.

    Args:
        segment: Line of the drive.
        drive: Its place on the line.
        dictionary: Gives names, sizes and signs; an object that it lacks is read as unsigned.
        name: Name of the axis, for messages.

    Attributes:
        changes: Writes so far, with the values before; None: not recorded.
    """

    def __init__(self, segment: Segment, drive: int, dictionary: Dictionary, name: str) -> None:
        self._segment, self._drive, self._dictionary, self._name = segment, drive, dictionary, name
        self.changes: list[Written] | None = None

    def read(self, index: int, subindex: int = 0) -> int:
        """Return the value of an object; raise SdoError."""
        try:
            data = self._segment.read(self._drive, index, subindex)
        except SdoError as error:
            raise self._named("read", error) from error
        size, is_signed = self._type_of(index, subindex) or (len(data), False)
        return int.from_bytes(data[:size], "little", signed=is_signed)

    def probe(self, index: int, subindex: int = 0) -> int:
        """Return the value of an object; raise SdoError."""
        return self.read(index, subindex)

    def write(self, index: int, subindex: int, value: int, size: int | None = None) -> None:
        """Write an object of `size` bytes, by default as many as the dictionary says; raise SdoError."""
        length = size or (self._type_of(index, subindex) or (4, False))[0]
        try:
            data = value.to_bytes(length, "little", signed=value < 0)
        except OverflowError as error:
            raise SdoError(
                f"{self._name}: write {self.describe(index, subindex)}: {value} does not fit {length} bytes",
                index, subindex,
            ) from error  # fmt: skip
        if self.changes is not None and index not in COMMANDS:
            note_write(self.changes, Written((index, subindex), None, value, length), self.read)
        try:
            self._segment.write(self._drive, index, subindex, data)
        except SdoError as error:
            raise self._named("write", error) from error

    def describe(self, index: int, subindex: int = 0) -> str:
        """Return an object as `0x6072:00 Max torque`."""
        variable = self._dictionary.get_variable(index, subindex)
        return f"{index:#06x}:{subindex:02x}" + (f" {variable.name}" if variable is not None else "")

    def _type_of(self, index: int, subindex: int) -> tuple[int, bool] | None:
        """Return size [bytes] and sign of an object; None where the dictionary does not say."""
        variable = self._dictionary.get_variable(index, subindex)
        kind = None if variable is None else variable.data_type
        return None if kind is None or kind not in _SIZES else _SIZES[DataType(kind)]

    def _named(self, verb: str, error: SdoError) -> SdoError:
        what = str(error).rpartition(f"{error.subindex:02x}: ")[2]
        text = f"{self._name}: {verb} {self.describe(error.index, error.subindex)}: {what}"
        return SdoError(text, error.index, error.subindex, error.code)
