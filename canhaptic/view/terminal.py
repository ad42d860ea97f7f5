"""Output of a command: results go to standard output; notes, errors and progress to standard error.

Control characters in a text are escaped, and progress never delays a cycle. Progress is for tasks longer than a second.
A run at real pace writes a short line twice a second, and only if that does not block. A run at free pace shows a bar
on a terminal or in a notebook, else a line every five seconds. No thread is started.
"""

import json
import math
import os
import select
import stat
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from io import UnsupportedOperation
from itertools import chain
from pathlib import Path
from shutil import get_terminal_size
from typing import TYPE_CHECKING, Any, Final, Literal

from canhaptic.drive.clock import WallClock
from canhaptic.errors import CanHapticError, InputError, SceneError
from canhaptic.files import replacing

if TYPE_CHECKING:
    from rich.progress import Progress

_STEERING: Final = chain(
    (code for code in range(0x20) if chr(code) not in "\t\n"),
    range(0x7F, 0xA0),  # delete, and the control characters of Latin-1
    (0x200E, 0x200F, 0x2028, 0x2029, *range(0x202A, 0x202F), *range(0x2066, 0x206A)),  # line ends, order of writing
    range(0xD800, 0xE000),  # of a path that is no UTF-8: cannot be written at all
)
_SHOWN: Final = {code: f"\\x{code:02x}" if code < 0x100 else f"\\u{code:04x}" for code in _STEERING}


def visible(text: str) -> str:
    r"""Return a text with its control characters escaped (`\x1b`), except line ends and tabs."""
    return text if text.isprintable() else text.translate(_SHOWN)


def write_json(value: Any) -> None:
    """Write one JSON object to standard output; numbers that JSON lacks (inf, nan) become null."""
    sys.stdout.write(json.dumps(_finite(value), indent=2, allow_nan=False) + "\n")


def write_line(text: str = "") -> None:
    """Write one line to standard output, with control characters escaped."""
    sys.stdout.write(visible(text) + "\n")


def write_note(text: str) -> None:
    """Write one line to standard error, with control characters escaped."""
    leave_closed_terminal()
    sys.stderr.write(visible(text) + "\n")
    sys.stderr.flush()


def leave_closed_terminal() -> None:
    """Write to nothing where the terminal was closed, or standard error has no reader: neither ends a run."""
    for number, stream in enumerate((sys.stdout, sys.stderr), 1):
        with suppress(OSError, ValueError):  # a text in memory, or no file at all
            if stream.fileno() == number and _is_gone(number):
                os.dup2(os.open(os.devnull, os.O_WRONLY), number)


def _is_gone(descriptor: int) -> bool:
    if not hasattr(select, "poll") or (descriptor == 1 and stat.S_ISFIFO(os.fstat(1).st_mode)):
        return False  # a command without a reader for its results ends with another exit status
    look = select.poll()
    look.register(descriptor, 0)
    return any(event & (select.POLLHUP | select.POLLERR) for _, event in look.poll(0))


def note_file(what: str, path: Path) -> None:
    """Note on standard error that a file was written."""
    write_note(f"  {what:<10}  {path}")


def write_file(path: Path, text: str) -> None:
    """Write a text as UTF-8.

    Raises:
        InputError: The file cannot be written.
    """
    try:
        with replacing(path) as file:
            file.write_text(text, encoding="utf-8")
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror}); name another file") from error


def write_failure(error: CanHapticError) -> None:
    """Write an error to standard error: one line, or one line per fault."""
    text = str(error)
    write_note(f"canhaptic: errors:\n{text}" if "\n" in text else f"canhaptic: error: {text}")


def failure(error: CanHapticError) -> dict[str, Any]:
    """Return an error as plain values."""
    faults = list(error.faults) if isinstance(error, SceneError) else [str(error)]
    return {"status": "error", "error": type(error).__name__, "exit_status": error.exit_status, "faults": faults}


