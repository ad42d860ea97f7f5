"""Reads recorded frames: text directly, to the microsecond; BLF, TRC, ASC and its own CSV through python-can.

Each may be compressed by gzip. What is not read is counted, and what is odd about the times is kept: `Remarks`.
"""

import gzip
import re
import struct
import zlib
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from io import TextIOWrapper
from itertools import chain, islice, pairwise
from pathlib import Path
from typing import BinaryIO, Final, NamedTuple, cast

import can

from canhaptic.errors import LogFormatError
from canhaptic.files import CONVERTIBLE
from canhaptic.logs import log_file
from canhaptic.logs.text_lines import UNTIMED, LineFrame, SkippedKind, frame_of

_LATEST: Final = 4_000_000_000_000_000_000  # [ns], in the year 2096
_CONTAINER: Final = 10  # type of a BLF object
_ZLIB: Final = b"\2\0"  # method of compression of a container
_UNPACKED: Final = 1 << 26  # [bytes], of a container; usual are 1 << 17
_LONGEST: Final = 4096  # letters of a line
_LONGEST_SILENCE: Final = 10_000_000_000  # [ns]; a longer one is said
_LOOKED_AT: Final = 4096  # frames, from which it is judged whether their times are differences
_SOLE_SUFFIXES: Final = frozenset({".log", ".txt", ".csv", ".candump"})
_CAPTURES: Final = frozenset({".pcap", ".pcapng", ".cap"})
_CSV_OF_PYTHON_CAN: Final = b"timestamp,arbitration_id,"
_LOOKS_LIKE_A_FRAME: Final = {
    ".asc": re.compile(r"\s*\d+[.,]\d+\s+(?:CANFD\s+)?\d+\s+(?:\S+\s+(?:Rx|Tx)|ErrorFrame)", re.IGNORECASE),
    ".trc": re.compile(r"\s*\d+\)?\s+\d"),
    ".csv": re.compile(r"[-\d]"),
}


@dataclass(slots=True)
class Remarks:
    """What a reader of a bus log has to say, complete at the end of the log.

    Attributes:
        skipped: Frames left out because CANopen rigs do not use them or because they cannot be read, and lines
            of other text, by kind.
        untimed: Frames without a time.
        are_spans: Whether the times of the log are those since the last frame (candump -td), which were added up.
        damage: What of the notes cannot have been so on the wire.
    """

    skipped: Counter[SkippedKind] = field(default_factory=Counter)
    untimed: int = 0
    are_spans: bool = False
    damage: set[str] = field(default_factory=set)
    _notes: dict[str, tuple[int, int]] = field(default_factory=dict)  # count, first frame
    _steps: dict[str, tuple[int, int, int]] = field(default_factory=dict)  # count, first frame, its length [ns]

    def step(self, number: int, nanoseconds: int) -> None:
        """Count a step of the time that is negative or long."""
        what = "goes back" if nanoseconds < 0 else "jumps forward"
        count, first, length = self._steps.get(what, (0, number, nanoseconds))
        self._steps[what] = count + 1, first, length

    def note(self, what: str, number: int) -> None:
        """Count a frame of which there is something to say."""
        count, first = self._notes.get(what, (0, number))
        self._notes[what] = count + 1, first

    def damaged(self, what: str, number: int) -> None:
        """Count a frame that cannot have been so on the wire, or before which others are missing."""
        self.damage.add(what)
        self.note(what, number)

    def lines(self) -> list[str]:
        """Return everything in words, one line for each subject."""
        texts = [f"frames left out: {describe_skipped(self.skipped)}"] if self.skipped else []
        texts += ["times are those since the last frame (candump -td): they were added up"] if self.are_spans else []
        if self.untimed:
            texts.append(f"{self.untimed} frames have no time, as in candump without -t")
        for what, (count, first, length) in self._steps.items():
            times = f"{count} times, " if count > 1 else ""
            texts.append(f"time {what} {times}first at line or frame {first}, by {abs(length) * 1e-9:.6g} s")
        return texts + self.note_lines(self._notes)

    def note_lines(self, kinds: Iterable[str]) -> list[str]:
        """Return the notes of some kinds in words."""
        notes = ((what, *self._notes[what]) for what in kinds)
        return [f"frame {first}: {what}" + f", and {count - 1} others" * (count > 1) for what, count, first in notes]


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


