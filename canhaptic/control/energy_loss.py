"""Check of the energy that a port gave out against its declared limit, independent of the controller."""

from collections.abc import Sequence

from canhaptic.signals import Sample


class EnergyLossMeter:
    """Energy that came in by one port, from the applied torques and measured positions alone.

    The uncertainty due to lost samples is not subtracted: a controller books it at its worst, and a run would end for
    energy that was never given out. What the damping of the device certainly dissipates is added, as a certificate by
    damping counts on it.

    Args:
        name: Name of the port.
        axes: Places of its axes in the rig.
        limit: Energy that may be given out beyond the allowance [J].
        allowance: Energy that may be given out by declaration [J].
        damping: Certain damping of the device, one value per axis [N*s/m or N*m*s/rad].
        sample_time: Sample time [s].

    Attributes:
        energy: Energy that came in so far; negative where more was given out [J].
    """

    __slots__ = (
        "_booked_at", "_by_speed", "_is_group", "_positions", "allowance", "axes", "energy", "floor", "limit", "name",
    )  # fmt: skip

    def __init__(
        self,
        name: str,
        axes: Sequence[int],
        limit: float,
        allowance: float,
        damping: Sequence[float],
        sample_time: float,
    ) -> None:
        self.name, self.axes = name, tuple(axes)
        self.limit, self.allowance, self.energy = limit, allowance, 0.0
        self.floor = -(limit + allowance)
        self._by_speed = [(axis, value / sample_time) for axis, value in zip(self.axes, damping, strict=True)]
        self._is_group = len(self.axes) > 1
        self._positions = dict.fromkeys(self.axes, 0.0)
        self._booked_at = -1

    def take(self, samples: Sequence[Sample], deadline: int) -> bool:
        """Count the hold that ended; return whether more was given out than the floor allows.

        Args:
            samples: Samples of the whole rig; where one of the port's is not fresh, the next fresh one counts for all
                holds.
            deadline: Sample times from the first SYNC to this one; SYNCs that were skipped count.
        """
        booked_at, positions = self._booked_at, self._positions
        if self._is_group and not all(samples[axis].fresh for axis in self.axes):
            return False
        for axis, by_speed in self._by_speed:
            _, position, torque, _, fresh = samples[axis]
            if not fresh:
                return False
            moved = position - positions[axis]
            positions[axis] = position
            if booked_at >= 0:
                energy = self.energy + -torque * moved  # `interaction_energy`
                self.energy = energy + by_speed * moved * moved / (deadline - booked_at)
        self._booked_at = deadline
        return self.energy < self.floor
