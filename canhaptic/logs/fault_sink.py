"""The frames of the last seconds, written only when a run ends badly; no file grows meanwhile."""

import os
import struct
from collections import deque
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from canhaptic.host.output_file import replacing
from canhaptic.logs.bus_sink import FRAME_RING, format_frames
from canhaptic.logs.growing_file import LogSink
from canhaptic.logs.ring import SharedArea

_GOOD_ENDINGS: Final = frozenset({"complete", "completed", "stopped"})
_BLOCK: Final = 1024  # frames taken or dropped at a time
_TIMESTAMP: Final = struct.Struct("=q")
_SIZE: Final = struct.calcsize(FRAME_RING.record)


class FaultSink(LogSink):
    """Keeps the last frames in the memory of the writer process: they survive the controller, not the writer.

    A later bad end replaces the file of an earlier one; a good end leaves it.

    Args:
        path: The file to write after a bad end.
        channels: Name of each bus in the lines of its frames.
        area: Shared memory with one ring of frames.
        last_ns: Duration of the end of the run to keep [ns].
    """

    def __init__(self, path: Path, channels: Sequence[str], area: SharedArea, last_ns: int) -> None:
        self._path = path
        self._channels = tuple(channels)
        (self._frames,) = area.rings
        self._last_ns = last_ns
        self._blocks: deque[bytes] = deque()

    def open(self, restart: bool) -> None:
        """Check early that the file can be created; the file of an earlier fault stays."""
        del restart
        self._next = self._frames.tail
        probe = self._path.with_name(f".{self._path.name}.new")
        probe.unlink(missing_ok=True)
        os.close(os.open(probe, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666))
        probe.unlink()

    def drain(self, heads: list[int], final: bool) -> None:
        """Take all frames up to `heads[0]` and discard old ones."""
        del final
        while self._next < heads[0]:
            count = min(_BLOCK, heads[0] - self._next)
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
        starts = range(0, len(frames), _SIZE)
        first = next(start for start in starts if _TIMESTAMP.unpack_from(frames, start)[0] >= oldest)
        with replacing(self._path) as file:
            file.write_bytes(format_frames(frames[first:], self._channels))


def _last_time(block: bytes) -> int:
    return int(_TIMESTAMP.unpack_from(block, len(block) - _SIZE)[0])
