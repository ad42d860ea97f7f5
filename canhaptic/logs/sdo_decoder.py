"""Text for SDO frames, and the objects that they carry; follows one transfer per node (CiA 301, 7.2.4)."""

from collections.abc import Callable
from typing import Final, NamedTuple

from canhaptic.canopen.code_texts import sdo_abort_text

_ABORT: Final = 0x80
_FRAME: Final = 8  # [bytes] of every SDO frame


class Access(NamedTuple):
    """An object whose value a confirmed SDO has shown."""

    object_index: int
    subindex: int
    value: bytes


class SdoDecoder:
    """The SDO traffic of one node.

    Args:
        name_of: Gives the text for (index, subindex).
        value_of: Gives the text for the value of (index, subindex, bytes).
    """

    def __init__(
        self, name_of: Callable[[int, int], str], value_of: Callable[[int, int, bytes], str] | None = None
    ) -> None:
        self._name_of = name_of
        self._value_of = value_of or _plain_value
        self._object = (0, 0)
        self._written = b""

    def request(self, data: bytes) -> str:
        """Text for a frame from client to server (0x600 + node)."""
        if len(data) != _FRAME:
            return f"malformed: {len(data)} bytes instead of {_FRAME}"
        if data[0] == _ABORT:
            return self._abort("client", data)
        specifier = data[0] >> 5
        if specifier == 1:
            return self._write(data)
        if specifier == 2:
            self._object = _object(data)
        segment_texts = {
            0: f"write segment of {self._name()}: {_segment(data)}",
            2: f"read {self._name()}",
            3: f"read next segment of {self._name()}",
            5: f"block upload: {data.hex(' ')}",
            6: f"block download: {data.hex(' ')}",
        }
        return segment_texts.get(specifier, f"unknown command 0x{data[0]:02X}")

    def response(self, data: bytes) -> tuple[str, Access | None]:
        """Text for a frame from server to client (0x580 + node), and the object it confirms, if any."""
        if len(data) != _FRAME:
            return f"malformed: {len(data)} bytes instead of {_FRAME}", None
        if data[0] == _ABORT:
            return self._abort("server", data), None
        specifier = data[0] >> 5
        if specifier == 3:
            return self._confirm(data)
        if specifier == 2:
            return self._value(data)
        segment_texts = {
            0: f"segment of {self._name()}: {_segment(data)}",
            1: f"segment of {self._name()} taken",
        }
        return segment_texts.get(specifier, f"block transfer: {data.hex(' ')}"), None

    def _write(self, data: bytes) -> str:
        self._object = _object(data)
        if not data[0] & 0x02:
            self._written = b""
            size = f", {int.from_bytes(data[4:], 'little')} bytes" if data[0] & 0x01 else ""
            return f"write {self._name()} in segments{size}"
        self._written = _expedited(data)
        return f"write {self._name()} = {self._value_of(*self._object, self._written)}"

    def _confirm(self, data: bytes) -> tuple[str, Access | None]:
        matches = _object(data) == self._object
        self._object = _object(data)
        access = Access(*self._object, self._written) if matches and self._written else None
        self._written = b""
        return f"written {self._name()}", access

    def _value(self, data: bytes) -> tuple[str, Access | None]:
        self._object = _object(data)
        if not data[0] & 0x02:
            size = f", {int.from_bytes(data[4:], 'little')} bytes" if data[0] & 0x01 else ""
            return f"{self._name()} follows in segments{size}", None
        value = _expedited(data)
        return f"{self._name()} = {self._value_of(*self._object, value)}", Access(*self._object, value)

    def _abort(self, side: str, data: bytes) -> str:
        self._object = _object(data)
        self._written = b""
        code = int.from_bytes(data[4:8], "little")
        return f"abort by {side} of {self._name()}: 0x{code:08X} {sdo_abort_text(code)}"

    def _name(self) -> str:
        return self._name_of(*self._object)


def _object(data: bytes) -> tuple[int, int]:
    return int.from_bytes(data[1:3], "little"), data[3]


def _expedited(data: bytes) -> bytes:
    """The value of an expedited transfer; all four bytes when its size is not indicated (0x22, 0x42)."""
    return data[4 : 8 - (data[0] >> 2 & 0x03)]


def _segment(data: bytes) -> str:
    last = ", last" if data[0] & 0x01 else ""
    return f"{data[1 : 8 - (data[0] >> 1 & 0x07)].hex(' ')}{last}"


def _plain_value(index: int, subindex: int, value: bytes) -> str:
    del index, subindex
    return f"0x{int.from_bytes(value, 'little'):0{2 * len(value)}X}"