def _finite(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _finite(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(entry) for entry in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


_FIRST: Final = 1_000_000_000  # [ns]
_INTERVAL: Final = {"real": 500_000_000, "free": 100_000_000}  # [ns]
_PIPED: Final = 5_000_000_000  # [ns] between two lines where standard error is a pipe or a file
_NOTEBOOK: Final = "ipykernel"
_Pace = Literal["real", "free"]


@contextmanager
def run_progress(
    cycles: int | None, sample_time: float, pace: _Pace, every: int = 64
) -> Iterator["RunProgress | None"]:
    """Yield the progress display of a run; None if standard error is piped and the pace is real.

    The arguments are as for `RunProgress`.
    """
    if _is_piped() and (pace == "real" or cycles is None):
        yield None
        return
    progress = RunProgress(cycles, sample_time, pace, every, is_piped=_is_piped())
    try:
        yield progress
    finally:
        progress.close()


def _is_piped() -> bool:
    return not (sys.stderr.isatty() or _NOTEBOOK in sys.modules)


class RunProgress:
    """Progress display of a run, called with the number of completed cycles.

    Args:
        cycles: Total number of cycles; None if unknown.
        sample_time: Sample time [s].
        pace: Pace of the run.
        every: Number of cycles between two looks at the clock at free pace.
        is_piped: Whether plain lines are written, one every five seconds.

    Attributes:
        status: Returns what the line of a run at real pace says besides time and cycles.
    """

    def __init__(
        self, cycles: int | None, sample_time: float, pace: _Pace, every: int = 64, *, is_piped: bool = False
    ) -> None:
        self._cycles = cycles
        self._every = every
        self._sample_time = sample_time
        self._pace = pace
        self._clock = WallClock()
        self._is_piped = is_piped
        self._next = self._clock.now() + (_PIPED if self._is_piped else _FIRST)
        self._shown = False
        self._bar: Progress | None = None
        self.status: Callable[[], str] = str

    def __call__(self, cycles: int) -> None:
        """Show the number of completed cycles if an update is due; cheap otherwise."""
        if self._pace == "free" and cycles % self._every:
            return
        now = self._clock.now()
        if now >= self._next:
            self._next = now + (_PIPED if self._is_piped else _INTERVAL[self._pace])
            self._show(cycles)

    def _show(self, cycles: int) -> None:
        if self._is_piped and self._cycles:
            _write_if_free(f"  {100.0 * cycles / self._cycles:3.0f} %   {cycles} of {self._cycles} cycles\n")
            return
        self._shown = True
        if self._pace == "real" or self._cycles is None:
            end = "" if self._cycles is None else f" of {self._cycles * self._sample_time:g} s"
            line = f"  {cycles * self._sample_time:8.1f} s{end}   {cycles} cycles  {self.status()}"
            _write_if_free(f"\r{line[: get_terminal_size().columns - 1]}\033[K")
            return
        if self._bar is None:
            from rich.console import Console
            from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

            parts = TextColumn("  running"), BarColumn(), TextColumn("{task.percentage:3.0f} %"), TimeRemainingColumn()
            console = Console(stderr=_NOTEBOOK not in sys.modules)
            self._bar = Progress(*parts, console=console, auto_refresh=False, transient=True)
            self._bar.start()
            self._bar.add_task("run", total=self._cycles)
        self._bar.update(self._bar.task_ids[0], completed=cycles, refresh=True)

    def close(self) -> None:
        """Remove the progress from the terminal."""
        if self._bar is not None:
            self._bar.stop()
        elif self._shown:
            _write_if_free("\r\033[K")


def _write_if_free(text: str) -> None:
    """Write to standard error unless that would block, as on a terminal stopped with Ctrl-S."""
    with suppress(UnsupportedOperation, OSError):  # standard error is a text in memory, or its terminal was closed
        descriptor = sys.stderr.fileno()
        if select.select([], [descriptor], [], 0.0)[1]:
            os.write(descriptor, text.encode())
