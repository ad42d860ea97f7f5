"""The force sensor as its drive reports it: counts to a force, and the checks that reject it."""

from math import inf

from canhaptic.drive.profile.display_parameters import ForceParameters


class ForceChannel:
    """Turns the counts of a force sensor into the force of the hand.

    Args:
        force: Its parameters.
        sample_time: T [s].

    Attributes:
        force: Last force [N or N*m].
        same: SYNCs in a row with one count, within the error of the sensor.
        is_wrong: Whether it is beyond the range, or the sensor has shown one count for too long.
    """

    def __init__(self, force: ForceParameters, sample_time: float) -> None:
        self._time = sample_time if force.sampling == "impulse" else 0.0
        self._half = 1 << (force.bits - 1)
        self._per_count, self._offset = force.per_count, force.offset_counts
        self._range, self._error = force.range, force.error
        self._frozen_after = force.frozen_after or inf
        self.reset()

    def reset(self) -> None:
        """Clear the received values."""
        self.force, self.same, self.is_wrong = 0.0, 0, False
        self._counts: int | None = None

    def of(self, counts: int) -> float:
        """Force for a number of counts [N or N*m]; not for a running impulse."""
        return (counts - self._offset) * self._per_count

    def take(self, counts: int, periods: int = 1) -> float:
        """Return the force of the hand towards +q [N or N*m]; of a running impulse its mean over the holds between.

        Args:
            counts: Counts in the process data.
            periods: Sample times since the last value.
        """
        if self._time:
            return self._take_impulse(counts, periods)
        force = (counts - self._offset) * self._per_count
        self.force, limit, error = force, self._range, self._error
        self.same = self.same + 1 if counts == self._counts and not -error <= force <= error else 0
        self._counts = counts
        self.is_wrong = not -limit <= force <= limit or self.same >= self._frozen_after
        return force

    def _take_impulse(self, counts: int, periods: int) -> float:
        before, half = self._counts, self._half
        change = 0 if before is None else (counts - before + half) % (2 * half) - half
        self._counts = counts
        self.force = change * self._per_count / (periods * self._time)
        self.is_wrong = self.is_beyond_range
        return self.force

    @property
    def is_beyond_range(self) -> bool:
        """Whether the force exceeds the range of the sensor."""
        return not -self._range <= self.force <= self._range
