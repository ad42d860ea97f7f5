"""A log of the Ethernet frames of a line: pcap with nanoseconds, which Wireshark reads, written, read and played back.

A frame is there as it was sent, and again as it came back, in which the first drive has marked its source address. In
a playback each frame that the master sends must be the recorded one, at its recorded time.
"""

import struct
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Final, NamedTuple, Protocol, Self

from canhaptic.errors import LogFormatError, LogWriteError
from canhaptic.files import require_regular

_HEAD: Final = struct.Struct("<IHHiIII")
_RECORD: Final = struct.Struct("<IIII")
_MAGIC: Final = 0xA1B23C4D  # nanoseconds
_ETHERNET: Final = 1
_LARGEST: Final = 1 << 16  # [bytes] of a frame
_SECOND: Final = 1_000_000_000
_SOURCE: Final = 6  # place of the source address, in which a drive sets bit 1
_MARK: Final = 0x02


class _Line(Protocol):
    def exchange(self, frame: bytes, deadline: int) -> bytes | None: ...


class _Clock(Protocol):
    def now(self) -> int: ...

    def wait_until(self, deadline: int) -> None: ...


class ReplayDepartureError(BaseException):
    """A frame that is not the recorded one.

    It is no `Exception`, so that no handler treats it as a fault of drive or line and continues sending.
    """


class LoggedFrame(NamedTuple):
    """A frame of a log."""

    time: int  # [ns]
    content: bytes

    @property
    def is_answer(self) -> bool:
        """Whether it has passed a drive."""
        return bool(self.content[_SOURCE] & _MARK)


class FrameLog:
    """A log that is written, in place of any earlier one; closed at the end of a `with` block.

    Raises:
        LogWriteError: The file cannot be made or written.
    """

    def __init__(self, path: str | Path) -> None:
        self._path = Path(path)
        try:
            self._file = self._path.open("wb")
            self._file.write(_HEAD.pack(_MAGIC, 2, 4, 0, 0, _LARGEST, _ETHERNET))
        except OSError as error:
            raise LogWriteError(f"{path}: cannot be written ({error.strerror}); choose another file") from error

    def note(self, time: int, frame: bytes) -> None:
        """Write a frame with its time [ns]."""
        size = len(frame)
        try:
            self._file.write(_RECORD.pack(*divmod(time, _SECOND), size, size) + frame)
        except OSError as error:
            raise LogWriteError(f"{self._path}: cannot be written any more ({error.strerror}); make room") from error

    def close(self) -> None:
        """Write what is left, and close the file."""
        self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: type[BaseException] | BaseException | TracebackType | None) -> None:
        self.close()


def is_frame_log(path: str | Path) -> bool:
    """Return whether a file begins as a log of frames does."""
    try:
        require_regular(path)  # a pipe would never answer
        with Path(path).open("rb") as file:
            return file.read(4) == _MAGIC.to_bytes(4, "little")
    except OSError:
        return False


def read_frame_log(path: str | Path) -> list[LoggedFrame]:
    """Return the frames of a log.

    Raises:
        LogFormatError: The file is missing, is no pcap with nanoseconds of Ethernet frames, or ends within a frame.
    """
    try:
        content = Path(path).read_bytes()
    except OSError as error:
        raise LogFormatError(f"{path}: cannot be read ({error.strerror}); give the log of the line") from error
    if len(content) < _HEAD.size or _HEAD.unpack_from(content)[::6] != (_MAGIC, _ETHERNET):
        raise LogFormatError(f"{path}: is no pcap with nanoseconds of Ethernet frames; give the log of the line")
    frames, at = list[LoggedFrame](), _HEAD.size
    while at < len(content):
        place = f"{path}: frame {len(frames) + 1}"
        if at + _RECORD.size > len(content):
            raise LogFormatError(f"{place}: the file ends within it; it was cut short")
        seconds, rest, size, _ = _RECORD.unpack_from(content, at)
        at += _RECORD.size
        if not _SOURCE < size <= _LARGEST or at + size > len(content):
            raise LogFormatError(f"{place}: got {size} bytes, expected a whole Ethernet frame; the file is damaged")
        frames.append(LoggedFrame(seconds * _SECOND + rest, content[at : at + size]))
        at += size
    return frames


class RecordingLine:
    """A line whose frames are noted, each with its time.

    Args:
        line: The line.
        clock: Its clock.
        note: Called with time [ns] and content of each frame, sent or received.
    """

    def __init__(self, line: _Line, clock: _Clock, note: Callable[[int, bytes], None]) -> None:
        self._exchange, self._now, self._note = line.exchange, clock.now, note

    def exchange(self, frame: bytes, deadline: int) -> bytes | None:
        """Return a frame as it comes back, or None where it does not until `deadline` [ns]."""
        self._note(self._now(), frame)
        answer = self._exchange(frame, deadline)
        if answer is not None:
            self._note(self._now(), answer)
        return answer


class RecordedLine:
    """A line that plays a log: it answers with the recorded answers, and compares what is sent.

    Args:
        frames: Frames of a log.
        clock: Clock of the master, in virtual time.

    Attributes:
        compared: Frames of the master found equal so far.
    """

    def __init__(self, frames: list[LoggedFrame], clock: _Clock) -> None:
        self._frames, self._clock = frames, clock
        self._next = self.compared = 0

    @property
    def left(self) -> int:
        """Recorded frames that were not played yet."""
        return len(self._frames) - self._next

    def exchange(self, frame: bytes, deadline: int) -> bytes | None:
        """Return the recorded answer to a frame, or None where there is none.

        Raises:
            ReplayDepartureError: The frame or its time is not the recorded one, or the log is at its end.
        """
        clock, number = self._clock, self._next + 1
        if not self.left:
            raise ReplayDepartureError(f"frame {number}: got another frame, but the log ends before it")
        recorded = self._frames[self._next]
        if frame != recorded.content:
            raise ReplayDepartureError(f"frame {number}: {_difference(frame, recorded.content)}")
        if clock.now() != recorded.time:
            text = f"frame {number}: got it at {clock.now()} ns, recorded at {recorded.time} ns"
            raise ReplayDepartureError(f"{text}; the same scene and version send it at the same time")
        self._next += 1
        self.compared += 1
        if not self.left or not self._frames[self._next].is_answer:
            clock.wait_until(deadline)
            return None
        answer = self._frames[self._next]
        self._next += 1
        clock.wait_until(answer.time)
        return answer.content


def _difference(sent: bytes, recorded: bytes) -> str:
    if len(sent) != len(recorded):
        return f"got {len(sent)} bytes, recorded {len(recorded)}"
    at = next(n for n, (one, other) in enumerate(zip(sent, recorded, strict=True)) if one != other)
    return f"byte {at}: got {sent[at]:#04x}, recorded {recorded[at]:#04x}"
