"""Dialogue of commissioning with the person at the machine."""

from collections.abc import Callable
from typing import Protocol


class Dialogue(Protocol):
    """A person at a terminal, or no person with a simulated drive.

    Where a simulated plant knows the answer it is passed in as `truth`; a person is never shown it.
    """

    def tell(self, text: str) -> None:
        """State the present action."""

    def confirm(self, question: str) -> bool:
        """Return whether the person agrees; no answer is no."""

    def number(self, question: str, unit: str, truth: float | None) -> float | None:
        """Number in `unit`, or None without an answer."""

    def until_ready(self, text: str, cycles: int) -> Callable[[], bool]:
        """Ask the person to do something; return a function, called once per cycle, that reports completion.

        Args:
            text: Request to the person.
            cycles: Number of cycles after which it counts as done without a person.
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
        """True value of the simulated plant."""
        self.tell(f"{question} {'unknown' if truth is None else f'{truth:.6g} {unit}'}")
        return truth

    def until_ready(self, text: str, cycles: int) -> Callable[[], bool]:
        """Wait for a number of cycles."""
        self.tell(text)
        left = iter(range(cycles))
        return lambda: next(left, None) is None
