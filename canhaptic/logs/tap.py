"""A log of the frames on a network interface, both directions, by a process of its own: pcap with nanoseconds.

A foreign master keeps no log. The process has a raw socket of its own, so that the cycle pays nothing; the kernel
stamps the frames, and counts those that were dropped because the process was too slow. It ends when its input does.
"""

import select
import socket
import struct
import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from typing import Final

from canhaptic.errors import LogWriteError
from canhaptic.host import capabilities
from canhaptic.logs.frame_log import FrameLog

_ALL: Final = 0x0003  # every protocol: the frames that leave are seen by such a socket alone
_ETHERTYPE: Final = b"\x88\xa4"
_BUFFER: Final = 1 << 24  # [bytes]
_STAMPS: Final = 35  # SO_TIMESTAMPNS
_PACKET, _STATISTICS = 263, 6  # SOL_PACKET, PACKET_STATISTICS
_STAMP: Final = struct.Struct("@qq")
_LARGEST: Final = 2048  # [bytes]
_SOON: Final = 5.0  # [s] within which it starts and ends


class Tap:
    """The process that logs an interface.

    Args:
        interface: Its name.
        path: The log, which replaces any earlier one.

    Attributes:
        frames: Frames written; known after `close`.
        dropped: Frames that the kernel dropped; known after `close`.

    Raises:
        LogWriteError: The interface cannot be opened, or the file not written.
    """

    def __init__(self, interface: str, path: Path) -> None:
        from canhaptic.logs.writer_process import isolated_program  # its process needs nothing of it

        self.frames = self.dropped = 0
        self._path = path
        self._process = isolated_program("canhaptic.logs.tap", (interface, path), (), stdout=subprocess.PIPE)
        assert self._process.stdout is not None  # noqa: S101
        said = self._process.stdout.readline().strip()
        if said != "ready":
            self._process.wait()
            raise LogWriteError(f"{path}: {said or 'the process that logs the interface did not start'}")

    def close(self) -> None:
        """End the log; a second call does nothing."""
        if self._process.stdin is None or self._process.stdin.closed:
            return
        try:
            said, _ = self._process.communicate(timeout=_SOON)
        except subprocess.TimeoutExpired:
            self._process.kill()
            said, _ = self._process.communicate()
        words = said.split()
        if self._process.returncode or len(words) != 2:
            raise LogWriteError(
                f"{self._path}: is not complete ({said.strip() or 'its process was killed'}); make room"
            )
        self.frames, self.dropped = int(words[0]), int(words[1])


def write(interface: str, path: str) -> int:
    """Log an interface until standard input ends; return the exit status."""
    try:
        with capabilities.raised():
            tap = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(_ALL))
            tap.bind((interface, 0))
    except (OSError, AttributeError):
        print(capabilities.opening_objection(interface), flush=True)  # noqa: T201  # to the process that waits for it
        return 1
    tap.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER)
    with suppress(OSError):
        tap.setsockopt(socket.SOL_SOCKET, 33, _BUFFER)  # SO_RCVBUFFORCE
    tap.setsockopt(socket.SOL_SOCKET, _STAMPS, 1)
    tap.setblocking(False)
    frames = 0
    try:
        with FrameLog(path) as log:
            print("ready", flush=True)  # noqa: T201
            while True:
                ready, _, _ = select.select([tap, sys.stdin], [], [])
                frames += _drain(tap, log)
                if sys.stdin in ready and not sys.stdin.readline():
                    frames += _drain(tap, log)
                    break
    except LogWriteError as error:
        print(error, flush=True)  # noqa: T201
        return 1
    _, dropped = struct.unpack("II", tap.getsockopt(_PACKET, _STATISTICS, 8))
    print(frames, dropped, flush=True)  # noqa: T201
    return 0


def _drain(tap: socket.socket, log: FrameLog) -> int:
    """Write every frame that waits; return how many."""
    count = 0
    with suppress(BlockingIOError):
        while True:
            frame, extra, _, _ = tap.recvmsg(_LARGEST, 64)
            if frame[12:14] == _ETHERTYPE and extra:
                seconds, rest = _STAMP.unpack(extra[0][2][: _STAMP.size])
                log.note(seconds * 1_000_000_000 + rest, frame)
                count += 1
    return count


def main() -> None:
    """Log the interface and into the file that the arguments name."""
    sys.exit(write(*sys.argv[1:3]))
