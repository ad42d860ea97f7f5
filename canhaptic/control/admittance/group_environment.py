"""Environments that several admittance displays render together: a mass on all axes or along a path, a cup with balls.

`TaskEnvironment` renders them in the task space of a mechanism. With u the speeds of the motors, F the forces of the
sensors on the motor axes, p' the velocity and f the force of the hand in task space:

    p' = J u,   J' f = F

Energy and certificate belong to the motor axes: F u = f p'. In a pose that is singular or outside the workspace the
commanded velocities are zero. Walls are limits in task space; the command leaves enough distance for the motion that
queued commands and drives still cause, at the speed of the last command.
"""

from collections.abc import Sequence
from functools import cached_property
from itertools import pairwise
from math import inf, sqrt
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal, NamedTuple, Self

from pydantic import model_validator

from canhaptic.control.admittance.admittance_environment import AdmittanceEnvironment, AdmittanceMass
from canhaptic.control.environments import plain
from canhaptic.control.port_hamiltonian.network import dot, solve_linear
from canhaptic.errors import ParameterError
from canhaptic.kernels import Buffer
from canhaptic.units import Coordinates, Parameters, quantity

if TYPE_CHECKING:
    from canhaptic.control.admittance.cup_and_ball import CupAndBall
    from canhaptic.control.mechanisms.kinematics import Kinematics


_Vector = list[float]
_Inner = list[Buffer]


class GroupEnvironment(Parameters):
    """Parameters and methods of an environment on several axes, with a damper and walls on each of them."""

    display: ClassVar[Literal["admittance"]] = "admittance"
    states: ClassVar[int] = 0
    """Number of internal states per axis, kept from SYNC to SYNC: in the methods a row of `inner`, initially zeros."""
    per_axis: ClassVar[tuple[str, ...]] = ("lower", "upper")
    """Parameters with one value for each axis."""

    damping: Annotated[float, quantity("N*s/m", "N*m*s/rad", ge=0.0, le=1e6)] = 0.0
    """Damping to ground, in every direction."""
    lower: Coordinates = ()
    """Position of the lower wall of each axis [m or rad]; empty: no walls."""
    upper: Coordinates = ()
    """Position of the upper wall of each axis [m or rad]; empty: no walls."""

    @model_validator(mode="after")
    def _walls_leave_room(self) -> Self:
        if self.lower and self.upper and not all(a < b for a, b in zip(self.lower, self.upper, strict=False)):
            raise ValueError(f"got lower {self.lower} and upper {self.upper}, expected lower < upper on every axis")
        return self

    def require(self, axes: int) -> None:
        """Check that the walls and the other parameters in `per_axis` have one value for each axis, or none.

        Raises:
            ParameterError: The numbers of values and axes differ.
        """
        for name in self.per_axis:
            if (given := len(getattr(self, name))) not in (0, axes):
                raise ParameterError(f"{name}: got {given} values, expected one for each of the {axes} axes, or none")

    def walls_of(self, axis: int) -> dict[str, float]:
        """Return the wall positions of one axis, keyed by the parameter names of `AdmittanceEnvironment`."""
        walls = {"lower_wall": self.lower, "upper_wall": self.upper}
        return {name: at[axis] for name, at in walls.items() if at}

    def of_axis(self, axis: int) -> AdmittanceEnvironment:
        """Return an environment of one axis with the damper and the walls of that axis."""
        return AdmittanceEnvironment(damping=self.damping, **self.walls_of(axis))

    def speeds_after(self, inner: _Inner, speeds: _Vector, forces: _Vector, positions: _Vector, time: float) -> _Vector:
        """Return the speeds after another hold under the forces of the hand [m/s or rad/s].

        Args:
            inner: States of the environment, a row for each axis.
            speeds: Speeds of the last commands [m/s or rad/s].
            forces: Forces of the hand [N or N*m].
            positions: Positions at this SYNC [m or rad].
            time: T [s].
        """
        raise NotImplementedError

    def go_along(self, inner: _Inner, before: _Vector, speeds: _Vector, time: float) -> None:
        """Advance the internal states by a hold at given speeds; `before` are the previous speeds [m/s or rad/s]."""

    def stored(self, inner: _Inner, speeds: _Vector, positions: _Vector) -> float:
        """Return the stored energy [J]."""
        raise NotImplementedError

    def lost(self, speeds: _Vector, time: float) -> float:
        """Return the energy that the damper dissipates in a time [J]."""
        return self.damping * dot(speeds, speeds) * time

    def stretch(self, positions: _Vector) -> float:
        """Return 0: a log has the displacement of a spring on one axis only [m or rad]."""
        return 0.0


