"""Lock of the host's cycle on SYNC0 of the reference clock: a PI loop over the phase of the frames.

The phase is the time from SYNC0 until a frame passes the reference clock. Its error is folded into half a period, so
that the loop takes the shorter way from any phase. The start waits until the error has been small for a second; a frame
that a busy computer sends late now and then only makes that longer.
"""

from typing import Final

_PROPORTIONAL: Final = 0.1
_INTEGRAL: Final = 0.002
_LARGEST_DRIFT: Final = 0.002  # of the host against the reference clock, beyond every quartz
_CLOSE: Final = 0.1  # part of the period within which an error tells of drift, and not of the way to go
_LOCKED: Final = 0.05  # part of the period
_COST: Final = 10  # close frames that one other takes back: a lock has 90 % of close ones
_SECOND: Final = 1_000_000_000  # [ns] for which the error must be small


class PhaseLock:
    """Phase of the host against SYNC0, and the correction that keeps it.

    Args:
        period: Sample time [ns].
        target: Phase to keep [ns].

    Attributes:
        first: System time of some SYNC0 [ns].
        error: Phase of the last frame minus the target, -period/2 .. period/2 [ns].
        close: Frames whose error was at most 5 % of the period, which is `close_ns` [ns], less 10 for each other.
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

    @property
    def is_locked(self) -> bool:
        """Whether the error has been small for a second."""
        return self.close >= self._needed

    def hold_of(self, dc_time: int) -> int:
        """Return the index of the hold of a system time: hold 0 begins at `first`."""
        return (dc_time - self.first) // self._period

    def follow(self, dc_time: int) -> int:
        """Return how much earlier the next frame must leave [ns], given the system time of the last frame [ns]."""
        period = self._period
        half = period // 2
        self.error = error = (dc_time - self.first - self._target + half) % period - half
        if -self.close_ns <= error <= self.close_ns:
            self.close += 1
        else:
            self.close = max(0, self.close - _COST)
        if abs(error) < _CLOSE * period:
            most = _LARGEST_DRIFT * period
            self._integral = max(-most, min(most, self._integral + _INTEGRAL * error))
        return round(_PROPORTIONAL * error + self._integral)