class _CountedLines(_Lines):
    """Lines of a file that python-can reads, with the number of those that look like frames.

    Before the first frame of an ASC file an empty line is added: python-can takes one line for the end of the header.
    """

    looks_like: re.Pattern[str]
    is_asc = False
    frames = 0
    _kept: str | None = None

    def __next__(self) -> str:  # type: ignore[override]
        """Return the next line."""
        if (kept := self._kept) is not None:
            self._kept = None
            return kept
        line = super().__next__()
        if self.looks_like.match(line):
            self.frames += 1
            if self.frames == 1 and self.is_asc:
                self._kept, line = line, "\n"
        return line


class Frame(NamedTuple):
    """One frame of a bus log."""

    timestamp_ns: int  # `UNTIMED` if the log has no time for it
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


def read_bus_log(path: str | Path, remarks: Remarks | None = None) -> Iterator[Frame]:
    """Yield the data frames of a bus log in the order of the file.

    Args:
        path: The log.
        remarks: Takes what is left out, and what is odd about the times.

    Raises:
        LogFormatError: The log is missing or empty, or holds no frame, or a line of `candump -L` is damaged; names
            file and line.
    """
    path = log_file(path)
    if is_capture(path):
        text = "is a capture of Ethernet, expected the frames of a CAN bus"
        raise LogFormatError(f"{path}: {text}; give the scene of its EtherCAT line with --config")
    remarks = Remarks() if remarks is None else remarks
    is_of_python_can = _suffix(path) in CONVERTIBLE or _starts_with(path, _CSV_OF_PYTHON_CAN)
    return _watched((_read_with_python_can if is_of_python_can else _read_text)(path, remarks), path, remarks)


def is_bus_log(path: Path) -> bool:
    """Return whether the name of a file is that of a bus log."""
    return _suffix(path) in CONVERTIBLE | _SOLE_SUFFIXES or is_capture(path)


def is_capture(path: Path) -> bool:
    """Return whether the name of a file is that of a capture of Ethernet."""
    return _suffix(path) in _CAPTURES


def _suffix(path: Path) -> str:
    return Path(path.stem if path.suffix.lower() == ".gz" else path.name).suffix.lower()


def _open(path: Path) -> BinaryIO:
    file = path.open("rb")
    is_packed = file.read(2) == b"\x1f\x8b"
    file.seek(0)
    if not is_packed:
        return file
    file.close()
    return cast("BinaryIO", gzip.open(path))


def _starts_with(path: Path, content: bytes) -> bool:
    try:
        with _open(path) as file:
            return file.read(len(content)) == content
    except (OSError, EOFError, zlib.error):  # said when it is read
        return False


def _watched(frames: Iterator[Frame], path: Path, remarks: Remarks) -> Iterator[Frame]:
    last = UNTIMED
    for frame in frames:
        now = frame.timestamp_ns
        if now == UNTIMED:
            remarks.untimed += 1
        elif now > _LATEST:
            seen = f"frame {frame.number} has the time {now * 1e-9:.3g} s, expected at most {_LATEST * 1e-9:.3g} s"
            raise LogFormatError(f"{path}: {seen} (the year 2096); the log is damaged")
        else:
            if last != UNTIMED and not 0 <= now - last <= _LONGEST_SILENCE:
                remarks.step(frame.number, now - last)
            last = now
        yield frame


def describe_skipped(skipped: Mapping[SkippedKind, int]) -> str:
    """Return the number of frames and lines left out, such as `2 CAN FD, 1 error`; empty if none."""
    return ", ".join(
        f"{count} {kind.replace('line', 'lines') if count > 1 else kind}" for kind, count in sorted(skipped.items())
    )


def _read_text(path: Path, remarks: Remarks) -> Iterator[Frame]:
    rows = _rows(path, remarks)
    try:
        head = list(islice(rows, 1))
        if head and head[0][1].is_span:
            head += islice(rows, _LOOKED_AT)
            remarks.are_spans = _are_spans([row.nanoseconds for _, row in head])
        now = 0
        for number, row in chain(head, rows):
            now = now + row.nanoseconds if remarks.are_spans else row.nanoseconds
            yield Frame(now, row.can_id, row.data, row.is_rx, number, row.channel)
    except (OSError, EOFError, zlib.error) as error:
        raise LogFormatError(f"{path}: cannot be read ({getattr(error, 'strerror', None) or error})") from error