class GroupMass(GroupEnvironment):
    """`virtual_mass`: the same mass, damper and spring on every axis, and a wall at each end of each axis."""

    per_axis: ClassVar[tuple[str, ...]] = ("lower", "upper", "rest")

    mass: Annotated[float, quantity("kg", "kg*m^2", gt=0.0, le=1e6)]
    """Mass felt in every direction."""
    stiffness: Annotated[float, quantity("N/m", "N*m/rad", ge=0.0, le=1e8)] = 0.0
    """Stiffness of a spring to ground, in every direction."""
    rest: Coordinates = ()
    """Position at which the spring exerts no force, one coordinate for each axis [m or rad]; empty: zeros."""

    def of_axis(self, axis: int) -> AdmittanceMass:
        """Return an environment of one axis with the mass, its spring and the walls of that axis."""
        rest = self.rest[axis] if self.rest else 0.0
        spring = {"stiffness": self.stiffness, "rest": rest}
        return AdmittanceMass(mass=self.mass, damping=self.damping, **spring, **self.walls_of(axis))

    def speeds_after(self, inner: _Inner, speeds: _Vector, forces: _Vector, positions: _Vector, time: float) -> _Vector:
        """Return the speeds after another hold; see `GroupEnvironment`."""
        whole, pushes = self.mass + time * self.damping, self.pushes(forces, positions)
        return [(self.mass * speed + time * push) / whole for speed, push in zip(speeds, pushes, strict=True)]

    def pushes(self, forces: _Vector, positions: _Vector) -> _Vector:
        """Return the sum of hand force and spring force on the mass, axis by axis [N or N*m]."""
        if not self.stiffness:
            return forces
        return [force - self.stiffness * d for force, d in zip(forces, self._stretches(positions), strict=True)]

    def stored(self, inner: _Inner, speeds: _Vector, positions: _Vector) -> float:
        """Return the energy of mass and spring [J]."""
        moving = 0.5 * self.mass * dot(speeds, speeds)
        if not self.stiffness:
            return moving
        stretches = self._stretches(positions)
        return moving + 0.5 * self.stiffness * dot(stretches, stretches)

    def _stretches(self, positions: _Vector) -> _Vector:
        rest = self.rest or (0.0,) * len(positions)
        return [position - at for position, at in zip(positions, rest, strict=True)]


class GroupCupAndBall(GroupEnvironment):
    """`cup_and_ball`: one cup that moves along all axes, with a separate ball that swings along each of them."""

    states: ClassVar[int] = 3  # the same states as `CupAndBall`

    cup: Annotated[float, quantity("kg", gt=0.0, le=1e3)] = 2.4
    """Mass of the cup."""
    ball: Annotated[float, quantity("kg", gt=0.0, le=1e3)] = 0.6
    """Mass of each ball."""
    length: Annotated[float, quantity("m", gt=0.0, le=100.0)] = 0.45
    """Length of each pendulum: the radius of the cup."""

    @cached_property
    def _alone(self) -> "CupAndBall":
        from canhaptic.control.admittance.cup_and_ball import CupAndBall

        return plain(CupAndBall(cup=self.cup, ball=self.ball, length=self.length, damping=self.damping))

    def speeds_after(self, inner: _Inner, speeds: _Vector, forces: _Vector, positions: _Vector, time: float) -> _Vector:
        """Return the speeds of the cup after another hold [m/s]; see `GroupEnvironment`."""
        each = zip(inner, speeds, forces, positions, strict=True)
        return [self._alone.speed_after(*of, time) for of in each]

    def go_along(self, inner: _Inner, before: _Vector, speeds: _Vector, time: float) -> None:
        """Apply the change of the cup's speed to each ball, and let it swing for a hold."""
        for of in zip(inner, before, speeds, strict=True):
            self._alone.go_along(*of, time)

    def stored(self, inner: _Inner, speeds: _Vector, positions: _Vector) -> float:
        """Return the energy of cup and balls [J]."""
        return sum(self._alone.stored(*of) for of in zip(inner, speeds, positions, strict=True))


