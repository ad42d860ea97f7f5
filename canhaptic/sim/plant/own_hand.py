"""Base of a user-defined hand: write the force that it adds to the grip.

    class Startled(OwnHand):
        def force(self, time: float, position: float, velocity: float) -> float:
            return -5.0 if 1.0 < time < 1.2 else 0.0

Stiffness, damping, push and motion of the grip are as for every hand; the force adds to them. It is held over
each substep at the middle of the substep and solved together with the motion (`splitting.py`): second order in the
substep where it is smooth.
"""

from typing import ClassVar

from canhaptic.errors import ParameterError
from canhaptic.own_results import FORCE, watch
from canhaptic.sim.plant.assembly import Account, NonlinearForce, PlantModel
from canhaptic.sim.plant.user import UserParameters


class OwnHand(UserParameters):
    """A user-defined hand: a grip, and a force on the handle."""

    order: ClassVar[int | None] = 2  # of the error in the substep, by the splitting

    def force(self, time: float, position: float, velocity: float) -> float:
        """Return the force on the handle, towards +q [N or N*m].

        Args:
            time: Time since the start of the plant [s].
            position: Position of the handle [m or rad].
            velocity: Velocity of the handle [m/s or rad/s].
        """
        raise NotImplementedError(f"{type(self).__name__}: write force(time, position, velocity)")

    def add_to(self, scene: PlantModel) -> None:
        """Add the grip and the force.

        Raises:
            ParameterError: The handle is not the motor's body.
        """
        if len(scene.bodies) > 1:
            raise ParameterError("user: a hand of your own holds the motor's body; leave shaft_compliance out", "user")
        super().add_to(scene)
        scene.efforts.append(_OwnForce(self))


class _OwnForce(NonlinearForce):
    """The force of the hand as an effort of the plant; its work is the user's."""

    account: Account | None = "user"

    def __init__(self, hand: OwnHand) -> None:
        watch(type(hand), ("force",), FORCE)
        self._hand = hand
        self._time = 0.0

    def reset(self) -> None:
        """Return to the start."""
        self._time = 0.0

    def force(self, position: float, travel: float, duration: float, torque: float) -> float:
        """Return the force at the middle of a substep [N or N*m]."""
        velocity = travel / duration if duration else 0.0
        return self._hand.force(self._time + 0.5 * duration, position + 0.5 * travel, velocity)

    def commit(self, position: float, travel: float, duration: float, torque: float) -> None:
        """Accept the substep."""
        self._time += duration
