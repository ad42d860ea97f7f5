"""Checks of a run by its motion: the mass that a hand feels at an admittance display, and the declared dry friction.

Both compare forces with positions over two consecutive stretches of a motion, with a weight w that rises from 0 to 1
over the first and falls over the second. By parts this needs no estimate of a velocity.

**Mass.** Over two stretches of equal time T_s, m v' + b v + F_0 = F - k q gives, for the positions q_0, q_1, q_2 at the
ends of the stretches,

    m (q_2 - 2 q_1 + q_0) / T_s^2 + b (mean_2 q - mean_1 q) / T_s + F_0 = mean of (F - k q), weighted by w,

in which a count of the encoder enters over T_s^2. Least squares give m, b and F_0. Left out are stretches next to a
wall or a limit of the position, and those with a lost sample or a skipped SYNC.

The fit counts only if the motion excites the mass. It needs at least 30 pairs of stretches, and a standard error of at
most a tenth of the mass. The root mean square of the acceleration that damper and offset do not explain has to be 10
times the one that encoder counts alone give, so that they shift the mass by at most 1 %.

**Friction.** Over two stretches of time T_1 and T_2 of a motion one way, s = 1 or -1, the equation of motion
m a = tau + u - s F gives, for the mean speeds v_1 and v_2,

    m s (v_2 - v_1) = integral of w (s tau + s u - F).

m is at least `moving_mass`, F at least the declared f_c, and in contact the hand pulls out with at most F_h and pushes
in with at most `hand_push`. If the axis gains more speed than the right side allows, a declaration of the device or of
the hand is false, and the certificates rest on it. The errors of the positions (half a count each), of the times
(jitter) and of a late torque are subtracted from the excess, so that none of them can cause it.

Out of contact the force of the hand has no declared bound and can explain every motion, so nothing is checked there.
Missing friction therefore shows only while a wall pushes the handle out faster than F_h and f_c permit; if that never
happens in a run, measure the friction again (canhaptic commission). A stop inside a hold, between two positions, is not
seen, and may withdraw certificates without cause.
"""

from dataclasses import dataclass
from itertools import product
from math import inf, sqrt
from typing import Final

_STRETCH_OF_MASS: Final = 0.02  # T_s [s]
_STRETCH_OF_FRICTION: Final = 0.01  # [s]
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
        self._holds = max(4, round(_STRETCH_OF_MASS / asked.sample_time))
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


@dataclass(frozen=True, slots=True)
class FrictionDeclared:
    """Declared bounds of friction and hand that a run is checked against; numbers only, so that a log can hold them."""

    friction: float  # f_c, at least [N or N*m]
    mass: float  # at least [kg or kg*m^2]
    sample_time: float  # [s]
    hand_force: float  # out of a contact, at most [N or N*m]
    hand_push: float = inf  # into a contact, at most [N or N*m]
    count: float = 0.0  # of the encoder [m or rad]
    jitter: float = 0.0  # of a hold, as a part of it
    late: float = 0.0  # time after a SYNC for which the torque before may act [s]


@dataclass(slots=True)
class _Stretch:
    """One of the two consecutive parts of a motion in one direction."""

    way: float = 0.0  # 1 or -1; 0: it stood still, turned, or was out of contact
    hand: float = 0.0  # largest force of the hand along it [N or N*m]
    length: float = 0.0  # of its way [m or rad]
    rising: float = 0.0  # sum of the torques, weighted from 0 to 1 [N or N*m]
    falling: float = 0.0  # the same, weighted from 1 to 0
    size: float = 0.0  # sum of |torque| of the holds [N or N*m]
    changes: float = 0.0  # sum of the sizes of the changes of the torque [N or N*m]


class FrictionWatch:
    """Compares the motion of a run with the declared friction and hand, hold by hold.

    Args:
        declared: Declared friction and hand.

    Attributes:
        excess: Largest force by which the motion contradicts the declarations [N or N*m]; 0: none.
    """

    def __init__(self, declared: FrictionDeclared) -> None:
        self._declared = declared
        self._holds = max(2, round(_STRETCH_OF_FRICTION / declared.sample_time))
        self.excess = 0.0
        self._torque = self._asked = 0.0
        self._position = 0.0
        self._taken = self._deadline = -1
        self._now, self._before = _Stretch(), _Stretch()

    def take(self, position: float, torque: float, deadline: int, asked: float) -> None:
        """Add a hold to the comparison; after lost samples or skipped SYNCs restart it.

        Args:
            position: Position at the end of the hold [m or rad].
            torque: Torque held in it [N or N*m].
            deadline: Sample times from the first SYNC to the end of the hold.
            asked: Effort of the environment there, which points into the contact; 0 out of contact [N or N*m].
        """
        before, self._asked = self._asked, asked
        gap, self._deadline = deadline - self._deadline, deadline
        moved, self._position = position - self._position, position
        change, self._torque = abs(torque - self._torque), torque
        if gap != 1 or self._taken < 0:
            self._taken, self._now, self._before = 0, _Stretch(), _Stretch()
            return
        now, part = self._now, (self._taken + 0.5) / self._holds
        declared = self._declared
        way = 0.0 if abs(moved) <= declared.count or before * asked <= 0.0 else 1.0 if moved > 0.0 else -1.0
        now.hand = max(now.hand, declared.hand_push if way * asked > 0.0 else declared.hand_force)
        now.way = way if self._taken == 0 or now.way == way else 0.0
        now.length += moved
        now.rising += part * torque
        now.falling += (1.0 - part) * torque
        now.size += abs(torque)
        now.changes += change
        self._taken += 1
        if self._taken == self._holds:
            self._compare(self._before, now)
            self._before, self._now, self._taken = now, _Stretch(), 0

    def _compare(self, first: _Stretch, second: _Stretch) -> None:
        """Compare the gain of speed between two stretches of equal length with the declarations; update `excess`."""
        way, of = second.way, self._declared
        if way == 0.0 or first.way != way:
            return
        time, jitter = self._holds * of.sample_time, of.jitter
        faster = (way * second.length - of.count) / (1.0 + jitter) - (way * first.length + of.count) / (1.0 - jitter)
        if faster <= 0.0:
            return
        torque = (way * (first.rising + second.falling) + 3.0 * jitter * (first.size + second.size)) / self._holds
        torque += (first.changes + second.changes) * of.late / time
        hand = max(first.hand, second.hand)
        excess = of.mass * faster / (time * time) - torque - hand * (1.0 + jitter) + of.friction * (1.0 - jitter)
        self.excess = max(self.excess, excess)
