"""One SDO transfer of a client as the frames it sends and takes (CiA 301, 7.2.4.3): no bus, no waiting, no clock.

A transfer is a generator: it yields a request and is sent the answer to it, until it returns what was uploaded.
"""

from collections.abc import Generator
from typing import Final

ABORT: Final = 0x80  # command specifier of an abort, either way
FRAME_LENGTH: Final = 8
_LARGEST: Final = 1 << 16  # [bytes] of one object; a server that goes on is broken
_SPECIFIER: Final = 0xE0
_TOGGLE: Final = 0x10
_EXPEDITED: Final = 0x02
_SIZE_INDICATED: Final = 0x01
_LAST: Final = 0x01
_UPLOAD, _DOWNLOAD = 0x40, 0x20  # requests to initiate; the answers have 0x40 and 0x60
_UPLOAD_ANSWER, _DOWNLOAD_ANSWER = 0x40, 0x60
_UPLOAD_SEGMENT, _DOWNLOAD_SEGMENT = 0x60, 0x00  # requests; the answers have 0x00 and 0x20

Transfer = Generator[bytes, bytes, bytes]


class ProtocolError(Exception):
    """An answer that is none to the request; its text says what came."""


def address(index: int, subindex: int) -> bytes:
    """Return an object as requests and answers name it."""
    return index.to_bytes(2, "little") + bytes([subindex])


def upload(index: int, subindex: int) -> Transfer:
    """Return the transfer that reads an object; its value is the bytes of the object."""
    answer = yield bytes([_UPLOAD]) + address(index, subindex) + bytes(4)
    _require(answer, _UPLOAD_ANSWER)
    if answer[0] & _EXPEDITED:
        unused = answer[0] >> 2 & 3 if answer[0] & _SIZE_INDICATED else 0
        return answer[4 : 8 - unused]
    size = int.from_bytes(answer[4:8], "little") if answer[0] & _SIZE_INDICATED else None
    data, toggle = b"", 0
    while True:
        answer = yield bytes([_UPLOAD_SEGMENT | toggle]) + bytes(7)
        _require(answer, 0x00, toggle)
        data += answer[1 : 8 - (answer[0] >> 1 & 7)]
        if answer[0] & _LAST:
            break
        if len(data) > _LARGEST:
            raise ProtocolError(f"more than {_LARGEST} bytes")
        toggle ^= _TOGGLE
    if size is not None and size != len(data):
        raise ProtocolError(f"{len(data)} of {size} announced bytes came")
    return data


def download(index: int, subindex: int, data: bytes) -> Transfer:
    """Return the transfer that writes an object; its value is empty."""
    head = address(index, subindex)
    if 1 <= len(data) <= 4:
        unused = 4 - len(data)
        answer = yield bytes([_DOWNLOAD | unused << 2 | _EXPEDITED | _SIZE_INDICATED]) + head + data.ljust(4, b"\0")
        _require(answer, _DOWNLOAD_ANSWER)
        return b""
    answer = yield bytes([_DOWNLOAD | _SIZE_INDICATED]) + head + len(data).to_bytes(4, "little")
    _require(answer, _DOWNLOAD_ANSWER)
    toggle = 0
    for start in range(0, max(1, len(data)), 7):
        piece = data[start : start + 7]
        is_last = start + 7 >= len(data)
        answer = yield bytes([_DOWNLOAD_SEGMENT | toggle | 7 - len(piece) << 1 | is_last]) + piece.ljust(7, b"\0")
        _require(answer, 0x20, toggle)
        toggle ^= _TOGGLE
    return b""


def initiates(request: bytes) -> bool:
    """Whether a request begins a transfer, and so may be repeated when no answer comes."""
    return request[0] & _SPECIFIER in (_UPLOAD, _DOWNLOAD)


def first_answer(request: bytes) -> bytes:
    """Returns how the first answer to a request begins, unless it is an abort: specifier and object."""
    specifier = _UPLOAD_ANSWER if request[0] & _SPECIFIER == _UPLOAD else _DOWNLOAD_ANSWER
    return bytes([specifier]) + request[1:4]


def may_answer(answer: bytes | bytearray, request: bytes, of_object: bytes) -> bool:
    """Whether a frame of a server may answer a request: of the same kind, and of the same object if it names one.

    The first answer names its object and those to segments do not; an abort always does.
    """
    is_first = answer[0] & _SPECIFIER in (_UPLOAD_ANSWER, _DOWNLOAD_ANSWER)
    if answer[0] == ABORT or (is_first and initiates(request)):
        return bytes(answer[1:4]) == of_object
    return not is_first and not initiates(request)


def abort(index: int, subindex: int, code: int) -> bytes:
    """Return the frame that ends a transfer."""
    return bytes([ABORT]) + address(index, subindex) + code.to_bytes(4, "little")


def _require(answer: bytes, specifier: int, toggle: int | None = None) -> None:
    if answer[0] & _SPECIFIER != specifier:
        raise ProtocolError(f"the answer {answer.hex(' ')} does not fit this request")
    if toggle is not None and answer[0] & _TOGGLE != toggle:
        raise ProtocolError(f"the toggle bit of the answer {answer.hex(' ')} is wrong")
