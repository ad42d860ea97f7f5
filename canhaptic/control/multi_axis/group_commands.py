"""The torques of a group from their computation to the end of the hold in which they acted, with what was in them."""

from collections import deque
from collections.abc import Sequence
from math import inf, isfinite
from typing import NamedTuple

from canhaptic.errors import ControlError

Values = tuple[float, ...]


class GroupCommand(NamedTuple):
    """Torques and the efforts inside them, per motor axis [N*m or N]; torque = -(spring + damper + modulated)."""

    torques: Values
    damper: Values  # of the network's dissipators at the ports
    modulated: Values  # of eq. 19
    ports: Values = ()  # effort at each port of the network, where it is asked what a mover gave by them
    power: float = 0.0  # of the dampers at the velocities they came from, times the sample time (eq. 18) [J]


class EndedHold(NamedTuple):
    """One hold, or several where samples were lost."""

    displacement: Values  # per motor axis [rad or m]
    damper: Values  # inside the torques applied in it [N*m or N]
    modulated: Values
    ports: Values
    power: float  # [J]
    skipped: tuple[Values, ...]  # torques sent for the holds whose samples were lost


class GroupCommands:
    """Positions and commands of the holds that have not been booked yet."""

    def __init__(self, axes: int, delay: int, largest: Sequence[float | None], ports: int = 0) -> None:
        """Makes an empty queue.

        Args:
            axes: Motor axes.
            delay: Whole holds between computation and action.
            largest: Largest torque of each axis that limiter and drive let act [N*m or N]; None: any.
            ports: Of the network, where the commands name the efforts there.
        """
        self.axes, self.delay = axes, delay
        self._largest = tuple([inf if limit is None else limit for limit in largest])
        zeros = (0.0,) * axes
        self.nothing = GroupCommand(zeros, zeros, zeros, (0.0,) * ports)
        self.reset()

    def reset(self) -> None:
        """Forgets the last positions; no torque in flight."""
        self._positions: Values | None = None
        self._queue: deque[GroupCommand] = deque([self.nothing] * (self.delay + 1))
        self._skipped: tuple[Values, ...] = ()

    def ended(self, positions: Values, torques_applied: Values) -> EndedHold | None:
        """Returns the hold that ended; None at the first positions.

        Raises:
            ControlError: Wrong number of values, or one that is not finite. Everything is forgotten.
        """
        last = self._positions
        total = 0.0
        for value in positions + torques_applied:
            total += value - value  # 0, or NaN where it is not finite
        if total != 0.0 or not len(positions) == len(torques_applied) == self.axes:
            self.reset()
            raise ControlError(
                f"group controller: got positions {positions} and applied torques {torques_applied}, expected "
                f"{self.axes} finite numbers each; torque is zero and the controller is to be reset, check the encoders"
            )
        self._positions = positions
        if last is None:
            self._skipped = ()
            return None
        command = self._queue.popleft()
        displacement = tuple([q - q0 for q, q0 in zip(positions, last, strict=True)])
        if torques_applied != command.torques:
            command = as_applied(command, torques_applied)
        skipped, self._skipped = self._skipped, ()
        return EndedHold(displacement, command.damper, command.modulated, command.ports, command.power, skipped)

    def send(self, command: GroupCommand) -> None:
        """Takes the command that was just computed.

        Raises:
            ControlError: A torque is not finite. Everything is forgotten.
        """
        if not isfinite(sum(command.torques)):
            self.reset()
            raise ControlError(
                f"group controller: computed torques {command.torques}, expected finite numbers; torque is zero and "
                "the controller is to be reset, check stiffness and damping against the size of the motion"
            )
        self._queue.append(command)

    def lose_hold(self) -> Values:
        """Takes note of a SYNC without all samples; returns the torques of the newest command, repeated."""
        newest = self._queue[-1]
        if self._positions is not None:
            lost = self._queue.popleft().torques
            self._skipped += (tuple([min(max(t, -most), most) for t, most in zip(lost, self._largest, strict=True)]),)
            self._queue.append(newest)
        return newest.torques

    @property
    def under_way(self) -> list[Values]:
        """Torques that act before the next command, the one that acts now first; right only after `ended`."""
        return [command.torques for command in self._queue] if self.delay else []


def as_applied(command: GroupCommand, applied: Values) -> GroupCommand:
    """Returns the efforts inside torques that were not applied as sent: in proportion, axis by axis."""
    shares = [min(1.0, max(0.0, a / t)) if t else 0.0 for a, t in zip(applied, command.torques, strict=True)]
    sent = sum(t * t for t in command.torques)
    along = sum(a * t for a, t in zip(applied, command.torques, strict=True))
    whole = min(1.0, max(0.0, along / sent)) if sent else 0.0
    return GroupCommand(
        applied,
        tuple([s * d for s, d in zip(shares, command.damper, strict=True)]),
        tuple([s * m for s, m in zip(shares, command.modulated, strict=True)]),
        tuple([whole * p for p in command.ports]),
        whole * whole * command.power,
    )
