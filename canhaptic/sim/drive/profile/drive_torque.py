"""Torque on the drive's side: per mille of rated torque to the torque at the axis, and the drive's own limits."""

from collections.abc import Callable

from canhaptic.canopen.objects import MAX_TORQUE, RATED_TORQUE, TARGET_TORQUE, DataType
from canhaptic.errors import ParameterError
from canhaptic.sim.drive.drive_parameters import SimulatedDriveParameters
from canhaptic.sim.drive.profile.object_store import Entry, ObjectStore


class TorqueStage:
    """Limits a target torque (0x6071) to a demand (0x6074) and scales it to the axis.

    The rated torque is what 0x6076 shows, so that master and drive cannot differ by a rounding; where the dictionary
    has no 0x6076 it is the parameter itself. A dictionary without 0x6071 gives a stage without torque.

    Raises:
        ParameterError: No rated torque is stated anywhere, or it is not a whole number of counts of 0x6076.
    """

    def __init__(self, store: ObjectStore, parameters: SimulatedDriveParameters, on_change: Callable[[], None]) -> None:
        self._target = store.entry(TARGET_TORQUE, DataType.INTEGER16)
        self._max_torque = store.find(MAX_TORQUE)
        self._rated = store.find(RATED_TORQUE)
        self._parameters = parameters
        if parameters.rated_torque is not None and self._rated is not None:
            counts = _counts(parameters) if parameters.rated_torque_stated else 0
            if counts > _largest(self._rated):
                raise ParameterError(
                    f"rated_torque: 0x6076 of the dictionary cannot hold {counts}; correct its data type"
                )
            self._rated.initial = self._rated.value = counts
        if store.find(TARGET_TORQUE) is not None and self._rated_torque() <= 0.0:
            seen = "no such object" if self._rated is None else f"value {self._rated.value!r}"
            raise ParameterError(
                f"rated_torque: got none, and the dictionary states none (0x6076: {seen}); "
                "give the rated torque of the motor in the parameters of the simulated drive"
            )
        for entry in (self._max_torque, self._rated):
            if entry is not None:
                entry.changed = on_change
        self.reload()

    def _rated_torque(self) -> float:
        if self._rated is not None and self._rated.number > 0:
            return self._rated.number * self._parameters.rated_torque_resolution
        return self._parameters.rated_torque or 0.0

    def reload(self) -> None:
        """Apply rated torque and limits from the objects."""
        # [N or N*m] per count of 0x6071
        self.quantum = self._rated_torque() / round(1.0 / self._parameters.torque_resolution, 9)
        limit = float("inf")
        if self._max_torque is not None and self._max_torque.value is not None:
            limit = self._max_torque.number
        if self._parameters.torque_limit is not None and self.quantum > 0.0:
            # Tiny allowance: a limit given as a whole number of per mille must not lose one to rounding.
            limit = min(limit, int(self._parameters.torque_limit / self.quantum * (1.0 + 1e-12)))
        self._low = int(max(self._target.low, -limit))
        self._high = int(min(self._target.high, limit))

    @property
    def largest(self) -> float:
        """Largest torque by 0x6072 and the drive itself [N or N*m]; inf where the type of 0x6071 is its only limit."""
        return self._high * self.quantum if self._high < self._target.high else float("inf")

    def limit(self, target: int) -> int:
        """Return the torque demand [per mille of rated torque] for a target."""
        if target > self._high:
            return self._high
        return target if target >= self._low else self._low


def _largest(entry: Entry) -> float:
    """Return the largest value of the type of an object; limits for writing do not count."""
    return Entry(entry.index, entry.subindex, entry.data_type).high if entry.size else -1


def _counts(parameters: SimulatedDriveParameters) -> int:
    exact = (parameters.rated_torque or 0.0) / parameters.rated_torque_resolution
    counts = round(exact)
    if abs(exact - counts) > 1e-6 * exact or counts > 0xFFFF_FFFF:
        raise ParameterError(
            f"rated_torque: got {parameters.rated_torque}, expected a whole number of "
            f"{parameters.rated_torque_resolution} (what 0x6076 can show), at most {0xFFFF_FFFF} of them"
        )
    return counts
