"""Torque measurement of the simulated drive (0x6077): the motor's torque, through a filter, with a sensor's error."""

import math
from typing import Final, Protocol

from canhaptic.sim.drive.drive_parameters import SimulatedDriveParameters

_LARGEST: Final = 0x7FFF  # 0x6077 is INTEGER16


class _TorqueSource(Protocol):
    """A motor; an attribute `motor_torque` [N*m or N], if it has one, is the torque behind its current loop."""

    @property
    def position(self) -> float:
        """True position [rad or m]."""


class TorqueMeter:
    """Measures the torque of a motor.

    0x6077 = filter(motor torque) * (1 + ripple * sin(2 pi position / pitch)), the filter of first order and exact for a
    torque that is constant since the last measurement. Without lag, ripple and current loop it is the demand itself.

    Args:
        motor: Motor whose torque is measured.
        parameters: Lag and ripple.

    Attributes:
        is_ideal: Whether the measurement equals the demand.
    """

    def __init__(self, motor: _TorqueSource, parameters: SimulatedDriveParameters) -> None:
        self._motor = motor
        self._has_own_torque = getattr(motor, "motor_torque", None) is not None
        self._lag = parameters.torque_lag
        self._ripple = parameters.torque_ripple
        self.is_ideal = not (self._has_own_torque or self._lag or self._ripple)
        self._wave_number = 2.0 * math.pi / parameters.torque_ripple_pitch
        self.reset()

    def reset(self) -> None:
        """Clear the measurement."""
        self._filtered, self._measured_at = 0.0, 0

    def counts(self, now: int, held: float, quantum: float) -> int:
        """Measured torque at `now` [ns] in counts; 0 without a rated torque, and where the torque is not finite.

        Args:
            now: Time [ns], never before the last one.
            held: Torque held by the power stage [N*m or N].
            quantum: Torque of one count, with its sign [N*m or N].
        """
        torque = float(getattr(self._motor, "motor_torque")) if self._has_own_torque else held  # noqa: B009
        if self._lag:
            share = math.exp(-(now - self._measured_at) * 1e-9 / self._lag)
            torque = self._filtered = torque + (self._filtered - torque) * share
            self._measured_at = now
        try:
            if self._ripple:
                torque *= 1.0 + self._ripple * math.sin(self._wave_number * self._motor.position)
            counts = round(torque / quantum)
        except (ZeroDivisionError, ValueError, OverflowError):  # no rated torque, or a motor that has diverged
            return 0
        return max(-_LARGEST - 1, min(_LARGEST, counts))
