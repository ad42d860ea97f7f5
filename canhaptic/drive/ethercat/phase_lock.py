"""Lock of the host's cycle on SYNC0 of the reference clock: a PI loop over the phase of the frames.

The phase is the time from SYNC0 until a frame passes the reference clock. Its error is folded into half a period, so
that the loop takes the shorter way from any phase. The loop follows the deadlines, not the frames: what a frame left
late, on a loaded host, is no drift and is taken out of its error, and one that was on the way for longer than usual
says nothing. The start waits until the deadlines were close to their phase for a second of frames; each that was not
takes back ten, so that a loaded host locks later, and one with less than ten close frames for each other never does.
"""

from typing import Final

_PROPORTIONAL: Final = 0.1
_INTEGRAL: Final = 0.002
_LARGEST_DRIFT: Final = 0.002  # of the host against the reference clock, beyond every quartz
_CLOSE: Final = 0.1  # part of the period within which an error tells of drift, and not of the way to go
_LOCKED: Final = 0.05  # part of the period
_COST: Final = 10  # close frames that one other takes back
_USUAL: Final = 8  # 2^-8 of the period: by so much each frame moves what is usual
_SECOND: Final = 1_000_000_000  # [ns] for which the error must be small
LOCK_RULE: Final = (
    f"deadlines within {_LOCKED:.0%} of the period for 1 s of frames, each other frame taking back {_COST}"
)
"""What a lock is, in words."""


class PhaseLock:
    """Phase of the host against SYNC0, and the correction that keeps it.

    Args:
        period: Sample time [ns].
        target: Phase to keep [ns].

    Attributes:
        first: System time of some SYNC0 [ns].
        error: Phase of the last frame minus the target, -period/2 .. period/2 [ns].
        close: Frames whose deadline had an error of at most 5 % of the period, which is `close_ns` [ns], less 10 for
            each other.
    """

    def __init__(self, period: int, target: int) -> None:
        self._period, self._target = period, target
        self.close_ns = round(_LOCKED * period)
        self._needed = -(-_SECOND // period)
        self.begin(0)

    def begin(self, first: int) -> None:
        """Restart at an unknown phase.

        Args:
            first: System time of some SYNC0 [ns].
        """
        self.first, self._integral, self.error, self.close = first, 0.0, 0, 0
        self._usual = -1  # time from a frame's departure until its answer [ns]; -1: not known yet

    @property
    def is_locked(self) -> bool:
        """Whether the deadlines were close for a second of frames, less what the others took back."""
        return self.missing <= 0

    @property
    def missing(self) -> int:
        """Close frames that a lock still needs."""
        return self._needed - self.close

    def hold_of(self, dc_time: int) -> int:
        """Return the index of the hold of a system time: hold 0 begins at `first`."""
        return (dc_time - self.first) // self._period

    def was_slow(self, taken: int) -> bool:
        """Whether a frame was on the way for longer than usual: it says nothing of the host's own phase.

        Args:
            taken: Time from its departure until its answer [ns].
        """
        return taken - self._usual > self.close_ns and self._usual >= 0

    def follow(self, dc_time: int, late: int = 0, taken: int = 0) -> int:
        """Return how much earlier the next frame must leave [ns].

        Args:
            dc_time: System time of the last frame [ns].
            late: Time by which it left after its deadline [ns].
            taken: Time from its departure until its answer [ns].
        """
        period = self._period
        half = period // 2
        self.error = error = (dc_time - self.first - self._target + half) % period - half
        if taken != self._usual:
            if self._usual < 0:
                self._usual = taken
            longer = taken - self._usual
            was_slow, step = self.was_slow(taken), period >> _USUAL
            self._usual += max(-step, min(step, longer))
            if was_slow:
                return round(self._integral)
        if late:
            error = (error - late + half) % period - half
        if -self.close_ns <= error <= self.close_ns:
            self.close += 1
        else:
            self.close = max(0, self.close - _COST)
        if abs(error) < _CLOSE * period:
            most = _LARGEST_DRIFT * period
            self._integral = max(-most, min(most, self._integral + _INTEGRAL * error))
        return round(_PROPORTIONAL * error + self._integral)