class PathMass(GroupMass):
    """`guided_path`: a mass that moves only along straight segments from point to point.

    Along the path the hand feels the mass; across the path the drives do not yield. A handle off the path is led back.
    """

    points: tuple[Coordinates, ...]
    """Corner points of the path, at least two, with one coordinate for each axis [m or rad]."""
    closed: bool = False
    """Whether a segment connects the last point to the first."""
    return_time: Annotated[float, quantity("s", gt=0.0, le=10.0)] = 0.1
    """Time constant with which a handle is led back to the path."""

    @model_validator(mode="after")
    def _is_a_line(self) -> "PathMass":
        if len(self.points) < 2 or any(len(point) != len(self.points[0]) for point in self.points):
            raise ValueError(f"points: got {len(self.points)}, expected at least 2 with equally many coordinates")
        if any(a == b for a, b in pairwise(self._ends)):
            raise ValueError("points: got the same point twice in a row, expected neighbouring points that differ")
        return self

    @property
    def _ends(self) -> tuple[tuple[float, ...], ...]:
        return (*self.points, self.points[0]) if self.closed else self.points

    def require(self, axes: int) -> None:
        """Check that every point has one coordinate for each axis; see `GroupEnvironment`."""
        super().require(axes)
        if len(self.points[0]) != axes:
            raise ParameterError(
                f"points: got {len(self.points[0])} coordinates, expected one for each of the {axes} axes"
            )

    def speeds_after(self, inner: _Inner, speeds: _Vector, forces: _Vector, positions: _Vector, time: float) -> _Vector:
        """Return the speeds after another hold; see `GroupEnvironment`."""
        place = nearest(self._ends, positions)
        pushed = self.mass * dot(speeds, place.along) + time * dot(self.pushes(forces, positions), place.along)
        speed = pushed / (self.mass + time * self.damping)
        if not self.closed and ((place.is_begin and speed < 0.0) or (place.is_end and speed > 0.0)):
            speed = 0.0
        back = 1.0 / max(self.return_time, 2.0 * time)
        return [speed * along - back * away for along, away in zip(place.along, place.away, strict=True)]


class PathPlace(NamedTuple):
    """The point of a path nearest to a position."""

    along: _Vector  # direction of the piece, of length 1
    away: _Vector  # from there to the position [m or rad]
    is_begin: bool
    is_end: bool


def nearest(points: tuple[tuple[float, ...], ...], position: _Vector) -> PathPlace:
    """Return the point of a path nearest to a position."""
    best, least, last = PathPlace([], [], False, False), inf, len(points) - 2
    for piece, (start, end) in enumerate(pairwise(points)):
        span = [b - a for a, b in zip(start, end, strict=True)]
        square = dot(span, span)
        share = min(1.0, max(0.0, dot([p - a for p, a in zip(position, start, strict=True)], span) / square))
        away = [p - a - share * s for p, a, s in zip(position, start, span, strict=True)]
        distance = dot(away, away)
        if distance < least:
            length = sqrt(square)
            least = distance
            is_begin, is_end = piece == 0 and share == 0.0, piece == last and share == 1.0
            best = PathPlace([s / length for s in span], away, is_begin, is_end)
    return best


_Rows = Sequence[Sequence[float]]


