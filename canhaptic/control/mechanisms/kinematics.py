"""Interface of every mechanism, a map from motor positions to task space with its Jacobian, and their common parts.

Task forces become motor torques by the transposed Jacobian, tau = J(q)' F. The account stays in motor coordinates,
where the torque is constant during the hold; -tau . dq and -F . dp differ by at most |F| c |dq|^2 / 2, with c the
largest curvature of the map along dq, because F and J are evaluated at the start of the hold.

`Identity` is the mechanism of an X-Y stage: every motor axis is a coordinate of task space.
"""

from collections.abc import Callable, Sequence
from enum import IntEnum
from typing import Annotated, NamedTuple, Protocol, cast

import numpy as np

from canhaptic.errors import ParameterError
from canhaptic.kernels import Buffer, Matrix, list_of_zeros, zeros
from canhaptic.units import Parameters, quantity


class Limit(IntEnum):
    """Reason why a group of axes renders nothing: the torque is zero, and the account continues."""

    NONE = 0
    WORKSPACE = 1  # the mechanism is outside its declared workspace
    SINGULAR = 2  # the pose is closer to a singular one than declared
    UNSOLVED = 3  # the step of the network did not converge within its evaluations


class Pose(NamedTuple):
    """Pose of the mechanism at one sample; where `limit` is not NONE, position and Jacobian are undefined."""

    position: tuple[float, ...]  # task coordinates [m or rad], length `dimensions`
    jacobian: tuple[tuple[float, ...], ...]  # d position / d motor position, rows: task, columns: motor axes
    limit: int = 0  # Limit.NONE, WORKSPACE or SINGULAR


