"""Velocity for the damper from an encoder: the longest recent window through which one straight line fits.

A difference over one sample turns one count into count / T, at 10 kHz and 0.1 mm 1 m/s. First-order adaptive windowing
(Janabi-Sharifi, Hayward and Chen 2000) takes the slope over the longest window whose end-to-end line stays within one
count of every sample in it: long and quiet at rest, short and quick in motion.

The oldest sample of the window is its anchor. The slopes of lines from it that pass every sample since within the
tolerance form an interval; a new sample whose line lies in it narrows it and lengthens the window by one. Otherwise
a new window is searched backwards from the newest sample, over at most half of the old one: a search over n samples
is paid by the n samples that lengthened the window before. The published search goes over the whole window every
time and can keep up to twice the length after a change of speed; that is the price.
"""

from dataclasses import dataclass
from math import inf
from typing import Annotated, Literal

from canhaptic.errors import ParameterError
from canhaptic.kernels import Buffer
from canhaptic.units import Parameters, quantity


class DamperVelocity(Parameters):
    """Which velocity an algorithm's damper uses."""

    velocity: Literal["last", "windowed"] = "last"
    """`last`: of the last hold, as the paper has it. `windowed`: adaptive windowing; needs the encoder count."""
    velocity_window: Annotated[float, quantity("s", gt=0.0, le=1.0)] = 0.02
    """Longest window of `windowed`."""

    def window_tolerance(self, encoder_count: float) -> float:
        """Return the tolerance of the window [m or rad]; 0 for `last`.

        Raises:
            ParameterError: `windowed` without an encoder count.
        """
        if self.velocity == "last":
            return 0.0
        if encoder_count <= 0.0:
            raise ParameterError(
                f"velocity 'windowed': got encoder_count {encoder_count!r}, expected > 0; its window is as long as one "
                "count allows: give passivity.encoder_count, or use velocity: last"
            )
        return encoder_count

    def longest_window(self, sample_time: float) -> int:
        """Return the longest window of `windowed`, in samples of a sample time [s]."""
        return max(2, round(self.velocity_window / sample_time))


@dataclass(slots=True)
class VelocityWindow:
    """The samples through which the line of the newest velocity passes; the samples themselves are in a ring."""

    newest: int = 0  # place of the newest sample in the ring
    length: int = 0  # samples from the anchor to the newest
    anchor: float = 0.0  # oldest sample of the window [m or rad]
    least: float = -inf  # slopes of the lines that pass every sample within the tolerance, per sample
    most: float = inf
    velocity: float = 0.0  # [m/s or rad/s]
    scanned: int = 0  # samples that searches looked at since the start, to prove the cost


def restart(window: VelocityWindow, ring: Buffer, position: float) -> None:
    """Begin anew at a position [m or rad], at rest."""
    for place in range(len(ring)):
        ring[place] = position
    window.newest = window.length = window.scanned = 0
    window.anchor, window.velocity = position, 0.0
    window.least, window.most = -inf, inf


def update(window: VelocityWindow, ring: Buffer, tolerance: float, sample_time: float, position: float) -> None:
    """Take the position one sample later.

    Args:
        window: The window; changed.
        ring: Its samples, one more than the longest window [m or rad]; changed.
        tolerance: Largest distance of a sample from the line [m or rad]: one encoder count.
        sample_time: Sample time [s].
        position: The new sample [m or rad].
    """
    newest, size = window.newest + 1, len(ring)
    if newest == size:
        newest = 0
    window.newest = newest
    ring[newest] = position
    length = window.length + 1
    slope = (position - window.anchor) / length
    if length < size and window.least <= slope <= window.most:
        window.length = length
        least = (position - tolerance - window.anchor) / length
        most = (position + tolerance - window.anchor) / length
        if least > window.least:
            window.least = least
        if most < window.most:
            window.most = most
    else:
        search(window, ring, tolerance, (length if length < size else size - 1) // 2)
        slope = (position - window.anchor) / window.length
    window.velocity = slope / sample_time


def search(window: VelocityWindow, ring: Buffer, tolerance: float, furthest: int) -> None:
    """Take the longest window of at most `furthest` samples, or of one, that fits.

    It then admits only slopes that pass each of its samples within the tolerance.
    """
    newest = window.newest  # an index below 0 wraps, as the ring does
    position, least, most, length = ring[newest], -inf, inf, 0
    for distance in range(1, max(1, furthest) + 1):
        ahead = position - ring[newest - distance]
        if not least <= ahead / distance <= most:
            break
        length = distance
        low, high = (ahead - tolerance) / distance, (ahead + tolerance) / distance
        if low > least:
            least = low
        if high < most:
            most = high
    first = newest - length
    anchor = ring[first]
    least, most = -inf, inf
    for distance in range(1, length + 1):
        passed = ring[first + distance]
        low, high = (passed - tolerance - anchor) / distance, (passed + tolerance - anchor) / distance
        if low > least:
            least = low
        if high < most:
            most = high
    window.length, window.anchor, window.least, window.most = length, anchor, least, most
    window.scanned += 2 * length
