"""How commissioning speaks with the person at the machine."""

from collections.abc import Callable
from typing import Protocol


class Dialogue(Protocol):
    """A person at a terminal, or no person with a simulated drive.

    Where a simulated plant knows the answer it is handed in as `truth`; a person is never shown it.
    """

    def tell(self, text: str) -> None:
        """Says what happens now."""

    def confirm(self, question: str) -> bool:
        """Returns whether the person agrees; no answer is no."""

    def number(self, question: str, unit: str, truth: float | None) -> float | None:
        """Returns a number in `unit`, or None when the person has none."""

    def until_ready(self, text: str, cycles: int) -> Callable[[], bool]:
        """Asks the person to do something, and returns what says, once per cycle, whether it is done.

        Args:
            text: What to do.
            cycles: After how many it counts as done where no person answers.
        """


class Unattended:
    """Agrees to everything and answers from the truth: for simulated drives alone."""

    def __init__(self, tell: Callable[[str], None]) -> None:
        self.tell = tell

    def confirm(self, question: str) -> bool:
        """Agrees."""
        self.tell(f"{question} yes")
        return True

    def number(self, question: str, unit: str, truth: float | None) -> float | None:
        """Returns what the simulated plant knows."""
        self.tell(f"{question} {'unknown' if truth is None else f'{truth:.6g} {unit}'}")
        return truth

    def until_ready(self, text: str, cycles: int) -> Callable[[], bool]:
        """Waits for a number of cycles."""
        self.tell(text)
        left = iter(range(cycles))
        return lambda: next(left, None) is None