class KinematicsKernel(Protocol):
    """Mechanism as the functions of the cycle call it; a NamedTuple of numbers and buffers if it can be compiled."""

    def locate(self, positions: Buffer, place: Buffer, jacobian: Matrix) -> int:
        """Compute the pose of the mechanism into `place` and `jacobian`; return whether a limit is reached (`Limit`).

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


class FromMechanism:
    """Base of a mechanism whose pose the kernels compute; it also has `axes` and `dimensions`, see `Kinematics`."""

    def mechanism(self) -> KinematicsKernel:
        """Return the kinematic map that the kernels call."""
        raise NotImplementedError

    def pose(self, positions: Sequence[float]) -> Pose:
        """Return position, Jacobian and limit; see `Kinematics`."""
        kinematics = cast(Kinematics, self)
        place, jacobian = list_of_zeros(kinematics.dimensions), zeros(kinematics.dimensions, kinematics.axes)
        limit = self.mechanism().locate(list(positions), place, jacobian)
        return Pose(tuple(place), tuple(tuple(row) for row in jacobian), limit)


class PoseAsked(NamedTuple):
    """Adapter through which the kernels call a mechanism that has only a Python `pose`; see `KinematicsKernel`."""

    kinematics: Kinematics

    def locate(self, positions: Buffer, place: Buffer, jacobian: Matrix) -> int:
        """Copy the pose that the mechanism computes into the buffers; return the limit reached (`Limit`)."""
        pose = self.kinematics.pose(positions)
        if not pose.limit:
            place[:] = pose.position
            for into, row in zip(jacobian, pose.jacobian, strict=True):
                into[:] = row
        return pose.limit


def mechanism_of(kinematics: Kinematics) -> KinematicsKernel:
    """Return the object through which the kernels call a mechanism."""
    return kinematics.mechanism() if isinstance(kinematics, FromMechanism) else PoseAsked(kinematics)


class WorkspaceBox(NamedTuple):
    """Lower and upper limits of the task coordinates [m or rad]; an empty buffer: no limit."""

    lower: Buffer
    upper: Buffer


def workspace_box(lower: Sequence[float] | None, upper: Sequence[float] | None, dimensions: int) -> WorkspaceBox:
    """Return the limits of a workspace as buffers.

    Raises:
        ValueError: The number of entries differs from `dimensions`, or a lower edge is not below the upper one.
    """
    for name, edge in (("workspace_lower", lower), ("workspace_upper", upper)):
        if edge is not None and len(edge) != dimensions:
            raise ValueError(f"{name}: got {len(edge)} entries, expected {dimensions}")
    if lower is not None and upper is not None and any(low >= high for low, high in zip(lower, upper, strict=True)):
        raise ValueError(
            f"got workspace_lower {lower} not below workspace_upper {upper} everywhere, expected lower < upper"
        )
    return WorkspaceBox(list(lower or ()), list(upper or ()))


def is_outside(box: WorkspaceBox, place: Buffer) -> bool:
    """Return whether a position in task space is outside the workspace."""
    for i in range(len(box.lower)):
        if place[i] < box.lower[i]:
            return True
    for i in range(len(box.upper)):
        if place[i] > box.upper[i]:
            return True
    return False


def check_jacobian(
    forward: Callable[[Sequence[float]], Sequence[float]],
    jacobian: Callable[[Sequence[float]], Sequence[Sequence[float]]],
    positions: Sequence[float],
    dimensions: int,
) -> None:
    """Compare a Jacobian with differences of its map at given positions.

    Raises:
        ParameterError: Shapes do not fit, values are not finite, or the two differ.
    """
    base = np.array(positions, dtype=float)
    found = np.array(jacobian(base.tolist()), dtype=float)
    at = np.array(forward(base.tolist()), dtype=float)
    if at.shape != (dimensions,) or found.shape != (dimensions, base.size):
        raise ParameterError(
            f"user kinematics: forward has shape {at.shape} and jacobian {found.shape}, expected ({dimensions},) and "
            f"({dimensions}, {base.size})"
        )
    step = 1e-6
    columns = [
        (np.array(forward((base + step * e).tolist())) - np.array(forward((base - step * e).tolist()))) / (2.0 * step)
        for e in np.eye(base.size)
    ]
    expected = np.array(columns).T
    error = float(np.abs(found - expected).max())
    if not error <= 1e-5 * max(1.0, float(np.abs(expected).max())):
        raise ParameterError(
            f"user kinematics: jacobian at {base.tolist()} is off by {error:g} from differences of forward, expected "
            "<= 1e-5; forces would act in another direction than the motion they are booked with"
        )


class IdentityMap(NamedTuple):
    """The map x = q; see `KinematicsKernel`."""

    axes: int

    def locate(self, positions: Buffer, place: Buffer, jacobian: Matrix) -> int:
        """Copy the positions into the buffer, with a unit Jacobian; return that no limit is reached."""
        for i in range(self.axes):
            place[i] = positions[i]
            jacobian[i][i] = 1.0
        return 0


class Identity(FromMechanism, Parameters):
    """No mechanism: x = q, for any number of axes, all in the same unit."""

    axes: Annotated[int, quantity("count", ge=1, le=16)]
    """Number of motor axes; in a scene it follows from the `axes` of the group."""

    @property
    def dimensions(self) -> int:
        """Number of task coordinates."""
        return self.axes

    def mechanism(self) -> IdentityMap:
        """Return the kinematic map that the kernels call."""
        return IdentityMap(self.axes)


class UserFunction:
    """A mechanism x = forward(q); the constructor compares the Jacobian with finite differences of the map.

    Attributes:
        axes: Number of motor axes.
        dimensions: Number of dimensions of task space.
    """

    def __init__(
        self,
        forward: Callable[[Sequence[float]], Sequence[float]],
        jacobian: Callable[[Sequence[float]], Sequence[Sequence[float]]],
        at: Sequence[float],
        limit: Callable[[Sequence[float]], int] | None = None,
    ) -> None:
        """Make and check the mechanism.

        Args:
            forward: Motor positions -> task coordinates.
            jacobian: Motor positions -> rows of task coordinates.
            at: Motor positions inside the workspace at which Jacobian and map are compared.
            limit: Motor positions -> `Limit.NONE`, WORKSPACE or SINGULAR; called before the map. None: no limit.

        Raises:
            ParameterError: The Jacobian does not match finite differences of the map.
        """
        self.axes, self.dimensions = len(at), len(forward(list(at)))
        check_jacobian(forward, jacobian, at, self.dimensions)
        self._forward, self._jacobian, self._limit = forward, jacobian, limit

    def pose(self, positions: Sequence[float]) -> Pose:
        """Return the pose that the user's functions give; a value that is not finite counts as a singular pose."""
        limit = 0 if self._limit is None else int(self._limit(positions))
        if limit:
            return Pose((), (), limit)
        place = tuple([float(v) for v in self._forward(positions)])
        rows = tuple([tuple([float(v) for v in row]) for row in self._jacobian(positions)])
        total = 0.0
        for row in (place, *rows):
            for value in row:
                total += value - value
        if total != 0.0:
            return Pose((), (), Limit.SINGULAR.value)
        return Pose(place, rows)
