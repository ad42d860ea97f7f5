"""The commands between their computation and the end of the hold in which they acted.

With a delay of n samples, n + 1 commands are under way when a new one is computed (design: a synchronous RPDO delays by
one). What was inside a command - damper effort, modulated damper - is kept with it, so that the hold is booked with the
efforts that were inside the torque applied in that very hold. Booked with the newest efforts instead, the velocity of
the paper's algorithm has a pole at -1.618 for a delay of one sample.
"""

from collections import deque
from math import inf, isfinite
from typing import TypeAlias

from canhaptic.errors import ControlError

Command: TypeAlias = tuple[float, float, float]
"""A torque and the efforts inside it [N or N*m], torque = -(spring + damper + modulated): (torque, effort d v of the
model's damper, effort d_pas v of the modulated damper of eq. 19)."""

NO_TORQUE: Command = (0.0, 0.0, 0.0)


class CommandsInFlight:
    """Position and commands of the holds that have not been booked yet.

    Args:
        delay: Whole holds between computation and action.
        largest: Largest torque that limiter and drive let act [N*m or N]; None: any.

    Attributes:
        holds: How many holds the displacement last returned spans; 1 unless positions were lost.
        uncertainty: Largest error of torque applied times that displacement [J]; 0 for one hold.
    """

    __slots__ = ("_delay", "_largest", "_lost", "_position", "_previous", "_queue", "holds", "uncertainty")

    def __init__(self, delay: int, largest: float | None = None) -> None:
        self._delay = delay
        self._largest = inf if largest is None else largest
        self.reset()

    def reset(self) -> None:
        """Forgets the last position; no torque in flight."""
        self._position: float | None = None
        self._previous = 0.0
        self._lost: list[float] = []
        self.holds, self.uncertainty = 1, 0.0
        self._queue: deque[Command] = deque([NO_TORQUE] * (self._delay + 1))

    def ended_hold(self, position: float, torque_applied: float) -> tuple[float, float, float] | None:
        """Returns (displacement, damper effort, modulated effort) of the hold that ended; None at the first position.

        The efforts are those inside the torque applied: a clipped torque scales both in proportion.

        Raises:
            ControlError: The position or torque is not finite, or their difference is not. Everything is forgotten.
        """
        last = self._position
        displacement = position if last is None else position - last
        if not isfinite(displacement + torque_applied):
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
        if self._lost or self.holds != 1:
            self._span(displacement, torque_applied)
        self._previous = displacement
        return displacement, damper, modulated

    def _span(self, displacement: float, torque_applied: float) -> None:
        """Counts the holds since the last position, and what is not known of the energy in them.

        Inside them the axis may have gone out and back, so that the excursion is not the displacement; it is taken as
        that and the motion before, for every hold lost.
        """
        excursion = abs(displacement) + len(self._lost) * abs(self._previous)
        self.holds = len(self._lost) + 1
        self.uncertainty = sum(abs(torque - torque_applied) for torque in self._lost) * excursion
        self._lost.clear()

    def lose_hold(self) -> float:
        """Takes note of a SYNC without a position: one more hold to be booked later, the newest command repeated.

        Returns:
            The torque of the hold, as far as it can have acted [N or N*m].
        """
        largest = self._largest
        torque = min(max(self._queue[0][0], -largest), largest)
        if self._position is not None:
            newest = self._queue[-1]
            self._lost.append(torque)
            self._queue.popleft()
            self._queue.append(newest)
        return torque

    def send(self, torque: float, damper: float, modulated: float) -> None:
        """Takes the command that was just computed.

        Raises:
            ControlError: The torque is not finite. Everything is forgotten.
        """
        if not isfinite(torque):
            self.reset()
            raise ControlError(
                f"controller: computed torque {torque!r}, expected a finite number; torque is zero and the controller "
                "is to be reset, check stiffness and damping against the size of the motion"
            )
        self._queue.append((torque, damper, modulated))

    @property
    def torques(self) -> tuple[float, ...]:
        """Torques of the commands sent whose hold has not ended, the one that acts next (or acts now) first."""
        return tuple(torque for torque, _, _ in self._queue)
