"""Simulated mechanisms that several drives move together: their interface, their table, and their motors.

A mechanism is a frozen parameter model with `build(hand, sample_time_ns, substeps)`; it is imported only if a scene
names it. The hand holds the handle in task space, in metres, with linear and with rotary motors.

`SharedMechanism` gives each drive one motor of the mechanism. When a drive moves its motor to a time, the torques of
the other motors up to that time are read from their drives. This is valid because a drive moves its motor BEFORE it
changes its torque.
"""

from collections.abc import Callable
from typing import TYPE_CHECKING, ClassVar, Final, Protocol

from canhaptic.axis_units import Motion
from canhaptic.signals import PlantEnergy

if TYPE_CHECKING:
    from canhaptic.sim.plant.mechanism.task_hand import TaskHand

MECHANISMS: Final[dict[str, str]] = {
    "five_bar": "canhaptic.sim.plant.mechanism.five_bar_linkage:FiveBarLinkage",
    "xy_stage": "canhaptic.sim.plant.mechanism.xy_stage:XYStage",
}
"""Name in a scene -> "module:Class" of its frozen parameters."""


class Mechanism(Protocol):
    """A mechanism in motion: motors, links and hand, moved by torques that are constant from call to call."""

    @property
    def positions(self) -> tuple[float, ...]:
        """True positions of the motor axes [m or rad]."""

    @property
    def velocities(self) -> tuple[float, ...]:
        """True velocities of the motor axes [m/s or rad/s]."""

    @property
    def handle(self) -> tuple[float, float]:
        """Position of the handle in task space [m]."""

    def begin(self, now: int) -> None:
        """Start its clock at `now` [ns]; until then it is at rest."""

    def advance_to(self, now: int, torques: tuple[float, ...]) -> None:
        """Move to `now` [ns] under torques [N*m or N] that were constant since the last call; at rest before `begin`.

        Raises:
            ParameterError: `now` lies before the last call, or no motion is found under these torques.
        """

    def energy(self, axis: int) -> PlantEnergy:
        """True energies through one motor axis since the start [J].

        The sum over all axes is the energy of the mechanism. `motor` is the sum of torque times displacement of that
        motor, the negative of its true sum of h_i.
        """


class MechanismParameters(Protocol):
    """Interface of every entry of `MECHANISMS`."""

    motion: ClassVar[Motion]
    """Position unit of its motor axes."""
    axes: ClassVar[int]
    """Number of motors."""
    order: ClassVar[int | None]
    """Order of the error in the substep; None if the motion is exact between events."""

    def build(self, hand: "TaskHand | None", sample_time_ns: int, substeps: int) -> Mechanism:
        """The mechanism at rest in its initial pose, before `begin`.

        Args:
            hand: Hand at the handle; None without a hand.
            sample_time_ns: T [ns].
            substeps: Number of substeps in one sample time, for a mechanism that is not exact.

        Raises:
            ParameterError: The initial pose is not possible.
        """


class SharedMechanism:
    """A mechanism that several drives move, each by a motor of its own.

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
