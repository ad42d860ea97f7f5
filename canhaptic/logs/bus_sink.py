"""Frames of the shared ring -> candump text, one line per frame, as `candump -L -x` of can-utils writes it.

    (0000000000.001000) can0 181#3712A0860100E803 R

The second word names the bus. R is a frame received by the master, T one that it sent.

`FaultSink` keeps the frames of the last seconds in memory instead, and writes them only when a run ends badly.
"""

import os
import re
import struct
from collections import deque
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from canhaptic.files import replacing
from canhaptic.logs.ring import LogSink, RingShape, SharedArea, open_regular

FRAME_RING: Final = RingShape("=qIBBBx8s", 65_536)  # timestamp [ns], identifier, length, is_rx, bus, data
_RECORD: Final = struct.Struct(FRAME_RING.record)
_BLOCK: Final = 4096  # frames formatted at a time
_KEPT_BLOCK: Final = 1024  # frames taken or dropped at a time
_TIMESTAMP: Final = struct.Struct("=q")
_LAST_STANDARD_ID: Final = 0x7FF
_GOOD_ENDINGS: Final = frozenset({"complete", "completed", "stopped"})


class BusSink(LogSink):
    """One bus log being written, or a bounded series of them.

    Args:
        path: The file being written.
        channels: Name of each bus in the lines of its frames.
        area: Shared memory with one ring of frames.
        file_size: Bytes after which the file is renamed to NAME.00001.log, NAME.00002.log, ...; 0 for no limit.
        files: Number of files kept in all, the one being written included; the oldest is deleted.
        convert_to: A .blf, .trc or .asc file to convert the text to at the end; None for no conversion.
    """

    def __init__(
        self,
        path: Path,
        channels: Sequence[str],
        area: SharedArea,
        *,
        file_size: int = 0,
        files: int = 2,
        convert_to: Path | None = None,
    ) -> None:
        super().__init__(path)
        self._channels = channels
        self._area = area
        (self._frames,) = area.rings
        self._file_size = file_size
        self._files = files
        self._convert_to = convert_to

    def open(self, restart: bool) -> None:
        """Create the file; after a restart continue after its last whole line."""
        self._next = self._frames.tail
        if restart and self._path.exists():
            self._recover()
            return
        for old in _aside_files(self._path) if self._file_size else []:
            old.unlink()
        self._begin()

    def _begin(self) -> None:
        self._area.mark = self._next
        self._descriptor = open_regular(self._path, os.O_WRONLY | os.O_CREAT)
        os.truncate(self._descriptor, 0)
        self._size = 0

    def _recover(self) -> None:
        text = self._path.read_bytes()
        self._size = text.rfind(b"\n") + 1
        self._next = max(self._next, self._area.mark + text.count(b"\n"))
        self._descriptor = open_regular(self._path, os.O_WRONLY | os.O_APPEND)
        os.truncate(self._descriptor, self._size)

    def drain(self, heads: list[int], final: bool) -> None:
        """Write all frames up to record number `heads[0]` of the ring."""
        while self._next < heads[0]:
            count = min(_BLOCK, heads[0] - self._next)
            self._write(format_frames(self._frames.read(self._next, count), self._channels))
            self._next += count
            self._frames.release(self._next)
            if self._file_size and self._size >= self._file_size:
                self._put_aside()
        if final:
            os.fsync(self._descriptor)

    def _write(self, text: bytes) -> None:
        while text:
            written = os.write(self._descriptor, text)
            self._size += written
            text = text[written:]

    def _put_aside(self) -> None:
        os.close(self._descriptor)
        number = max(_numbered(self._path), default=0) + 1
        self._path.rename(self._path.with_name(f"{self._path.stem}.{number:05d}{self._path.suffix}"))
        for old in _aside_files(self._path)[: -(self._files - 1) or None]:
            old.unlink()
        self._begin()

    def finish(self, status: str) -> None:
        """Close the file and convert it if requested; bus logs have no field for the status of the run."""
        del status
        self.check()
        os.close(self._descriptor)
        if self._convert_to is not None:
            from canhaptic.logs.bus_reader import convert

            with replacing(self._convert_to) as converted:
                convert(self._path, converted)
            self._path.unlink()


class FaultSink(LogSink):
    """Keeps the last frames in the memory of the writer process, where they survive a crash of the controller.

    A bad end replaces the file of an earlier bad end; a good end keeps it.

    Args:
        path: The file to write after a bad end.
        channels: Name of each bus in the lines of its frames.
        area: Shared memory with one ring of frames.
        last_ns: Duration of the final part of the run that is kept [ns].
    """

    def __init__(self, path: Path, channels: Sequence[str], area: SharedArea, last_ns: int) -> None:
        super().__init__(path)
        self._channels = channels
        (self._frames,) = area.rings
        self._last_ns = last_ns
        self._blocks: deque[bytes] = deque()

    def open(self, restart: bool) -> None:
        """Check that the file can be created; the file of an earlier run that ended badly is kept."""
        del restart
        self._next = self._frames.tail
        probe = self._path.with_name(f".{self._path.name}.new")
        probe.unlink(missing_ok=True)
        os.close(os.open(probe, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666))
        probe.unlink()

    def drain(self, heads: list[int], final: bool) -> None:
        """Copy all frames up to ring record `heads[0]` into memory; discard those older than the kept duration."""
        del final
        while self._next < heads[0]:
            count = min(_KEPT_BLOCK, heads[0] - self._next)
            self._blocks.append(self._frames.read(self._next, count))
            self._next += count
            self._frames.release(self._next)
        while len(self._blocks) > 1 and _last_time(self._blocks[0]) < self._oldest():
            self._blocks.popleft()

    def _oldest(self) -> int:
        return _last_time(self._blocks[-1]) - self._last_ns

    def finish(self, status: str) -> None:
        """Write the kept frames, unless the run ended well."""
        if status in _GOOD_ENDINGS or not self._blocks:
            return
        oldest = self._oldest()
        frames = b"".join(self._blocks)
        starts = range(0, len(frames), _RECORD.size)
        first = next(start for start in starts if _TIMESTAMP.unpack_from(frames, start)[0] >= oldest)
        with replacing(self._path) as file:
            file.write_bytes(format_frames(frames[first:], self._channels))


def _last_time(block: bytes) -> int:
    return int(_TIMESTAMP.unpack_from(block, len(block) - _RECORD.size)[0])


def format_frames(frames: bytes, channels: Sequence[str]) -> bytes:
    """Return the candump lines of packed records."""
    lines = []
    for timestamp, identifier, length, is_rx, bus, data in _RECORD.iter_unpack(frames):
        name = f"{identifier:03X}" if identifier <= _LAST_STANDARD_ID else f"{identifier:08X}"
        seconds, rest = divmod(timestamp, 1_000_000_000)
        payload = data[:length].hex().upper()
        lines.append(f"({seconds:010d}.{rest // 1000:06d}) {channels[bus]} {name}#{payload} {'R' if is_rx else 'T'}\n")
    return "".join(lines).encode()


def _aside_files(path: Path) -> list[Path]:
    """Completed files of the series before `path`, oldest first."""
    return [file for _, file in sorted(_numbered(path).items())]


def _numbered(path: Path) -> dict[int, Path]:
    name = re.compile(rf"{re.escape(path.stem)}\.(\d{{5,}}){re.escape(path.suffix)}")
    files = path.parent.iterdir() if path.parent.is_dir() else ()
    return {int(found[1]): file for file in files if (found := name.fullmatch(file.name))}
