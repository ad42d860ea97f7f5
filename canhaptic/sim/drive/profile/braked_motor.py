"""A motor behind a holding brake: while it holds, the motor neither moves nor ages."""

from math import inf
from typing import Any

from canhaptic.canopen.brake import Brake


class BrakedMotor:
    """Moves a motor whose brake is set at first.

    Args:
        motor: The motor.
        brake: Holding brake with its delays.
    """

    def __init__(self, motor: Any, brake: Brake) -> None:
        self._motor = motor
        self._release, self._set = round(brake.release_time * 1e9), round(brake.set_time * 1e9)
        self._is_open = False
        self._opens, self._holds = inf, inf  # times from which it is open, and holds again [ns]
        self._seen = self._age = 0  # time of the last call, and that of the motor, which stands still meanwhile [ns]

    def command(self, now: int, *, is_open: bool) -> None:
        """Open or set the brake; it follows after its delay."""
        if is_open and not self._is_open:
            self._opens, self._holds = now + self._release, inf
        elif self._is_open and not is_open:
            self._holds = now + self._set
        self._is_open = is_open

    def holds(self, now: int) -> bool:
        """Whether the brake holds."""
        return not self._opens <= now < self._holds

    def begin(self, now: int) -> None:
        """Start the clock of the motor."""
        self._motor.begin(now)
        self._seen = self._age = now

    def advance_to(self, now: int, torque: float) -> None:
        """Move to `now` [ns] under a constant torque, for as long as the brake is open."""
        free = min(now, self._holds) - max(self._seen, self._opens)
        self._seen = now
        if free > 0:
            self._age += int(free)
            self._motor.advance_to(self._age, torque)
