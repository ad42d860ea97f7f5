"""The independent torque limiter: after the controller, before the bus. It limits every torque.

Each limit leaves an interval of torques that contains zero, so that their intersection is an interval too,
the order of the limits does not matter, and zero is never forbidden:

    magnitude   -torque_limit .. torque_limit
    rate        from the last torque by one step further out, and by one step beyond zero on the other side: a torque
                falls to zero at once and rises, on either side, no faster than the rate
    power       torque * velocity <= power_limit, with the velocity over the hold that ended: a torque against the
                motion is not limited, because it takes power from the user
"""

import math

from canhaptic.errors import ControlError, ParameterError


class TorqueLimiter:
    """Limits the torque of one axis in magnitude, rate and power.

    Args:
        torque_limit: Largest magnitude [N*m or N].
        sample_time: Sample time [s].
        rate_limit: Largest rise per second, on either side of zero [N*m/s or N/s]; None: no limit.
        power_limit: Largest power into the user's side [W]; None: no limit.

    Attributes:
        last: Torque of the last cycle after the limits [N*m or N].
        low: Least torque that the last cycle allowed, 0 or below [N*m or N]; a rounded `last` must not pass it.
        high: Largest torque that the last cycle allowed, 0 or above [N*m or N].

    Raises:
        ParameterError: A limit is not positive.
    """

    __slots__ = ("_is_alone", "_limit", "_power", "_step", "high", "last", "low")

    def __init__(
        self,
        torque_limit: float,
        sample_time: float,
        rate_limit: float | None = None,
        power_limit: float | None = None,
    ) -> None:
        rate = math.inf if rate_limit is None else rate_limit
        self._power = math.inf if power_limit is None else power_limit
        for value in (torque_limit, sample_time, rate, self._power):
            if not value > 0.0:  # NaN as well
                raise ParameterError(
                    f"the torque limiter got {value}, expected positive numbers: torque limit {torque_limit}, "
                    f"sample time {sample_time}, rate limit {rate_limit}, power limit {power_limit}"
                )
        self._limit = torque_limit
        self._step = rate * sample_time
        self._is_alone = rate_limit is None and power_limit is None
        self.reset()

    def reset(self) -> None:
        """Clear the last torque."""
        self.last = self.low = self.high = 0.0

    def limit(self, torque: float, velocity: float) -> float:
        """Return the torque [N*m or N] that may go to the drive: the nearest that all limits allow.

        Args:
            torque: Torque requested by the controller [N*m or N].
            velocity: Velocity of the axis over the last hold [m/s or rad/s].

        Raises:
            ControlError: The torque or the velocity is not finite. No torque could replace it.
        """
        if torque - torque != 0.0 or velocity - velocity != 0.0:  # true for inf and NaN alone
            self.last = self.low = self.high = 0.0
            raise ControlError(
                f"the controller gave a torque of {torque} at a velocity of {velocity}, "
                "expected a finite number for each; zero was sent"
            )
        limit, last = self._limit, self.last
        if self._is_alone and -limit <= torque <= limit:
            self.low, self.high, self.last = -limit, limit, torque
            return torque
        low, high = -self._step, self._step
        if last > 0.0:
            high += last
        else:
            low += last
        low = low if low > -limit else -limit
        high = high if high < limit else limit
        if velocity > 0.0:
            most = self._power / velocity
            high = most if most < high else high
        elif velocity < 0.0:
            least = self._power / velocity
            low = least if least > low else low
        if not low <= torque <= high:
            torque = low if torque < low else high
        self.low, self.high, self.last = low, high, torque
        return torque


class DryRunLimiter(TorqueLimiter):
    """The limiter of a dry run: every torque becomes 0.

    Attributes:
        withheld: Largest torque that the limiter of a run would have permitted after a cycle of zero torque [N*m or N].
    """

    __slots__ = ("withheld",)

    def reset(self) -> None:
        """Clear the last torque and the largest one."""
        super().reset()
        self.withheld = 0.0

    def limit(self, torque: float, velocity: float) -> float:
        """Return 0, and record the result of `TorqueLimiter.limit`.

        Raises:
            ControlError: The torque or the velocity is not finite, as in a run.
        """
        self.withheld = max(self.withheld, abs(super().limit(torque, velocity)))
        self.last = self.low = self.high = 0.0
        return 0.0
