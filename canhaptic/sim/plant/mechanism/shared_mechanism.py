"""One mechanism behind several drives: each drive has its own motor, and all motors move together.

When a drive moves its motor to a time, the torques of the other motors up to that time are read from their drives. This
is valid because a drive moves its motor BEFORE it changes its torque.
"""

from collections.abc import Callable

from canhaptic.signals import PlantEnergy
from canhaptic.sim.plant.mechanism import Mechanism


class SharedMechanism:
    """A mechanism and its motors.

    Args:
        mechanism: Mechanism before `begin`; it is at rest until the last of its drives is enabled.
        axes: Number of its motors.

    Attributes:
        mechanism: The mechanism.
        motors: Motors in the order of the axes, one for each drive; connect all before the first SYNC.
    """

    def __init__(self, mechanism: Mechanism, axes: int) -> None:
        self.mechanism = mechanism
        self.motors = tuple(MechanismMotor(self, axis) for axis in range(axes))
        self._waiting = set(range(axes))
        self._moved_to: int | None = None

    def begin(self, axis: int, now: int) -> None:
        """Record that the drive of one axis is enabled; the last one starts the clock."""
        self._waiting.discard(axis)
        if not self._waiting and self._moved_to is None:
            self.mechanism.begin(now)
            self._moved_to = now

    def advance_to(self, now: int) -> None:
        """Move everything to `now` [ns] under the torques that the drives hold."""
        if now != self._moved_to and self._moved_to is not None:
            self.mechanism.advance_to(now, tuple(motor.torque() for motor in self.motors))
            self._moved_to = now


class MechanismMotor:
    """One motor of a mechanism, as its drive sees it (a `canhaptic.sim.drive.profile.servo.Motor`)."""

    def __init__(self, shared: SharedMechanism, axis: int) -> None:
        self.shared = shared
        self.axis = axis
        self.torque: Callable[[], float] = lambda: 0.0
        """Reports the torque that the drive holds [N*m or N]; set by `connect`."""

    def connect(self, torque: Callable[[], float]) -> None:
        """Set the source of the torque that the drive of this motor holds."""
        self.torque = torque

    @property
    def position(self) -> float:
        """True position [m or rad]."""
        return self.shared.mechanism.positions[self.axis]

    @property
    def velocity(self) -> float:
        """True velocity [m/s or rad/s]."""
        return self.shared.mechanism.velocities[self.axis]

    def begin(self, now: int) -> None:
        """Start the clock at `now` [ns], when this is the last motor of the mechanism to begin."""
        self.shared.begin(self.axis, now)

    def advance_to(self, now: int, torque: float) -> None:
        """Move the whole mechanism to `now` [ns]; the torque of this motor is read from its drive."""
        self.shared.advance_to(now)

    def energy(self) -> PlantEnergy:
        """True energies through this motor since the start [J]."""
        return self.shared.mechanism.energy(self.axis)
