"""Interface of every mechanism: a map from the positions of its motor axes to task space, with its Jacobian.

Task forces become motor torques by the transposed Jacobian, tau = J(q)' F. The account stays in motor coordinates,
where the torque is constant during the hold; -tau . dq and -F . dp differ by at most |F| c |dq|^2 / 2, with c the
largest curvature of the map along dq, because F and J are those of the start of the hold.
"""

from collections.abc import Sequence
from enum import IntEnum
from typing import NamedTuple, Protocol

from canhaptic.kernels import Buffer, Matrix


class Limit(IntEnum):
    """Reason why a group of axes renders nothing: torque zero, the account goes on."""

    NONE = 0
    WORKSPACE = 1  # the mechanism is outside its declared workspace
    SINGULAR = 2  # the pose is closer to a singular one than declared
    UNSOLVED = 3  # the step of the network did not converge within its evaluations


class Pose(NamedTuple):
    """The mechanism at one sample; where `limit` is not NONE, position and Jacobian mean nothing."""

    position: tuple[float, ...]  # task coordinates [m or rad], length `dimensions`
    jacobian: tuple[tuple[float, ...], ...]  # d position / d motor position, rows: task, columns: motor axes
    limit: int = 0  # Limit.NONE, WORKSPACE or SINGULAR


class KinematicsKernel(Protocol):
    """Interface of a mechanism to the kernels; a NamedTuple of numbers and buffers where it can be compiled."""

    def locate(self, positions: Buffer, place: Buffer, jacobian: Matrix) -> int:
        """Write the pose of the mechanism and return its limit.

        Args:
            positions: Positions of the motor axes [rad or m], (axes,).
            place: Receives the position in task space [m or rad], (dimensions,).
            jacobian: Receives d place / d positions, (dimensions, axes); zeros at first.
        """


class Kinematics(Protocol):
    """A mechanism between motor axes and task space. Immutable."""

    @property
    def axes(self) -> int:
        """Number of motor axes."""

    @property
    def dimensions(self) -> int:
        """Number of task coordinates."""

    def pose(self, positions: Sequence[float]) -> Pose:
        """Return position, Jacobian and limit at the positions of the motor axes [rad or m]; never raises."""

    def forward(self, positions: Sequence[float]) -> tuple[float, ...]:
        """Return the position in task space [m or rad].

        Raises:
            ControlError: The pose is outside the workspace or too close to a singular one.
        """

    def jacobian(self, positions: Sequence[float]) -> tuple[tuple[float, ...], ...]:
        """Return the Jacobian, rows of task coordinates.

        Raises:
            ControlError: As `forward`.
        """
