"""Apparent mass of an admittance display, as a hand feels it, fitted to the forces and positions of a run.

Over two stretches of equal time T_s, with a weight w that rises from 0 to 1 over the first and falls over the second,
m v' + b v + F_0 = F - k q gives by parts, for the positions q_0, q_1, q_2 at the ends of the stretches,

    m (q_2 - 2 q_1 + q_0) / T_s^2 + b (mean_2 q - mean_1 q) / T_s + F_0 = mean of (F - k q), weighted by w,

so that no velocity is estimated, and a count of the encoder enters over T_s^2. Least squares give m, b and F_0.
Left out are stretches next to a wall or a limit of the position, and those with a lost sample or a skipped SYNC.

The fit counts only if the motion excites the mass. It needs at least 30 pairs of stretches, and a standard error of at
most a tenth of the mass. The root mean square of the acceleration that damper and offset do not explain has to be 10
times the one that encoder counts alone give, so that they shift the mass by at most 1 %.
"""

from dataclasses import dataclass
from itertools import product
from math import sqrt
from typing import Final

_STRETCH: Final = 0.02  # T_s [s]
_FEWEST: Final = 30  # pairs of stretches
_OVER_COUNTS: Final = 10.0  # acceleration over that by counts alone
_LARGEST_ERROR: Final = 0.1  # standard error over the mass


@dataclass(frozen=True, slots=True)
class MassAsked:
    """Requested mass, with spring and limits of the display; only numbers, so that a log can store them."""

    mass: float  # [kg or kg*m^2]
    stiffness: float  # of the spring to ground [N/m or N*m/rad]; where it is at rest counts as part of F_0
    low: float  # least position without a wall or a limit [m or rad]
    high: float  # largest position without one [m or rad]
    sample_time: float  # [s]
    count: float  # of the encoder [m or rad]


class MassFelt:
    """Fits the apparent mass to force and position, hold by hold.

    Args:
        asked: Requested mass, spring and limits.

    Attributes:
        asked: Requested mass, spring and limits.
    """

    def __init__(self, asked: MassAsked) -> None:
        self.asked = asked
        self._holds = max(4, round(_STRETCH / asked.sample_time))
        self._time, self._deadline, self._taken = self._holds * asked.sample_time, -2, 0
        self._start = self._way = self._rising = self._falling = 0.0  # of this stretch
        # Start, mean position and rising force of the last stretch
        self._before: tuple[float, float, float] | None = None
        self._sums = [0.0] * 16  # products of speed, 1, acceleration and force

    def take(self, position: float, torque: float, deadline: int) -> None:
        """Add a sample to the fit; after lost samples or skipped SYNCs begin a new stretch.

        Args:
            position: Position at the SYNC [m or rad].
            torque: Force of the display on the hand there: minus the sensor's [N or N*m].
            deadline: Sample times from the first SYNC to this one.
        """
        if deadline != self._deadline + 1:
            self._before, self._taken = None, 0
        elif self._taken == self._holds:
            self._end(position)
            self._taken = 0
        if not self._taken:
            self._start, self._way, self._rising, self._falling = position, 0.0, 0.0, 0.0
        force, share = -torque - self.asked.stiffness * position, self._taken / self._holds
        self._rising += share * force
        self._falling += (1.0 - share) * force
        self._way += position - self._start
        self._deadline, self._taken = deadline, self._taken + 1

    def _end(self, position: float) -> None:
        """End a stretch at a position [m or rad]; add it, paired with the stretch before, to the sums of the fit."""
        start, before, moved = self._start, self._before, position - self._start
        mean, near = start + (self._way + 0.5 * moved) / self._holds, abs(moved) + self.asked.count
        is_free = min(start, position) - near > self.asked.low and max(start, position) + near < self.asked.high
        self._before = (start, mean, self._rising) if is_free else None
        if before is None or not is_free:
            return
        rise, speed = (moved - (start - before[0])) / self._time**2, (mean - before[1]) / self._time
        pair = speed, 1.0, rise, (before[2] + self._falling) / self._holds
        self._sums = [total + a * b for total, (a, b) in zip(self._sums, product(pair, pair), strict=True)]

    @property
    def mass(self) -> float | None:
        """Mass that fits best [kg or kg*m^2]; None if the motion does not excite it enough, see the module."""
        import numpy as np

        sums = np.reshape(self._sums, (4, 4))
        pairs, cross = float(sums[1, 1]), sums[:2, 2:]
        rest = sums[2:, 2:] - cross.T @ np.linalg.pinv(sums[:2, :2], hermitian=True) @ cross  # no damper explains it
        (rise, both), (_, force) = rest.tolist()
        by_counts = 0.5 * (self.asked.count / self._time**2) ** 2  # square of a: three errors of half a count each
        if pairs < _FEWEST or rise <= _OVER_COUNTS**2 * by_counts * pairs:
            return None
        mass: float = both / rise
        error = sqrt(max(0.0, force - mass * both) / ((pairs - 3.0) * rise))
        return mass if error <= _LARGEST_ERROR * abs(mass) else None
