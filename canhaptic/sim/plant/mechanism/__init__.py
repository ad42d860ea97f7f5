"""Simulated mechanisms that several drives move together, one per file, and their table.

A mechanism is a frozen parameter model with `build(hand, sample_time_ns, substeps)`; it is imported only if a scene
names it. The hand holds the handle in task space, in metres, with linear and with rotary motors.
"""

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
