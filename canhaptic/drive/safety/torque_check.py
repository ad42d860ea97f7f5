"""Whether a torque that is read back may follow from what was commanded.

Limits, delays, current loops and filters make a torque smaller, later or smoother than its command: it stays within
the hull of 0 and the commands that may still act. A torque outside of it for long is not the master's: another scale
or sign, an offset, another source of commands.
"""

from collections import deque
from collections.abc import Iterable
from typing import NamedTuple


class Contradiction(NamedTuple):
    """A torque outside the hull, and the hull; in counts of the torque."""

    read: int
    low: int
    high: int


class TorqueCheck:
    """Counts the holds in a row whose torque lies outside the hull of 0 and the last commands.

    Args:
        holds: Holds whose commands may still act, at least 1.
        tolerance: Distance from the hull that counts as none [counts of the torque].

    Attributes:
        tolerance: The argument `tolerance`.
        commands: Command of each of these holds, the last one last [counts]; the axis appends to it.
        contradicted: Holds in a row with a torque outside.
        last: The last of these torques; None before the first.
    """

    __slots__ = ("commands", "contradicted", "last", "tolerance")

    def __init__(self, holds: int, tolerance: float) -> None:
        self.tolerance = tolerance
        self.commands: deque[int] = deque(maxlen=holds)
        self.reset()

    def reset(self) -> None:
        """Clear commands and counts: no torque was commanded."""
        self.commands.clear()
        self.contradicted = 0
        self.last: Contradiction | None = None

    def judge(self, read: int, others: Iterable[int]) -> None:
        """Count a torque that is not the command of its hold.

        Args:
            read: Torque read back [counts].
            others: Further commands that may act [counts].
        """
        low, high = min(0, *self.commands, *others), max(0, *self.commands, *others)
        if low - self.tolerance <= read <= high + self.tolerance:
            self.contradicted = 0
        else:
            self.contradicted += 1
            self.last = Contradiction(read, low, high)
