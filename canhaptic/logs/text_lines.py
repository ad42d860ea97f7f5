"""Frames in lines of text: candump for a file (-L) and for the screen, and the CSV files of SavvyCAN.

The screen form is what people paste: with or without times (-ta, -tz, -td, -tA), direction (-x), raw DLC (-8), letters
(-a) and colours (-c), behind a quotation mark or the prefix of another program. A line that is a frame of no form, or a
frame whose bytes do not agree with its length, gives the kind under which it is counted instead.
"""

import re
from datetime import UTC, datetime
from typing import Final, Literal, NamedTuple

SkippedKind = Literal["CAN FD", "error", "remote", "29-bit", "unreadable", "line of other text"]
UNTIMED: Final = -1
"""Time of a frame whose line has none."""

_ERROR_FLAG: Final = 0x2000_0000  # of an identifier in candump text (CAN_ERR_FLAG of linux/can.h)
_LAST_STANDARD_ID: Final = 0x7FF
_FRAME: Final = r"\((\d{1,12})\.(\d{1,9})\)\s+(\S+)\s+([0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})#([0-9A-Fa-f]*)(?:\s+([RTrt]))?\s*"
_LINE: Final = re.compile(_FRAME)
_PREFIXED: Final = re.compile(rf"[^(].*?{_FRAME}")
_SKIPPED: Final = re.compile(
    r"(?:[^(].*?)?\(\d+\.\d+\)\s+\S+\s+[0-9A-Fa-f]{3,8}#(?:(#[0-9A-Fa-f]+)|[Rr]\d?)(?:\s+[RTrt])?\s*"
)
_ESCAPE: Final = re.compile(r"(?:\x1b|\^\[)\[[0-9;?]*[A-Za-z]")
_SCREEN: Final = re.compile(
    r"(?:\(\s*([\d :.-]{3,40})\)\s+)?(?<!\S)(?:(\S+)\s+)?(?:(RX|TX)\s+[-B]\s[-E]\s+)?"
    r"([0-9A-Fa-f]{8}|[0-9A-Fa-f]{3})\s+[\[{]([0-9A-Fa-f]{1,2})[\]}](?:\s+(.*))?"
)
_BYTE: Final = re.compile(r"[0-9A-Fa-f]{2}")
_SAVVYCAN: Final = re.compile(
    r'"?(\d{1,19})(\.\d{1,9})?,(?:0x)?([0-9A-F]{1,8}),(true|false),(?:(Rx|Tx),)?(\d+),(\d+)((?:,(?:0x)?[0-9A-F]{0,2})*).*',
    re.IGNORECASE,
)
_ID_AND_DATA: Final = re.compile(r"(?:0x)?([0-9A-F]{3,8}),((?:[0-9A-F]{2}\s*)*)", re.IGNORECASE)
_HEADERS: Final = ("time stamp,id,extended,", "id,data bytes")


class LineFrame(NamedTuple):
    """Frame in a line; `nanoseconds` is `UNTIMED` if it has no time, `is_span` if it may be the time since the last."""

    nanoseconds: int
    can_id: int
    data: bytes
    is_rx: bool
    channel: str
    is_span: bool = False


def frame_of(line: str) -> LineFrame | SkippedKind | None:
    """Return the frame in a line, or the kind under which the line is counted; None for an empty line or a header."""
    if (match := _LINE.fullmatch(line)) is None:
        line = _ESCAPE.sub("", line).replace("\xa0", " ").strip("\r\n\t \ufeff\0")
        match = _LINE.fullmatch(line) or _PREFIXED.fullmatch(line)
    if match is not None and len(match[5]) % 2 == 0:
        nanoseconds = int(match[1]) * 1_000_000_000 + int(match[2].ljust(9, "0"))
        is_rx = match[6] not in ("T", "t")
        return _frame(nanoseconds, match[4], len(match[4]) == 8, bytes.fromhex(match[5]), is_rx, match[3])
    if not line or line.lower().startswith(_HEADERS):
        return None
    if found := _SKIPPED.fullmatch(line):
        return "CAN FD" if found[1] else "remote"
    if found := _SCREEN.search(line):
        return _of_screen(found)
    return _of_savvycan(line)


def _frame(
    nanoseconds: int, name: str, is_extended: bool, data: bytes, is_rx: bool, channel: str, is_span: bool = False
) -> LineFrame | SkippedKind:
    can_id = int(name, 16)
    if can_id & _ERROR_FLAG:
        return "error"
    if is_extended and can_id <= _LAST_STANDARD_ID:  # no number tells it from the frame of 11 bits
        return "29-bit"
    return "CAN FD" if len(data) > 8 else LineFrame(nanoseconds, can_id, data, is_rx, channel, is_span)


def _of_screen(found: re.Match[str]) -> LineFrame | SkippedKind:
    time, channel, direction, name, length, rest = found.groups()
    if len(length) == 2:
        return "CAN FD"
    if int(name, 16) & _ERROR_FLAG:
        return "error"
    if rest and rest.startswith("remote request"):
        return "remote"
    texts, count = (rest or "").split(), int(length, 16)
    if count > 8 or not all(map(_BYTE.fullmatch, texts[:count])) or len(texts) < count:
        return "unreadable"
    if len(texts) > count and _BYTE.fullmatch(texts[count]):
        return "unreadable"
    nanoseconds = UNTIMED if time is None else _time(time.strip())
    is_span = time is not None and re.fullmatch(r"\d{3}\.\d+", time.strip()) is not None
    data = bytes.fromhex("".join(texts[:count]))
    return _frame(nanoseconds, name, len(name) == 8, data, direction != "TX", channel or "", is_span)


def _time(text: str) -> int:
    """Return a time of candump [ns]; a date is read as UTC. `UNTIMED` if it is none."""
    whole, _, part = text.partition(".")
    if part and not part.isdecimal():
        return UNTIMED
    fraction = int(part.ljust(9, "0")[:9])
    if whole.isdecimal():
        return int(whole) * 1_000_000_000 + fraction
    try:
        moment = datetime.strptime(whole, "%Y-%m-%d %H:%M:%S").replace(tzinfo=UTC)
    except ValueError:
        return UNTIMED
    return int(moment.timestamp()) * 1_000_000_000 + fraction


def _of_savvycan(line: str) -> LineFrame | SkippedKind:
    """Return a frame of SavvyCAN: whole numbers are microseconds, others seconds; its shorter file has no times."""
    if found := _ID_AND_DATA.fullmatch(line):
        return _frame(UNTIMED, found[1], int(found[1], 16) > _LAST_STANDARD_ID, bytes.fromhex(found[2]), True, "0")
    if (found := _SAVVYCAN.fullmatch(line)) is None:
        return "line of other text"
    whole, part, name, extended, direction, channel, length, rest = found.groups()
    texts, count = [text[-2:].lstrip("xX").zfill(2) for text in rest.split(",")[1:] if text], int(length)
    if count > 8 or len(texts) < count:
        return "CAN FD" if count > 8 else "unreadable"
    nanoseconds = int(whole) * (1000 if part is None else 1_000_000_000) + int((part or ".0")[1:].ljust(9, "0"))
    data, is_extended = bytes.fromhex("".join(texts[:count])), extended.lower() == "true"
    return _frame(nanoseconds, name, is_extended, data, (direction or "Rx").lower() == "rx", channel)
