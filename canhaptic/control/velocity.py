"""Velocity for the damper from an encoder: the longest recent window through which one straight line fits.

A difference over one sample turns one count into count / T, at 10 kHz and 0.1 mm 1 m/s. First-order adaptive windowing
(Janabi-Sharifi, Hayward and Chen 2000) takes the slope over the longest window whose end-to-end line stays within one
count of every sample in it: long and quiet at rest, short and quick in motion.
"""

from math import inf
from typing import Annotated, Literal

from canhaptic.errors import ParameterError
from canhaptic.units import Parameters, quantity


class DamperVelocity(Parameters):
    """Which velocity an algorithm's damper uses."""

    velocity: Literal["last", "windowed"] = "last"
    """`last`: of the last hold, as the paper has it. `windowed`: adaptive windowing; needs the encoder count."""
    velocity_window: Annotated[float, quantity("s", gt=0.0, le=1.0)] = 0.02
    """Longest window of `windowed`."""

    def estimator(self, sample_time: float, encoder_count: float) -> "AdaptiveWindow | None":
        """Returns a fresh estimator, or None for `last`.

        Raises:
            ParameterError: `windowed` without an encoder count.
        """
        if self.velocity == "last":
            return None
        if encoder_count <= 0.0:
            raise ParameterError(
                f"velocity 'windowed': got encoder_count {encoder_count!r}, expected > 0; its window is as long as one "
                "count allows: give passivity.encoder_count, or use velocity: last"
            )
        return AdaptiveWindow(sample_time, encoder_count, max(2, round(self.velocity_window / sample_time)))


class AdaptiveWindow:
    """Velocity of the newest sample, in constant amortised time.

    The oldest sample of the window is its anchor. The slopes of lines from it that pass every sample since within the
    tolerance form an interval; a new sample whose line lies in it narrows it and lengthens the window by one. Otherwise
    a new window is searched backwards from the newest sample, over at most half of the old one: a search over n samples
    is paid by the n samples that lengthened the window before. The published search goes over the whole window every
    time and can keep up to twice the length after a change of speed; that is the price.

    Attributes:
        velocity: [m/s or rad/s].
        scanned: Samples looked at since the start, to prove the cost.
    """

    __slots__ = (
        "_anchor",
        "_least",
        "_length",
        "_most",
        "_newest",
        "_ring",
        "_sample_time",
        "_size",
        "_tolerance",
        "scanned",
        "velocity",
    )

    def __init__(self, sample_time: float, tolerance: float, longest: int) -> None:
        """Makes an estimator at rest.

        Args:
            sample_time: [s].
            tolerance: Largest distance of a sample from the line [m or rad]: one encoder count.
            longest: Window, in samples.
        """
        self._sample_time = sample_time
        self._tolerance = tolerance
        self._size = longest + 1
        self.restart(0.0)

    def restart(self, position: float) -> None:
        """Begins anew at a position [m or rad], at rest."""
        self._ring = [position] * self._size
        self._newest = 0
        self._length = 0
        self._anchor = position
        self._least, self._most = -inf, inf
        self.velocity = 0.0
        self.scanned = 0

    def update(self, position: float) -> float:
        """Takes the position [m or rad] one sample later and returns the velocity [m/s or rad/s]."""
        newest, size = self._newest + 1, self._size
        if newest == size:
            newest = 0
        self._newest = newest
        self._ring[newest] = position
        self.scanned += 1
        length = self._length + 1
        slope = (position - self._anchor) / length
        if length < size and self._least <= slope <= self._most:
            self._length = length
            self._narrow(position, length)
        else:
            slope = self._search(position, (length if length < size else size - 1) // 2 or 1)
        self.velocity = velocity = slope / self._sample_time
        return velocity

    def _narrow(self, position: float, distance: int) -> None:
        """Admits only slopes that pass a sample `distance` after the anchor within the tolerance."""
        anchor, tolerance = self._anchor, self._tolerance
        least = (position - tolerance - anchor) / distance
        most = (position + tolerance - anchor) / distance
        if least > self._least:
            self._least = least
        if most < self._most:
            self._most = most

    def _search(self, position: float, furthest: int) -> float:
        """Takes the longest window of at most `furthest` samples that fits; returns its slope per sample."""
        ring, newest, tolerance = self._ring, self._newest, self._tolerance  # an index below 0 wraps, as the ring does
        least, most, length = -inf, inf, 0
        for distance in range(1, furthest + 1):
            ahead = position - ring[newest - distance]
            if not least <= ahead / distance <= most:
                break
            length = distance
            low, high = (ahead - tolerance) / distance, (ahead + tolerance) / distance
            if low > least:
                least = low
            if high < most:
                most = high
        anchor_at = newest - length
        self._length, self._anchor = length, ring[anchor_at]
        self._least, self._most = -inf, inf
        for distance in range(1, length + 1):
            self._narrow(ring[anchor_at + distance], distance)
        self.scanned += distance + length
        return (position - self._anchor) / length
