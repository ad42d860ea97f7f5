"""Damping in a controller: velocity from encoder counts, limits of a sampled damper, and the modulated damper.

**Velocity.** A difference over one sample turns one count into count / T: 1 m/s for 0.1 mm at 10 kHz. First-order
adaptive windowing (Janabi-Sharifi, Hayward and Chen 2000) takes the slope over the longest recent window whose
end-to-end line stays within one count of every sample in it: long and quiet at rest, short and quick in motion.

The oldest sample of the window is its anchor. The lines from it that pass every later sample within the tolerance have
slopes in an interval. A new sample whose line lies in this interval narrows it and lengthens the window by one.
Otherwise a new window is searched backwards from the newest sample, over at most half of the old one, so that the mean
cost per sample is constant. The published search covers the whole window every time, and can find a window up to twice
as long after a change of speed.

**Modulated damper.** It recovers surplus energy (eq. 19); the total damping is capped for the actual delay.
"""

import math
from dataclasses import dataclass
from math import inf
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator

from canhaptic.errors import ParameterError
from canhaptic.kernels import Buffer
from canhaptic.units import Parameters, quantity


class DamperVelocity(Parameters):
    """Velocity estimate of an algorithm's damper."""

    velocity: Literal["last", "windowed"] = "last"
    """`last`: of the last hold, as the paper has it. `windowed`: adaptive windowing; needs the encoder count."""
    velocity_window: Annotated[float, quantity("s", gt=0.0, le=1.0)] = 0.02
    """Longest window of `windowed`."""

    def window_tolerance(self, encoder_count: float) -> float:
        """Return how far samples may lie from the line through their window [m or rad]; 0 for `last`.

        Raises:
            ParameterError: `velocity` is `windowed`, but the encoder count is not declared.
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
        """Return the number of samples in the longest window of a `windowed` velocity, at a sample time [s]."""
        return max(2, round(self.velocity_window / sample_time))


@dataclass(slots=True)
class VelocityWindow:
    """Window of a velocity estimate; its samples are in a ring buffer."""

    newest: int = 0  # place of the newest sample in the ring
    length: int = 0  # samples from the anchor to the newest
    anchor: float = 0.0  # oldest sample of the window [m or rad]
    least: float = -inf  # slopes of the lines that pass every sample within the tolerance, per sample
    most: float = inf
    velocity: float = 0.0  # [m/s or rad/s]


def restart(window: VelocityWindow, ring: Buffer, position: float) -> None:
    """Restart the window with one sample, a position [m or rad], and velocity 0."""
    for place in range(len(ring)):
        ring[place] = position
    window.newest = window.length = 0
    window.anchor, window.velocity = position, 0.0
    window.least, window.most = -inf, inf


def update(window: VelocityWindow, ring: Buffer, tolerance: float, sample_time: float, position: float) -> None:
    """Add the next position to the window, and update its velocity.

    Args:
        window: The window; changed.
        ring: Last positions, one more than the longest window has samples [m or rad]; changed.
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
    """Set the window to the longest, up to `furthest` samples, that a line fits, and set the range of its slopes."""
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


def _with_unit(value: Any) -> Any:
    try:
        bare = float(value) != 0.0
    except (TypeError, ValueError, OverflowError):  # what follows refuses them
        return value
    if bare:
        raise ValueError("damping per joule has no natural unit: write it, as in '200 s/m^2' or '5 s/rad^2'")
    return value


Alpha = Annotated[float, quantity("s/m^2", "s/rad^2", ge=0.0), BeforeValidator(_with_unit)]
"""Modulated damping per joule of surplus (eq. 19). A number other than 0 must come with its unit."""


def least_oscillating_damping(delay: int, mass: float, sample_time: float) -> float:
    """Return the damping [N*s/m or N*m*s/rad] above which a sampled damper makes a free mass ripple.

    A mass under zero-order-held damping with a velocity from the last displacement has the characteristic equation
    (z - 1) z^n + g (z + 1) = 0 with n = 1 + delay, g = d T / 2m. Its roots leave the real axis where
    g = (1 - z) z^n / (1 + z) is largest, at z = (sqrt(1 + n^2) - 1) / n: d T / m = 0.343, 0.180, 0.122
    for delay 0, 1, 2.

    Args:
        delay: Whole holds between computation and action.
        mass: Inertia rigid with the encoder [kg or kg*m^2]; must not exceed the real value.
        sample_time: Sample time [s].
    """
    n = 1 + delay
    z = (math.sqrt(1.0 + n * n) - 1.0) / n
    return float(2.0 * mass / sample_time * (1.0 - z) * z**n / (1.0 + z))


def largest_stable_damping(delay: int, mass: float, sample_time: float) -> float:
    """Return the damping [N*s/m or N*m*s/rad] above which a sampled damper makes a free mass diverge.

    On z = exp(i theta) the equation of `least_oscillating_damping` has (z - 1) / (z + 1) = i tan(theta / 2), so
    theta = pi / 2n and d T / m = 2 tan(pi / 4n): 2, 0.828, 0.536 for delay 0, 1, 2.
    """
    return 2.0 * mass / sample_time * math.tan(math.pi / (4.0 * (1 + delay)))


def damping_cap(delay: int, mass: float | None, sample_time: float) -> float:
    """Return the largest total damping to render [N*s/m or N*m*s/rad]; infinite when the moving mass is not known."""
    return math.inf if mass is None else least_oscillating_damping(delay, mass, sample_time)


def modulated_damping(
    alpha: float, surplus: float, model_damping: float, cap: float, displacement: float, sample_time: float
) -> float:
    """Return d_pas of eq. 19 [N*s/m or N*m*s/rad]: proportional to the surplus, with a cap on the total damping.

    It is also limited to the damping that would dissipate the whole surplus in a hold like the last: with a large
    alpha, eq. 19 alone would remove more than the surplus and oscillate.

    Args:
        alpha: Damping per joule of surplus [s/m^2 or s/rad^2].
        surplus: Energy still to be dissipated [J]; at or below 0 the damper is off.
        model_damping: Damping of the model inside the same torque [N*s/m or N*m*s/rad].
        cap: Largest total damping [N*s/m or N*m*s/rad].
        displacement: Motion of the hold that ended [m or rad].
        sample_time: Sample time [s].
    """
    if surplus <= 0.0:
        return 0.0
    damping = min(alpha * surplus, cap - model_damping)
    if damping * displacement * displacement > surplus * sample_time:
        damping = surplus * sample_time / (displacement * displacement)
    return max(0.0, damping)
