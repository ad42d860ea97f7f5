"""Timers of a simulated drive, in integer nanoseconds of a clock that the owner supplies."""

from collections.abc import Callable
from typing import Final, Protocol

NEVER: Final = 1 << 62  # [ns], later than any clock


class Timers:
    """Timers of one drive, each with a due time and an action.

    Restarting a timer costs one or two comparisons: a deadline that every cycle postpones is examined only when its
    earliest value has passed.

    Attributes:
        earliest: No timer is due before this [ns].
    """

    def __init__(self) -> None:
        self._due: list[int] = []
        self._actions: list[Callable[[int], None]] = []
        self.earliest = NEVER
        self._is_exact = True  # a timer is due at `earliest`, or none is set

    def add(self, action: Callable[[int], None]) -> int:
        """Add a stopped timer and return its number; `action` is called with the due time [ns]."""
        self._due.append(NEVER)
        self._actions.append(action)
        return len(self._due) - 1

    def start(self, timer: int, due: int) -> None:
        """Set a timer to `due` [ns], replacing its former time."""
        if due <= self.earliest:
            self.earliest, self._is_exact = due, True
        elif self._due[timer] == self.earliest:
            self._is_exact = False
        self._due[timer] = due

    def stop(self, timer: int) -> None:
        """Stop a timer, which is then never due."""
        self._due[timer] = NEVER
        self._is_exact = False

    def stop_all(self) -> None:
        """Stop every timer."""
        self._due[:] = [NEVER] * len(self._due)
        self.earliest, self._is_exact = NEVER, True

    def is_running(self, timer: int) -> bool:
        """Return whether the timer is set."""
        return self._due[timer] != NEVER

    def next_due(self) -> int:
        """Return when the next timer is due [ns]; `NEVER` when none is set."""
        if not self._is_exact:
            self.earliest, self._is_exact = min(self._due, default=NEVER), True
        return self.earliest

    def fire(self, now: int) -> None:
        """Call the action of every timer due up to `now` [ns], in order of time; each timer is stopped first."""
        times = self._due
        while (due := self.next_due()) <= now:
            timer = times.index(due)
            times[timer], self._is_exact = NEVER, False
            self._actions[timer](due)


class _Timed(Protocol):
    @property
    def timers(self) -> Timers: ...


class TimedDrives:
    """Simulated drives of one bus, each with its timers."""

    drives: tuple[_Timed, ...]

    def next_due(self) -> int:
        """Return when the next timer of any drive is due [ns]."""
        earliest = NEVER
        for drive in self.drives:
            due = drive.timers.next_due()
            if due < earliest:
                earliest = due
        return earliest
