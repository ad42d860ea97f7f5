"""Check of a run against the declared dry friction of its device, from measured positions and torques.

Over two stretches of time T_1 and T_2 of a motion one way, s = 1 or -1, with w(t) rising from 0 to 1 over the first and
falling over the second, the equation of motion m a = tau + u - s F gives by parts, for the mean speeds v_1 and v_2,

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
from math import inf
from typing import Final

_STRETCH: Final = 0.01  # [s]


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
        self._holds = max(2, round(_STRETCH / declared.sample_time))
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
