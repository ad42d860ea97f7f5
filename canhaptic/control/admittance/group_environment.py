"""What several admittance displays render together: a mass that moves on all axes, or along a path."""

from itertools import pairwise
from math import inf, sqrt
from typing import Annotated, ClassVar, Literal, NamedTuple, Self

from pydantic import model_validator

from canhaptic.control.admittance.display_mass import DisplayMass
from canhaptic.errors import ParameterError
from canhaptic.units import Coordinates, Parameters, quantity

_Vector = list[float]


class GroupMass(Parameters):
    """`virtual_mass`: the same mass and damper on every axis, and a wall at each end of each axis."""

    display: ClassVar[Literal["admittance"]] = "admittance"

    mass: Annotated[float, quantity("kg", "kg*m^2", gt=0.0, le=1e6)]
    """Mass felt in every direction."""
    damping: Annotated[float, quantity("N*s/m", "N*m*s/rad", ge=0.0, le=1e6)] = 0.0
    """Damping to ground, in every direction."""
    lower: Coordinates = ()
    """Walls below, one for each axis [m or rad]; empty: none."""
    upper: Coordinates = ()
    """Walls above, one for each axis [m or rad]; empty: none."""

    @model_validator(mode="after")
    def _walls_leave_room(self) -> Self:
        if self.lower and self.upper and not all(a < b for a, b in zip(self.lower, self.upper, strict=False)):
            raise ValueError(f"got lower {self.lower} and upper {self.upper}, expected lower < upper on every axis")
        return self

    def require(self, axes: int) -> None:
        """Make sure that it fits a number of axes.

        Raises:
            ParameterError: It does not.
        """
        for name, walls in (("lower", self.lower), ("upper", self.upper)):
            if walls and len(walls) != axes:
                raise ParameterError(
                    f"{name}: got {len(walls)} walls, expected one for each of the {axes} axes, or none"
                )

    def of_axis(self, axis: int) -> DisplayMass:
        """Return what moves on one axis, with its walls."""
        return DisplayMass(
            mass=self.mass, damping=self.damping,
            **({"lower_wall": self.lower[axis]} if self.lower else {}),
            **({"upper_wall": self.upper[axis]} if self.upper else {}),
        )  # fmt: skip

    def speeds_after(self, speeds: _Vector, forces: _Vector, positions: _Vector, time: float) -> _Vector:
        """Speeds after another hold under the forces of the hand [m/s or rad/s].

        Args:
            speeds: Speeds of the last commands [m/s or rad/s].
            forces: Forces of the hand [N or N*m].
            positions: Positions at this SYNC [m or rad].
            time: T [s].
        """
        whole = self.mass + time * self.damping
        return [(self.mass * speed + time * force) / whole for speed, force in zip(speeds, forces, strict=True)]

    def stored(self, speeds: _Vector) -> float:
        """Return the energy of the mass [J]."""
        return 0.5 * self.mass * _dot(speeds, speeds)

    def lost(self, speeds: _Vector, time: float) -> float:
        """Energy that its damper dissipates in a time [J]."""
        return self.damping * _dot(speeds, speeds) * time


class PathMass(GroupMass):
    """`guided_path`: a mass that moves only along straight pieces from point to point.

    Along the path the hand feels the mass; across it the drives hold still. A handle off the path is led back.
    """

    points: tuple[Coordinates, ...]
    """Corners [m or rad], two at least, one coordinate for each axis."""
    closed: bool = False
    """Whether the last point is joined to the first."""
    return_time: Annotated[float, quantity("s", gt=0.0, le=10.0)] = 0.1
    """Time constant with which a handle off the path is led back."""

    @model_validator(mode="after")
    def _is_a_line(self) -> "PathMass":
        if len(self.points) < 2 or any(len(point) != len(self.points[0]) for point in self.points):
            raise ValueError(f"points: got {len(self.points)}, expected at least 2 with equally many coordinates")
        if any(a == b for a, b in pairwise(self._ends)):
            raise ValueError("points: got the same point twice in a row, expected pieces with a length")
        return self

    @property
    def _ends(self) -> tuple[tuple[float, ...], ...]:
        return (*self.points, self.points[0]) if self.closed else self.points

    def require(self, axes: int) -> None:
        """Make sure that it fits a number of axes; see `GroupMass`."""
        super().require(axes)
        if len(self.points[0]) != axes:
            raise ParameterError(
                f"points: got {len(self.points[0])} coordinates, expected one for each of the {axes} axes"
            )

    def speeds_after(self, speeds: _Vector, forces: _Vector, positions: _Vector, time: float) -> _Vector:
        """Return the speeds after another hold; see `GroupMass`."""
        place = nearest(self._ends, positions)
        pushed = self.mass * _dot(speeds, place.along) + time * _dot(forces, place.along)
        speed = pushed / (self.mass + time * self.damping)
        if not self.closed and ((place.is_begin and speed < 0.0) or (place.is_end and speed > 0.0)):
            speed = 0.0
        back = 1.0 / max(self.return_time, 2.0 * time)
        return [speed * along - back * away for along, away in zip(place.along, place.away, strict=True)]


class PathPlace(NamedTuple):
    """The place of a path that is nearest to a position."""

    along: _Vector  # direction of the piece, of length 1
    away: _Vector  # from there to the position [m or rad]
    is_begin: bool
    is_end: bool


def nearest(points: tuple[tuple[float, ...], ...], position: _Vector) -> PathPlace:
    """Return the place of a path through points that is nearest to a position."""
    best, least, last = PathPlace([], [], False, False), inf, len(points) - 2
    for piece, (start, end) in enumerate(pairwise(points)):
        span = [b - a for a, b in zip(start, end, strict=True)]
        square = _dot(span, span)
        share = min(1.0, max(0.0, _dot([p - a for p, a in zip(position, start, strict=True)], span) / square))
        away = [p - a - share * s for p, a, s in zip(position, start, span, strict=True)]
        distance = _dot(away, away)
        if distance < least:
            length = sqrt(square)
            least = distance
            is_begin, is_end = piece == 0 and share == 0.0, piece == last and share == 1.0
            best = PathPlace([s / length for s in span], away, is_begin, is_end)
    return best


def _dot(first: _Vector, second: _Vector) -> float:
    total = 0.0
    for a, b in zip(first, second, strict=True):
        total += a * b
    return total