class TaskEnvironment:
    """An environment in task space, with the interface of `GroupEnvironment` for the motor axes.

    Args:
        environment: Environment in task space.
        kinematics: Map between motor axes and equally many task coordinates.
        time_ahead: Longest time for which the last command continues to act [s].

    Raises:
        ParameterError: The mechanism has more or fewer task coordinates than axes.
    """

    def __init__(self, environment: GroupEnvironment, kinematics: "Kinematics", time_ahead: float) -> None:
        if kinematics.axes != kinematics.dimensions:
            raise ParameterError(
                f"kinematics: got {kinematics.axes} motor axes and {kinematics.dimensions} task coordinates, expected "
                "equal numbers: otherwise the motors cannot follow every velocity in task space"
            )
        self._environment, self._kinematics, self._ahead = environment, kinematics, time_ahead
        self._jacobian: _Rows = ()
        self._place: _Vector = []
        self.damping, self.states = environment.damping, environment.states

    def require(self, axes: int) -> None:
        """Check kinematics and walls against the number of motor axes.

        Raises:
            ParameterError: Their number of axes differs.
        """
        if axes != self._kinematics.axes:
            raise ParameterError(f"kinematics: has {self._kinematics.axes} motor axes, expected {axes} as in the group")
        self._environment.require(self._kinematics.dimensions)

    def of_axis(self, _axis: int) -> AdmittanceEnvironment:
        """Return the damper on one motor axis, without walls: they are in task space."""
        return AdmittanceEnvironment(damping=self.damping)

    def speeds_after(self, inner: _Inner, speeds: _Vector, forces: _Vector, positions: _Vector, time: float) -> _Vector:
        """Return the speeds of the motors after another hold [m/s or rad/s]; see `GroupEnvironment`."""
        pose = self._kinematics.pose(positions)
        if pose.limit:
            self._jacobian = ()
            return [0.0] * len(speeds)
        self._jacobian, self._place = jacobian, place = pose.jacobian, list(pose.position)
        transposed = [list(column) for column in zip(*jacobian, strict=True)]
        pushed = list(forces)
        before = _times(jacobian, speeds)
        if not solve_linear(transposed, pushed):
            return [0.0] * len(speeds)
        request = self._environment.speeds_after(inner, before, pushed, place, time)
        request = self._within_walls(request, before, place, time)
        return request if solve_linear([list(row) for row in jacobian], request) else [0.0] * len(speeds)

    def _within_walls(self, request: _Vector, before: _Vector, place: Sequence[float], time: float) -> _Vector:
        walls, found = self._environment, []
        for k, speed in enumerate(request):
            ahead = place[k] + self._ahead * before[k]
            high = max((walls.upper[k] - ahead) / (time + self._ahead), 0.0) if walls.upper else inf
            low = min((walls.lower[k] - ahead) / (time + self._ahead), 0.0) if walls.lower else -inf
            found.append(max(min(speed, high), low))
        return found

    def go_along(self, inner: _Inner, before: _Vector, speeds: _Vector, time: float) -> None:
        """Advance the states by a hold at given motor speeds; no change in a pose where nothing is rendered."""
        if self.states and self._jacobian:
            self._environment.go_along(inner, _times(self._jacobian, before), _times(self._jacobian, speeds), time)

    def stored(self, inner: _Inner, speeds: _Vector, positions: _Vector) -> float:
        """Return the energy stored at given motor speeds [J]; 0 in a pose where nothing is rendered."""
        if not self._jacobian:
            return 0.0
        return self._environment.stored(inner, _times(self._jacobian, speeds), self._place)

    def lost(self, speeds: _Vector, time: float) -> float:
        """Return the energy that the damper dissipates in a time [J]."""
        return self._environment.lost(_times(self._jacobian, speeds), time)

    def stretch(self, positions: _Vector) -> float:
        """Return 0, as `GroupEnvironment` does [m or rad]."""
        return 0.0


def _times(rows: _Rows, vector: _Vector) -> _Vector:
    return [sum(a * b for a, b in zip(row, vector, strict=True)) for row in rows]
