"""Rings of fixed records in memory shared by the control thread (producer) and a writer process (consumer).

The memory is an unlinked file on a memory file system, handed to the writer as a file descriptor. It lives as long as
either process does and leaves nothing behind when both are gone, however they ended. A record counts as written when
the ring's head has moved past it, so a producer that is killed in the middle of a record leaves no half record.
`LogSink` is the base of the files into which the consumer writes the records.
"""

import errno
import mmap
import os
import re
import stat
import struct
import tempfile
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Final, NamedTuple

from canhaptic.errors import LogWriteError

_HEADER: Final = 4096  # [bytes] before the first ring
_STATE_CELL: Final = 0
_MARK_CELL: Final = 1
_FIRST_RING_CELL: Final = 8  # two cells of 8 bytes per ring: head, tail
_TEXT_OFFSETS: Final = {"failure": 1024, "status": 2048}
_TEXT_SIZE: Final = 1000  # [bytes]
NO_SPACE: Final = "no space"
_FULL: Final = (errno.ENOSPC, errno.EFBIG, errno.EDQUOT)
_REMEDY: Final = "the rows from then on are lost; keep other programs away from a log while it is written"

Record = Sequence[float | bytes | bytearray]
"""Values of one record, in the order of its struct format."""
Recorder = Callable[[int, int, bytes | bytearray, bool], None]
"""Function that records a frame, given as (timestamp [ns], COB-ID, data, is_rx)."""


class RingShape(NamedTuple):
    """Size of one ring."""

    record: str  # struct format of one record
    capacity: int  # records


class SharedArea:
    """The mapped memory: a state, two short texts and one or more rings.

    Args:
        descriptor: An open file of at least `size_of(shapes)` bytes; the caller keeps it open.
        shapes: The rings, in the same order on both sides.
    """

    def __init__(self, descriptor: int, shapes: Iterable[RingShape]) -> None:
        shapes = tuple(shapes)
        self._map = mmap.mmap(descriptor, size_of(shapes), flags=mmap.MAP_SHARED | getattr(mmap, "MAP_POPULATE", 0))
        self._cells = memoryview(self._map)[: _TEXT_OFFSETS["failure"]].cast("Q")
        self.rings = []
        offset = _HEADER
        for number, shape in enumerate(shapes):
            self.rings.append(Ring(self._map, self._cells, _FIRST_RING_CELL + 2 * number, offset, shape))
            offset += struct.calcsize(shape.record) * shape.capacity

    @property
    def is_closing(self) -> bool:
        """Whether the producer asks the writer to finish."""
        return bool(self._cells[_STATE_CELL])

    def close_writer(self) -> None:
        """Ask the writer to finish."""
        self._cells[_STATE_CELL] = 1

    @property
    def mark(self) -> int:
        """Number that a writer stores for the next writer, which replaces it after a kill."""
        return self._cells[_MARK_CELL]

    @mark.setter
    def mark(self, mark: int) -> None:
        self._cells[_MARK_CELL] = mark

    def text(self, name: str) -> str:
        """Return the text left under `name` ("failure" or "status"); empty when there is none."""
        start = _TEXT_OFFSETS[name]
        (size,) = struct.unpack_from("=Q", self._map, start)
        return bytes(self._map[start + 8 : start + 8 + size]).decode("utf-8", "replace")

    def set_text(self, name: str, text: str) -> None:
        """Leave a text of at most 1000 bytes under `name`; a longer one is cut."""
        encoded = text.encode()[:_TEXT_SIZE]
        struct.pack_into(f"=Q{len(encoded)}s", self._map, _TEXT_OFFSETS[name], len(encoded), encoded)

    def close(self) -> None:
        """Unmap the memory."""
        self._cells.release()
        self._map.close()


