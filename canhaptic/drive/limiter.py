"""The independent torque limiter: after the controller, before the bus. It trusts nobody and reports what it cut."""

import math
from enum import IntFlag

from canhaptic.errors import ControlError


class Saturation(IntFlag):
    """Which limits cut a torque; 0 when none did."""

    NONE = 0
    MAGNITUDE = 1
    RATE = 2
    POWER = 4


class TorqueLimiter:
    """Limits the torque of one axis in magnitude, rate and power.

    Args:
        torque_limit: Largest magnitude [N*m or N].
        sample_time: [s]
        rate_limit: Largest change per second [N*m/s or N/s]; None: any. Never slows a fall to zero.
        power_limit: Largest power into the user's side [W]; None: any.

    Attributes:
        last: Torque of the last cycle after the limits [N*m or N].
        saturation: Which limits cut it.
        saturated_cycles: How many cycles were cut so far.
    """

    __slots__ = ("_limit", "_power", "_step", "last", "saturated_cycles", "saturation")

    def __init__(
        self,
        torque_limit: float,
        sample_time: float,
        rate_limit: float | None = None,
        power_limit: float | None = None,
    ) -> None:
        self._limit = torque_limit
        self._step = math.inf if rate_limit is None else rate_limit * sample_time
        self._power = math.inf if power_limit is None else power_limit
        self.reset()

    def reset(self) -> None:
        """Forgets the last torque and the counts."""
        self.last = 0.0
        self.saturation = 0
        self.saturated_cycles = 0

    def limit(self, torque: float, velocity: float) -> float:
        """Returns the torque [N*m or N] that may go to the drive.

        Args:
            torque: What the controller asks for [N*m or N].
            velocity: Of the axis over the last hold [m/s or rad/s].

        Raises:
            ControlError: The torque is not finite. There is no torque that could stand for it.
        """
        if torque - torque != 0.0:  # true for inf and NaN alone
            self.last = 0.0
            raise ControlError(f"the controller gave a torque of {torque}, expected a finite number; zero was sent")
        saturation = 0
        limit, step = self._limit, self._step
        if not -limit <= torque <= limit:
            torque = math.copysign(limit, torque)
            saturation = 1
        if not -step <= torque - self.last <= step and abs(torque) > abs(self.last):
            torque = self.last + math.copysign(step, torque - self.last)
            saturation |= 2
        if torque * velocity > self._power:
            torque = self._power / velocity
            saturation |= 4
        self.last = torque
        self.saturation = saturation
        if saturation:
            self.saturated_cycles += 1
        return torque
