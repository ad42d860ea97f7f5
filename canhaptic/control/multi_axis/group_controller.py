"""Controllers that render on several motor axes at once, with one shared account.

The torque of every motor is constant during a hold, so the energy that came in is -sum(tau_i dq_i) in MOTOR
coordinates, exactly, for every mechanism between motors and hand (eq. 2). Kinematics only shape the torques.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol

from canhaptic.control.balance import AT_REST, EnergyBalance


class GroupBalance(NamedTuple):
    """One step of a group: the torques to apply next, and the account of the hold that ended. Energies in [J].

    `account` keeps the identity of `canhaptic.control.balance` for the whole group. Its `h_i` is
    sum(interactions) + supplied - unsure; its `torque` is the Euclidean norm of `torques`, for plots only; its
    `state` is the first state of the network.
    """

    torques: tuple[float, ...]  # command for the next free hold, one per motor axis [N*m or N]
    account: EnergyBalance  # of the whole group
    interactions: tuple[float, ...]  # h_i of each motor axis
    supplied: float = 0.0  # energy that came in at ports that no motor drives, as by the mover of a moving wall
    unsure: float = 0.0  # uncertainty due to lost samples, subtracted from h_i
    limit: int = 0  # `kinematics.Limit`: reason for zero torques


def group_at_rest(axes: int) -> GroupBalance:
    """Return the balance of the first call after a reset: nothing held, nothing stored."""
    zeros = (0.0,) * axes
    return GroupBalance(zeros, AT_REST, zeros)


class GroupController(Protocol):
    """A network with its kinematics and passivity, rendered on several motor axes at once.

    Attributes:
        axes: Motor axes, in the order of every sequence below.
    """

    axes: int

    def reset(self) -> None:
        """Forget everything: zero stored energy, no torque in flight, no last positions."""

    def step(self, positions: Sequence[float], torques_applied: Sequence[float]) -> GroupBalance:
        """Book the hold that just ended and return the account with the torques for the next free hold.

        The first call after `reset` only takes the positions: its balance is all zero.

        Args:
            positions: Positions of the motor axes at this SYNC [rad or m].
            torques_applied: Torques that the drives held during the hold that ended here [N*m or N].

        Raises:
            ControlError: A position or torque is not finite, or the computed torque is not.
        """

    def hold(self) -> GroupBalance:
        """Return the balance of a SYNC at which the sample of any axis was lost: the last commands, of displays zeros.

        Nothing is booked; the next `step` books one displacement of all axes over several holds at its worst.
        """


class NetworkEnvironment(Protocol):
    """An environment as a scene names it: the parameters of a network, built for a task space of a given dimension."""

    def build(self, dimensions: int) -> Any:
        """Return the network with its geometry.

        Args:
            dimensions: Number of dimensions of task space.

        Raises:
            ParameterError: It does not fit that many dimensions, or would not be passive.
        """
