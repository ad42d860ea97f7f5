"""A user-defined mechanism: a function and its Jacobian, in Python."""

from collections.abc import Callable, Sequence

from canhaptic.control.mechanisms.kinematics import FromPose, Limit, Pose, check_jacobian

_Map = Callable[[Sequence[float]], Sequence[float]]
_Derivative = Callable[[Sequence[float]], Sequence[Sequence[float]]]


class UserFunction(FromPose):
    """x = forward(q); the constructor compares the Jacobian with finite differences of it.

    Attributes:
        axes: Number of motor axes.
        dimensions: Number of dimensions of task space.
    """

    def __init__(
        self,
        forward: _Map,
        jacobian: _Derivative,
        at: Sequence[float],
        limit: Callable[[Sequence[float]], int] | None = None,
    ) -> None:
        """Make and check the mechanism.

        Args:
            forward: Motor positions -> task coordinates.
            jacobian: Motor positions -> rows of task coordinates.
            at: Motor positions inside the workspace at which Jacobian and map are compared.
            limit: Motor positions -> `Limit.NONE`, WORKSPACE or SINGULAR; asked first. None: no limit is known.

        Raises:
            ParameterError: The Jacobian is not that of the map.
        """
        self.axes, self.dimensions = len(at), len(forward(list(at)))
        check_jacobian(forward, jacobian, at, self.dimensions)
        self._forward, self._jacobian, self._limit = forward, jacobian, limit

    def pose(self, positions: Sequence[float]) -> Pose:
        """Pose by the user's functions; a value that is not finite is a singular pose."""
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
