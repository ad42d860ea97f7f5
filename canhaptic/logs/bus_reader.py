"""Reads recorded frames: candump text directly, to the microsecond; BLF, TRC and ASC through python-can."""

import re
import struct
import zlib
from collections import Counter
from collections.abc import Iterator, Mapping
from io import TextIOWrapper
from pathlib import Path
from typing import BinaryIO, Final, Literal, NamedTuple

import can

from canhaptic.errors import LogFormatError
from canhaptic.files import CONVERTIBLE
from canhaptic.logs import log_file

_ERROR_FLAG: Final = 0x2000_0000  # of an identifier in candump text (CAN_ERR_FLAG of linux/can.h)
_LATEST: Final = 4_000_000_000_000_000_000  # [ns], in the year 2096
_CONTAINER: Final = 10  # type of a BLF object
_ZLIB: Final = b"\2\0"  # method of compression of a container
_UNPACKED: Final = 1 << 26  # [bytes], of a container; usual are 1 << 17
_LONGEST: Final = 4096  # letters of a line
_LINE: Final = re.compile(
    r"\((\d{1,12})\.(\d{1,9})\)\s+(\S+)\s+([0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})#([0-9A-Fa-f]*)(?:\s+([RTrt]))?\s*"
)


_SKIPPED: Final = re.compile(r"\(\d+\.\d+\)\s+\S+\s+[0-9A-Fa-f]{3,8}#(?:(#[0-9A-Fa-f]+)|[Rr]\d?)(?:\s+[RTrt])?\s*")
SkippedKind = Literal["CAN FD", "error", "remote"]


class _Lines(TextIOWrapper):
    """Text file with a bounded line length, so that a file without line ends is not read as one huge line."""

    def readline(self, size: int | None = -1) -> str:  # type: ignore[override]
        """Return the next line; empty at the end.

        Raises:
            LogFormatError: The line is longer than any of a bus log.
        """
        line = super().readline(_LONGEST)
        if len(line) == _LONGEST:
            raise LogFormatError(f"{self.buffer.name}: has a line of {_LONGEST} letters or more, expected a bus log")
        return line

    def __next__(self) -> str:  # type: ignore[override]
        """Return the next line."""
        if line := self.readline():
            return line
        raise StopIteration


class Frame(NamedTuple):
    """One frame of a bus log."""

    timestamp_ns: int
    can_id: int
    data: bytes
    is_rx: bool  # received by the recorder of the log; True when the log does not say
    number: int = 0  # of its line in a text, of the frame in a binary log; from 1 on
    channel: str = ""  # the bus as the log calls it

    def message(self, channel: int | None = None) -> can.Message:
        """Return the frame as a message of python-can, with the number of its bus."""
        return can.Message(
            timestamp=self.timestamp_ns * 1e-9,
            arbitration_id=self.can_id,
            is_extended_id=self.can_id > 0x7FF,
            data=self.data,
            is_rx=self.is_rx,
            channel=channel,
        )


def read_bus_log(path: str | Path, skipped: Counter[SkippedKind] | None = None) -> Iterator[Frame]:
    """Yield the data frames of a bus log in the order of the file.

    Args:
        path: The log.
        skipped: Counter of frames left out because CANopen rigs do not use them: CAN FD, error, remote.

    Raises:
        LogFormatError: The log is missing or empty, or a line is no frame; names file and line.
    """
    path, counts = log_file(path), Counter[SkippedKind]() if skipped is None else skipped
    return (_read_with_python_can if path.suffix.lower() in CONVERTIBLE else _read_candump)(path, counts)


def describe_skipped(skipped: Mapping[SkippedKind, int]) -> str:
    """Return the number of frames left out, such as `2 CAN FD, 1 error`; empty if none."""
    return ", ".join(f"{count} {kind}" for kind, count in sorted(skipped.items()))


def _read_candump(path: Path, skipped: Counter[SkippedKind]) -> Iterator[Frame]:
    try:
        with _Lines(path.open("rb"), encoding="ascii", errors="replace") as file:
            for number, line in enumerate(file, 1):
                match = _LINE.fullmatch(line)
                if match is None or len(match[5]) % 2:
                    if line.strip():
                        skipped[_skipped_kind(path, number, line)] += 1
                    continue
                can_id = int(match[4], 16)
                if can_id & _ERROR_FLAG:
                    skipped["error"] += 1
                    continue
                nanoseconds = int(match[1]) * 1_000_000_000 + int(match[2].ljust(9, "0"))
                _require_time(path, number, nanoseconds)
                is_rx = match[6] not in ("T", "t")
                yield Frame(nanoseconds, can_id, bytes.fromhex(match[5]), is_rx, number, match[3])
    except OSError as error:
        raise LogFormatError(f"{path}: cannot be read ({error.strerror})") from error


