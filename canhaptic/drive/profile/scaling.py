"""Conversion between SI and drive units of one axis; nothing else converts on the master's side.

Positions are 32-bit counts that wrap; torques are per mille of the rated torque (0x6076, in mN*m or mN).
"""

import math
from typing import Final

from canhaptic.drive.profile.quirks import quirks_of
from canhaptic.drive.profile.torque_axis_parameters import TorqueAxisParameters
from canhaptic.errors import ParameterError

_WRAP: Final = 1 << 32  # 0x6064 is INTEGER32
_HALF: Final = 1 << 31
_LARGEST_PER_MILLE: Final = 32_767  # 0x6071 is INTEGER16
_PER_MILLE: Final = 1000.0


class AxisScaling:
    """Converts one axis; remembers the last position so that a wrapped counter continues.

    Args:
        counts_per_unit: Position counts per metre or radian.
        rated_torque: Rated torque of the axis at 1000 per mille [N*m or N].
        direction: 1 or -1, for position and torque together.

    Raises:
        ParameterError: A factor is not positive and finite.
    """

    __slots__ = ("_counts", "_torque_quantum", "_unit_per_count", "rated_torque")

    def __init__(self, counts_per_unit: float, rated_torque: float, direction: int = 1) -> None:
        for name, value in (("counts_per_unit", counts_per_unit), ("rated_torque", rated_torque)):
            if not (math.isfinite(value) and value > 0.0):
                raise ParameterError(f"{name}: got {value}, expected a positive finite number")
        self.rated_torque = rated_torque
        self._unit_per_count = direction / counts_per_unit
        self._torque_quantum = direction * rated_torque / _PER_MILLE
        self.reset()

    def reset(self) -> None:
        """Clear the last position, so that the next 0x6064 is taken as it is."""
        self._counts = 0

    def position(self, position_counts: int) -> float:
        """Return the position [m or rad] of the next 0x6064; a step across the wrap of INTEGER32 is no jump."""
        step = position_counts - self._counts
        if not -_HALF <= step < _HALF:
            step = (step + _HALF) % _WRAP - _HALF
        self._counts = counts = self._counts + step
        return counts * self._unit_per_count

    def torque(self, torque_per_mille: int) -> float:
        """Return a torque of the drive (0x6071, 0x6074, 0x6077) in [N*m or N]."""
        return torque_per_mille * self._torque_quantum

    def torque_per_mille(self, torque: float, low: float, high: float) -> int:
        """Return the nearest target torque (0x6071) that is not beyond `low` or `high`.

        Args:
            torque: Requested torque, finite, from `low` to `high` [N*m or N].
            low: Least torque allowed, 0 or below [N*m or N].
            high: Largest torque allowed, 0 or above [N*m or N].
        """
        exact = torque / self._torque_quantum
        per_mille = round(exact)
        if not low <= per_mille * self._torque_quantum <= high:
            per_mille = _toward_zero(exact)
        return per_mille

    @property
    def torque_quantum(self) -> float:
        """Smallest step of torque [N*m or N]."""
        return abs(self._torque_quantum)

    @property
    def largest_torque(self) -> float:
        """Largest torque that 0x6071 can carry [N*m or N]."""
        return _LARGEST_PER_MILLE * self.torque_quantum


def axis_scaling(axis: TorqueAxisParameters, rated_torque: float) -> AxisScaling:
    """Return the scaling of an axis.

    Args:
        axis: Parameters of the axis; its quirks may change the unit of torque.
        rated_torque: Rated torque of the axis [N*m or N], as agreed between drive and configuration.

    Raises:
        ParameterError: A factor is not positive and finite.
    """
    return AxisScaling(axis.counts_per_unit, rated_torque * quirks_of(axis.quirks).torque_scale, axis.direction)


def torque_limit_per_mille(torque_limit: float, rated_torque: float) -> int:
    """Return the value of 0x6072 for a limit [N*m or N]: rounded down, so that the drive never allows more."""
    return _toward_zero(torque_limit / rated_torque * _PER_MILLE)


def _toward_zero(exact: float) -> int:
    """Round towards zero, after adding 1e-9 to the magnitude: 0.3 of 1.0 is 300 per mille and not 299."""
    return math.trunc(exact + math.copysign(1e-9, exact))
