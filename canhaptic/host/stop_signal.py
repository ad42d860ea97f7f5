"""Signals that end a run: a handler only notes them, and who runs the rig acts on the note.

Nothing is raised where a torque may be on. A start ends at its next look at the note. In a stop a further signal
shortens the waits for confirmations; it leaves no step out.
"""

import signal
from collections.abc import Callable
from types import FrameType, TracebackType
from typing import Final, Self

from canhaptic.errors import StartStoppedError

SHELL_OFFSET: Final = 128  # exit status of a process ended by signal n is 128 + n
_NAMES: Final = ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT", "SIGUSR1", "SIGALRM", "SIGXCPU")  # some lack on Windows
_ENDING: Final = tuple(signal.Signals[name] for name in _NAMES if name in signal.Signals.__members__)
_Handler = Callable[[int, FrameType | None], object] | int | None
_noted: list[list[int]] = [[]]  # of each open block below, the innermost last


def requested() -> bool:
    """Return whether a signal asks for the end."""
    return bool(_noted[-1])


def is_urgent() -> bool:
    """Return whether a further signal came after that."""
    return len(_noted[-1]) > 1


def require_none() -> None:
    """Raise StartStoppedError once a signal asks for the end."""
    if _noted[-1]:
        raise StartStoppedError(f"stopped by {signal.Signals(_noted[-1][0]).name} before the drives were enabled")


def note(number: int, frame: FrameType | None = None) -> None:
    """Note a signal; a handler."""
    _noted[-1].append(number)


class StopSignal:
    """Within the block, signals that would end the process are noted.

    One that is ignored, as by `nohup`, stays ignored; one with a handler stays its own, unless `take` is given.

    Args:
        insists: Whether a second signal ends the process at once: for commands that move no drive.
        take: Handler in place of `note`.

    Attributes:
        numbers: The signals that came, in order.
        before: The handlers before.
    """

    def __init__(self, *, insists: bool = False, take: Callable[[int, FrameType | None], object] = note) -> None:
        self.numbers: list[int] = []
        self.before: dict[int, _Handler] = {}
        self._take = self._insist if insists else take
        self._takes_all = take is not note

    def requested(self) -> bool:
        """Return whether to stop."""
        return bool(self.numbers)

    @property
    def exit_status(self) -> int:
        """128 and the number of the first signal, as 130 after SIGINT; 0 without a signal."""
        return SHELL_OFFSET + self.numbers[0] if self.numbers else 0

    def __enter__(self) -> Self:
        _noted.append(self.numbers)
        for number in _ENDING:
            handler = signal.getsignal(number)
            if handler in (signal.SIG_DFL, signal.default_int_handler) or (self._takes_all and callable(handler)):
                self.before[number] = handler
                signal.signal(number, self._take)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for number, handler in self.before.items():
            signal.signal(number, handler)
        _noted.pop()

    def _insist(self, number: int, frame: FrameType | None) -> None:
        if self.numbers:
            raise SystemExit(self.exit_status)
        note(number)