def _are_spans(times: Sequence[int]) -> bool:
    """Return whether times [ns] are those since the last frame: such times fall again and again, or stay the same."""
    falls = [before - after for before, after in pairwise(times) if after < before]
    is_constant = len(times) > 2 and times[1] > 0 and len(set(times[1:])) == 1
    return is_constant or 10 * len(falls) > len(times) or sum(falls) > 3 * max(times)


def _rows(path: Path, remarks: Remarks) -> Iterator[tuple[int, LineFrame]]:
    """Yield the number and the frame of each line that has one.

    Raises:
        LogFormatError: No line has a frame, or a line of `candump -L` is damaged.
    """
    other, is_empty, is_pasted = "", True, False
    encoding = "utf-16" if _starts_with(path, b"\xff\xfe") or _starts_with(path, b"\xfe\xff") else "utf-8"
    with _Lines(_open(path), encoding=encoding, errors="replace") as file:
        for number, line in enumerate(file, 1):
            found = frame_of(line)
            if isinstance(found, LineFrame):
                is_empty, is_pasted = False, is_pasted or "#" not in line
                yield number, found
            elif found is not None:
                is_text = found == "line of other text"
                if is_text and line.startswith("(") and not is_pasted:
                    raise LogFormatError(f"{path}:{number}: {_why_no_frame(path, number, line)}")
                other = other or (f"{path}:{number}: {_why_no_frame(path, 0, line)}" if is_text else "")
                is_empty &= is_text
                remarks.skipped[found] += 1
    if is_empty:
        raise LogFormatError(other or f"{path}: has no frame, expected a bus log")


def _why_no_frame(path: Path, number: int, line: str) -> str:
    if number > 1 and not line.endswith("\n"):
        return (
            f"the last line, {line.strip()[:60]!r}, is cut: the recording ended while it was written; "
            f"remove that line, as with sed -i '$d' {path.name}, and go on with all frames before it"
        )
    return f"{line.strip()[:60]!r} is not a frame of candump or SavvyCAN, expected a bus log"


def _read_with_python_can(path: Path, remarks: Remarks) -> Iterator[Frame]:
    kind, number = _suffix(path), 0
    try:
        for number, message in enumerate(_messages(path, kind, remarks), 1):
            can_id, data = message.arbitration_id, bytes(message.data)
            if message.is_error_frame or message.is_remote_frame or message.is_fd:
                left: SkippedKind = "error" if message.is_error_frame else "CAN FD" if message.is_fd else "remote"
                remarks.skipped[left] += 1
                continue
            if message.is_extended_id and can_id <= 0x7FF:
                remarks.skipped["29-bit"] += 1
                continue
            nanoseconds = round(message.timestamp * 1e6) * 1000
            yield Frame(nanoseconds, can_id, data, message.is_rx, number, _channel(kind, message.channel))
    except LogFormatError:
        raise
    except Exception as error:  # its readers may raise anything on a damaged file
        raise LogFormatError(f"{path}: cannot be read as {kind[1:].upper()} ({error})") from error
    if not number and not remarks.skipped:
        raise LogFormatError(f"{path}: has no frame in the format {kind[1:].upper()}; is that what it is?")


def _channel(kind: str, number: object) -> str:
    """Return the number of a bus, from 0 on; a TRC file, and so python-can, counts its buses from 1."""
    return str(number - 1 if kind == ".trc" and isinstance(number, int) and number > 0 else number)


def _messages(path: Path, kind: str, remarks: Remarks) -> Iterator[can.Message]:
    """Yield the messages of a file, count what python-can drops, and close it after an error too, which it does not."""
    if kind == ".blf":
        with _open(path) as binary:
            _require_small_containers(binary)
            yield from can.BLFReader(binary)
        return
    with _CountedLines(_open(path)) as text:
        text.looks_like, text.is_asc, count = _LOOKS_LIKE_A_FRAME[kind], kind == ".asc", 0
        asc: Callable[[_Lines], Iterable[can.Message]] = partial(can.ASCReader, relative_timestamp=False)
        others: dict[str, Callable[[_Lines], Iterable[can.Message]]] = {".trc": can.TRCReader, ".csv": can.CSVReader}
        for message in others.get(kind, asc)(text):
            count += 1
            yield message
        if text.frames > count:
            remarks.skipped["unreadable"] += text.frames - count


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