class Ring:
    """One ring. The producer calls `push`, the consumer `head`, `read` and `release`."""

    def __init__(self, memory: mmap.mmap, cells: "memoryview[int]", cell: int, start: int, shape: RingShape) -> None:
        self._memory = memory
        self._cells = cells
        self._head_cell = cell
        self._tail_cell = cell + 1
        self._start = start
        self.capacity = shape.capacity
        packer = struct.Struct(shape.record)
        self._pack_into, self._size = packer.pack_into, packer.size
        self._next = cells[self._head_cell]
        self._limit = cells[self._tail_cell] + self.capacity

    def push(self, values: Record) -> bool:
        """Write one record; return False, and write nothing, when the ring is full."""
        number = self._next
        if number >= self._limit:
            # The tail is read only here: reading shared memory for every record would cost more than packing it.
            self._limit = self._cells[self._tail_cell] + self.capacity
            if number >= self._limit:
                return False
        self._pack_into(self._memory, self._start + number % self.capacity * self._size, *values)
        self._next = self._cells[self._head_cell] = number + 1
        return True

    def recorder(self, bus: int, when_full: Callable[[Record], object]) -> Recorder:
        """Return a function that writes one frame of a bus: `push` inlined, since it runs for every frame.

        Args:
            bus: Index of the bus among the channels.
            when_full: Called with a record that does not fit.
        """
        memory, cells, pack_into, size = self._memory, self._cells, self._pack_into, self._size
        first, capacity, head = self._start, self.capacity, self._head_cell

        def record(timestamp_ns: int, can_id: int, data: bytes | bytearray, is_rx: bool) -> None:
            number = self._next
            if number < self._limit:
                start = first + number % capacity * size
                pack_into(memory, start, timestamp_ns, can_id, len(data), is_rx, bus, data)
                self._next = cells[head] = number + 1
                return
            frame = (timestamp_ns, can_id, len(data), is_rx, bus, data)
            if not self.push(frame):  # which reads the tail again
                when_full(frame)

        return record

    @property
    def head(self) -> int:
        """Number of records ever written."""
        return self._cells[self._head_cell]

    @property
    def tail(self) -> int:
        """Number of records that the consumer has stored safely."""
        return self._cells[self._tail_cell]

    def read(self, first: int, count: int) -> bytes:
        """Return `count` records from number `first` on, as bytes; all must lie between tail and head."""
        index = first % self.capacity
        until_end = min(count, self.capacity - index)
        start = self._start + index * self._size
        piece = self._memory[start : start + until_end * self._size]
        if until_end < count:
            piece += self._memory[self._start : self._start + (count - until_end) * self._size]
        return piece

    def release(self, tail: int) -> None:
        """Free all records before number `tail` for the producer."""
        self._cells[self._tail_cell] = tail


def size_of(shapes: Iterable[RingShape]) -> int:
    """Return the bytes of shared memory that the rings need."""
    return _HEADER + sum(struct.calcsize(shape.record) * shape.capacity for shape in shapes)


def _fill(descriptor: int, size: int) -> None:
    if hasattr(os, "posix_fallocate"):
        os.posix_fallocate(descriptor, 0, size)
        return
    zeros = bytes(min(size, 1 << 20))  # macOS has no such call: a page that is written is there
    with os.fdopen(os.dup(descriptor), "wb") as file:
        for start in range(0, size, len(zeros)):
            file.write(zeros[: size - start])


def allocate(size: int) -> int:
    """Return the descriptor of an unlinked file of `size` bytes, with every page allocated.

    A memory file system is preferred: pages of a file on a disk stall the control thread while they are written back.
    """
    for folder in (Path("/dev/shm"), Path(tempfile.gettempdir())):
        if not folder.is_dir():
            continue
        try:
            descriptor, name = tempfile.mkstemp(prefix="canhaptic-", dir=folder)
        except OSError:
            continue
        Path(name).unlink()
        try:
            _fill(descriptor, size)
        except OSError:  # a container may allow only a few megabytes of shared memory
            os.close(descriptor)
            continue
        return descriptor
    raise OSError(f"no folder has {size} bytes free for the ring of the log; free some memory, or run without logs")


class LogSink:
    """Destination of the records of a shared area.

    Args:
        path: The file.
    """

    _descriptor = -1  # of the file, where it grows
    _size = 0  # bytes written to it

    def __init__(self, path: Path) -> None:
        self._path = path

    def open(self, restart: bool) -> None:
        """Prepare the file; after a restart, continue the one that a killed writer left."""

    def drain(self, heads: list[int], final: bool) -> None:
        """Write the records up to `heads`; unless `final`, an incomplete block may be kept for later."""

    def check(self) -> None:
        """Require that a growing file is still the opened one, and has its written length.

        Raises:
            LogWriteError: The file was deleted, replaced or truncated.
        """
        if self._descriptor < 0:
            return
        path, opened = self._path, os.fstat(self._descriptor)
        try:
            is_same = os.path.samestat(opened, os.stat(path, follow_symlinks=False))
        except FileNotFoundError:
            is_same = False
        if not is_same:
            raise LogWriteError(f"{path}: was deleted or replaced while it was written; {_REMEDY}")
        if opened.st_size < self._size:
            raise LogWriteError(
                f"{path}: was truncated to {opened.st_size} of {self._size} bytes while it was written; {_REMEDY}"
            )

    def finish(self, status: str) -> None:
        """Complete and close the file."""

    def fail(self, cause: str) -> None:
        """Write into the file, if it has room, why it is incomplete."""


def open_regular(path: Path, flags: int) -> int:
    """Return a descriptor of a regular file.

    Raises:
        LogWriteError: It is no regular file.
        OSError: It cannot be opened, or is a symbolic link.
    """
    descriptor = os.open(path, flags | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC, 0o666)
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise LogWriteError(f"{path}: is not a regular file; name another file")
    return descriptor


def cause_of(error: Exception) -> str:
    """Return briefly why a file could not be written; HDF5 gives the system's error number only in its text."""
    found = re.search(r"\[Errno (\d+)\]|errno = (\d+)", str(error))
    number = int(found[1] or found[2]) if found else 0
    return NO_SPACE if number in _FULL else os.strerror(number) if number else str(error)
