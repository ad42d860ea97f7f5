"""SIGINT and SIGTERM as the operator's stop: the first asks for it, the second does not wait for the ramp."""

import signal
from types import FrameType, TracebackType
from typing import Any, Final, Self

_SIGNALS: Final = (signal.SIGINT, signal.SIGTERM)
SHELL_OFFSET: Final = 128  # exit status of a process ended by signal n is 128 + n


class StopSignal:
    """Within the block, a signal sets `requested` instead of ending the process; a second one ends it at once.

    Attributes:
        number: The signal that came first; 0 while none did.
    """

    def __init__(self) -> None:
        self.number = 0
        self._before: dict[int, Any] = {}

    def requested(self) -> bool:
        """Return whether to stop."""
        return self.number != 0

    @property
    def exit_status(self) -> int:
        """130 after SIGINT, 143 after SIGTERM, 0 without a signal."""
        return SHELL_OFFSET + self.number if self.number else 0

    def __enter__(self) -> Self:
        self._before = {number: signal.signal(number, self._take) for number in _SIGNALS}
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _take(self, number: int, frame: FrameType | None) -> None:
        if self.number:
            raise SystemExit(self.exit_status)
        self.number = number
