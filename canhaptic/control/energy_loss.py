"""Whether a port gave out more energy than was declared: counted apart from its controller, so that a run can end."""

from collections.abc import Sequence

from canhaptic.control.balance import interaction_energy
from canhaptic.signals import Sample


class EnergyLossMeter:
    """The energy that came in by one port, from the torques applied and the positions read alone.

    What lost samples leave open is not taken off: a controller books it at its worst, and a run would end for energy
    that was never given out. What the damping of the device certainly dissipates is added, as a certificate by damping
    counts on it.

    Args:
        name: Of the port.
        axes: Places of its axes in the rig.
        limit: Energy that may be given out beyond the allowance [J].
        allowance: Energy that may be given out by declaration [J].
        damping: Certain damping of the device, one value per axis [N*s/m or N*m*s/rad].
        sample_time: [s]

    Attributes:
        energy: That came in so far; negative where more was given out [J].
    """

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
        self._by_speed = [value / sample_time for value in damping]
        self._positions: list[float] = []
        self._sync_index = 0

    def take(self, samples: Sequence[Sample]) -> bool:
        """Counts the hold that ended; returns whether more was given out than the floor allows.

        Args:
            samples: Of the whole rig; where one of the port's is not fresh, the next that is counts for all holds.
        """
        for axis in self.axes:
            if not samples[axis].fresh:
                return False
        positions, index = self._positions, samples[0].sync_index
        if not positions:
            self._positions, self._sync_index = [samples[axis].position for axis in self.axes], index
            return False
        holds, self._sync_index = index - self._sync_index, index
        for place, axis in enumerate(self.axes):
            sample = samples[axis]
            moved = sample.position - positions[place]
            positions[place] = sample.position
            self.energy += interaction_energy(sample.torque_applied, moved)
            self.energy += self._by_speed[place] * moved * moved / holds
        return self.energy < self.floor
