"""The commands between their computation and the end of the hold in which they acted.

With a delay of n samples, n + 1 commands are under way when a new one is computed (design: a synchronous RPDO delays by
one). What was inside a command - damper effort, modulated damper - is kept with it, so that the hold is booked with the
efforts that were inside the torque applied in that very hold. Booked with the newest efforts instead, the velocity of
the paper's algorithm has a pole at -1.618 for a delay of one sample.
"""

from collections import deque
from math import isfinite
from typing import NamedTuple

from canhaptic.errors import ControlError


class Command(NamedTuple):
    """A torque and the efforts inside it [N or N*m]: torque = -(spring + damper + modulated)."""

    torque: float
    damper: float  # effort of the model's damper, d v
    modulated: float  # effort of the modulated damper of eq. 19, d_pas v


NO_TORQUE = Command(0.0, 0.0, 0.0)


class CommandsInFlight:
    """Position and commands of the holds that have not been booked yet."""

    __slots__ = ("_delay", "_position", "_queue")

    def __init__(self, delay: int) -> None:
        self._delay = delay
        self.reset()

    def reset(self) -> None:
        """Forgets the last position; no torque in flight."""
        self._position: float | None = None
        self._queue: deque[Command] = deque([NO_TORQUE] * (self._delay + 1))

    def ended_hold(self, position: float, torque_applied: float) -> tuple[float, float, float] | None:
        """Returns (displacement, damper effort, modulated effort) of the hold that ended; None at the first position.

        The efforts are those inside the torque applied: a clipped torque scales both in proportion.

        Raises:
            ControlError: The position or torque is not finite, or their difference is not. Everything is forgotten.
        """
        last = self._position
        displacement = 0.0 if last is None else position - last
        if not isfinite(displacement + torque_applied) or not isfinite(position):
            self.reset()
            raise ControlError(
                f"controller: got position {position!r} and applied torque {torque_applied!r}, expected finite "
                "numbers; torque is zero and the controller is to be reset, check the encoder and its scaling"
            )
        self._position = position
        if last is None:
            return None
        torque, damper, modulated = self._queue.popleft()
        if torque_applied != torque and (damper or modulated):
            share = min(1.0, max(0.0, torque_applied / torque)) if torque else 0.0
            damper *= share
            modulated *= share
        return displacement, damper, modulated

    def send(self, torque: float, damper: float, modulated: float) -> None:
        """Takes the command that was just computed."""
        self._queue.append(Command(torque, damper, modulated))

    @property
    def torques(self) -> tuple[float, ...]:
        """Torques of the commands sent whose hold has not ended, the one that acts next (or acts now) first."""
        return tuple(command.torque for command in self._queue)
