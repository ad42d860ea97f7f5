"""Holds whose torque was held on because no frame came in the one before: counted by the host and by each drive.

The counts obey drive <= host <= drive + frames without answer, for faults of frames in any order. Where they do not,
host and drives do not count the same holds, and no account of the run can be believed.
"""

from typing import NamedTuple

from canhaptic.drive.ethercat.phase_lock import PhaseLock
from canhaptic.drive.ethercat.segment import Cycle

SM_EVENT_MISSED = (0x1C32, 11)
"""Object that counts the SYNC0s without new outputs; 16 bits, which wrap."""
_WRAP = 1 << 16


class Reading(NamedTuple):
    """Count of a drive (0x1C32:0B), and the host's before and after it was read."""

    drive: int
    least: int
    most: int


class HeldTorques:
    """Counts of the host.

    Args:
        lock: Lock on the reference clock, which tells the hold of a frame.

    Attributes:
        missed: Holds in which no frame with outputs came back.
        unanswered: Frames with outputs that did not come back, or with a low counter.
        twice: Frames that came in a hold that had one.
        hold: Hold of the last frame that came back; None before.
    """

    def __init__(self, lock: PhaseLock) -> None:
        self._lock = lock
        self.begin()

    def begin(self) -> None:
        """Restart the counts with the last frame."""
        self.missed = self.unanswered = self.twice = 0
        self.hold: int | None = None

    def count(self, answer: Cycle | None) -> None:
        """Count the holds since the last frame with outputs."""
        if answer is None or not answer.is_whole:
            self.unanswered += 1
            return
        hold, before = self._lock.hold_of(answer.dc_time), self.hold
        self.hold = hold
        if before is not None and hold != before + 1:
            if hold == before:
                self.twice += 1
            else:
                self.missed += max(0, hold - before - 1)

    def until(self, dc_time: int) -> int:
        """Return the holds without a frame up to a system time [ns]."""
        hold = self._lock.hold_of(dc_time)
        return self.missed + (0 if self.hold is None else max(0, hold - self.hold - 1))

    def objection(self, begin: Reading, end: Reading) -> str:
        """Return how the count of a drive contradicts the host's between two readings; "" where it does not."""
        counted = (end.drive - begin.drive) % _WRAP
        least, most = end.least - begin.most, end.most - begin.least
        if (counted <= most and least <= counted + self.unanswered) or most >= _WRAP // 2:
            return ""
        return f"the drive counts {counted}, the host {most} and {self.unanswered} frames without answer"
