"""Ctrl-C where nothing moves: the command ends at once, also inside a library that ignores signals."""

import os
import signal
import sys
import threading
from types import TracebackType
from typing import Final, Self

INTERRUPTED: Final = 130
_PATIENCE: Final = 0.7
"""Time for a command to end by itself with its results so far [s]."""
_SIGINT: Final = bytes([signal.SIGINT])
_END: Final = b"\0"
_LINE: Final = "canhaptic: interrupted\n"


def say_interrupted() -> None:
    """Print the final line of a command after Ctrl-C."""
    sys.stderr.write(_LINE)
    sys.stderr.flush()


class PromptEnd:
    """Within the block, Ctrl-C ends the process after 0.7 s if it has not ended by then.

    Python handles a signal between two of its own instructions. A compiler that takes seconds for one call would delay
    it that long. The signal number is written into a pipe in any case, and a thread waits for it there.
    Files being written at that moment are left as after a kill. Not for commands that move a drive: they stop in order.
    """

    def __init__(self) -> None:
        self._ended = threading.Event()
        self._read = self._write = self._before = -1

    def __enter__(self) -> Self:
        if threading.current_thread() is threading.main_thread():
            self._read, self._write = os.pipe()
            os.set_blocking(self._write, False)
            self._before = signal.set_wakeup_fd(self._write, warn_on_full_buffer=False)
            threading.Thread(target=self._watch, name="interrupt", daemon=True).start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._write < 0:
            return
        signal.set_wakeup_fd(self._before, warn_on_full_buffer=False)
        os.write(self._write, _END)
        self._ended.set()

    def _watch(self) -> None:
        byte = b""
        while byte not in (_END, _SIGINT):
            byte = os.read(self._read, 1)
        if not self._ended.wait(_PATIENCE if byte == _SIGINT else None):
            os.write(sys.__stderr__.fileno() if sys.__stderr__ else 2, _LINE.encode())
            os._exit(INTERRUPTED)
        os.close(self._read)
        os.close(self._write)
