"""How far the booked energy of an axis may be from the true one: what its sensors and its drive leave open.

**Position.** A position p_k = x_k + e_k, |e_k| <= e, is booked as -f_k (p_k - p_(k-1)). The sum of n holds is wrong by
-sum f_k (e_k - e_(k-1)), by parts at most e (|f_n| + sum |f_k - f_(k-1)|), with f_0 = 0: a torque that stays leaves
nothing open however long the axis moves.

**Torque.** A motor that gives f (1 + s) + c for a torque f, |s| <= share and |c| <= offset, leaves open
sum (share |f_k| + offset) |x_k - x_(k-1)|, if the axis does not turn back within a hold.
"""

from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True, slots=True)
class SensorErrors:
    """Largest errors of what is booked."""

    position: float = 0.0  # of a position, a constant part left out [m or rad]
    torque_share: float = 0.0  # of the torque
    torque_offset: float = 0.0  # [N or N*m]


IDEAL: Final = SensorErrors()


class EnergyResolution:
    """Adds up, hold by hold, what is left open of the energy of one axis.

    Args:
        errors: Of the axis.

    Attributes:
        value: Largest |booked - true| sum of interaction so far [J]; never falls.
    """

    __slots__ = ("_changes", "_errors", "_position", "_started", "_torque", "_uneven", "value")

    def __init__(self, errors: SensorErrors = IDEAL) -> None:
        self._errors = errors
        self._started = False
        self._position = self._torque = self._changes = self._uneven = 0.0
        self.value = 0.0

    def take(self, position: float, torque: float) -> None:
        """Takes a hold that was booked.

        Args:
            position: At its end [m or rad].
            torque: Booked for it [N or N*m].
        """
        if not self._started:
            self._started, self._position = True, position
            return
        errors = self._errors
        moved, self._position = abs(position - self._position), position
        if torque == 0.0 == self._torque:
            return
        self._changes += abs(torque - self._torque)
        self._torque = torque
        if errors.torque_share or errors.torque_offset:
            moved += 2.0 * errors.position
            self._uneven += (errors.torque_share * abs(torque) + errors.torque_offset) * moved
        value = errors.position * (self._changes + abs(torque)) + self._uneven
        if value > self.value:
            self.value = value
