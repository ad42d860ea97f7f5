"""The force sensor as its drive reports it: counts to a force, and the reasons not to believe it."""

from math import inf

from canhaptic.drive.profile.display_parameters import ForceParameters


class ForceChannel:
    """Turns the counts of a force sensor into the force of the hand.

    Args:
        force: Its parameters.

    Attributes:
        force: The last one [N or N*m].
        same: SYNCs in a row with one count, beyond the error of the sensor.
        is_wrong: Whether it is beyond the range, or the sensor has shown one count for too long.
    """

    def __init__(self, force: ForceParameters) -> None:
        self._per_count, self._offset = force.per_count, force.offset_counts
        self._range, self._error = force.range, force.error
        self._frozen_after = force.frozen_after or inf
        self.reset()

    def reset(self) -> None:
        """Forgets what was received."""
        self.force, self.same, self.is_wrong = 0.0, 0, False
        self._counts: int | None = None

    def take(self, counts: int) -> float:
        """Returns the force of the hand towards +q [N or N*m]."""
        force = (counts - self._offset) * self._per_count
        self.force, limit, error = force, self._range, self._error
        self.same = self.same + 1 if counts == self._counts and not -error <= force <= error else 0
        self._counts = counts
        self.is_wrong = not -limit <= force <= limit or self.same >= self._frozen_after
        return force

    @property
    def is_beyond_range(self) -> bool:
        """Whether the force is more than the sensor can show."""
        return not -self._range <= self.force <= self._range