def _require_time(path: Path, number: int, nanoseconds: int) -> None:
    """Refuse an implausible time stamp, at which the timers of a replay would never expire."""
    if nanoseconds > _LATEST:
        raise LogFormatError(
            f"{path}: frame {number} has the time {nanoseconds * 1e-9:.3g} s, expected at most {_LATEST * 1e-9:.3g} s "
            "(the year 2096); the log is damaged"
        )


def _skipped_kind(path: Path, number: int, line: str) -> SkippedKind:
    """Return the kind of a line that is no data frame of classic CAN; raise LogFormatError if it is no frame at all."""
    if found := _SKIPPED.fullmatch(line):
        return "CAN FD" if found[1] else "remote"
    if number > 1 and line.startswith("(") and not line.endswith("\n"):
        raise LogFormatError(
            f"{path}:{number}: the last line, {line.strip()[:60]!r}, is cut: the recording ended while it was written; "
            f"remove that line, as with sed -i '$d' {path.name}, and go on with all frames before it"
        )
    raise LogFormatError(f"{path}:{number}: {line.strip()[:60]!r} is not a frame of candump -L, expected a bus log")


def _read_with_python_can(path: Path, skipped: Counter[SkippedKind]) -> Iterator[Frame]:
    try:
        for number, message in enumerate(_messages(path), 1):
            if message.is_error_frame or message.is_remote_frame or message.is_fd:
                kind: SkippedKind = "error" if message.is_error_frame else "CAN FD" if message.is_fd else "remote"
                skipped[kind] += 1
                continue
            nanoseconds = round(message.timestamp * 1e6) * 1000
            _require_time(path, number, nanoseconds)
            can_id, data = message.arbitration_id, bytes(message.data)
            yield Frame(nanoseconds, can_id, data, message.is_rx, number, _channel(path, message.channel))
    except LogFormatError:
        raise
    except Exception as error:  # its readers may raise anything on a damaged file
        raise LogFormatError(f"{path}: cannot be read as {path.suffix[1:].upper()} ({error})") from error


def _channel(path: Path, number: object) -> str:
    """Return the number of a bus, from 0 on; a TRC file, and so python-can, counts its buses from 1."""
    return str(number - 1 if path.suffix.lower() == ".trc" and isinstance(number, int) and number > 0 else number)


def _messages(path: Path) -> Iterator[can.Message]:
    """Yield the messages of a file, and close it after an error too, which python-can does not."""
    suffix = path.suffix.lower()
    if suffix == ".blf":
        with path.open("rb") as binary:
            _require_small_containers(binary)
            yield from can.BLFReader(binary)
        return
    with _Lines(path.open("rb")) as text:
        yield from can.TRCReader(text) if suffix == ".trc" else can.ASCReader(text, relative_timestamp=False)


def _require_small_containers(file: BinaryIO) -> None:
    """Refuse a small BLF container that unpacks to a very large one, since python-can unpacks each at once.

    Raises:
        ValueError: A container is larger than any that a tool writes.
        zlib.error: A container cannot be unpacked.
    """
    file.seek(int.from_bytes(file.read(8)[4:], "little"))
    while len(header := file.read(16)) == 16:
        size, kind = struct.unpack("<8xLL", header)
        content, _ = file.read(size - 16), file.read(size % 4)
        is_packed = kind == _CONTAINER and content[:2] == _ZLIB
        if is_packed and len(zlib.decompressobj().decompress(content[16:], _UNPACKED)) == _UNPACKED:
            raise ValueError(f"a container of {len(content)} bytes unpacks to {_UNPACKED} bytes or more")
    file.seek(0)


def convert(source: Path, target: Path) -> None:
    """Write a bus log in the format that the target's suffix names: .blf, .trc or .asc.

    These formats number the buses: from 0, in the order in which they appear.
    """
    channels: dict[str, int] = {}
    with can.Logger(target) as writer:
        for frame in read_bus_log(source):
            writer.on_message_received(frame.message(channels.setdefault(frame.channel, len(channels))))
