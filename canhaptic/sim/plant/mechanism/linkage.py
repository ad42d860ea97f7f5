"""Geometry and inertia of a five-bar: two motors, two proximal links, two distal links that meet in the handle.

The base points are (-base/2, 0) and (base/2, 0); motor angles count from +x, counterclockwise. The handle is to the
left of the way from the left elbow to the right one: above, in the usual pose. Distal links are uniform rods, whose
kinetic energy follows from the velocities v, w of their ends: mass / 6 (v.v + v.w + w.w).
"""

import math
from typing import Final, NamedTuple

from canhaptic.errors import ParameterError

_CLEARANCE: Final = 1e-9  # of the distal length: nearer to a singular pose there is no direction left


class LinkagePose(NamedTuple):
    """A pose and everything of first order in it. Vectors are (x, y); `u` is d(elbow)/d(angle) of its own motor."""

    handle: tuple[float, float]  # [m]
    span: float  # from elbow to elbow [m]
    across: tuple[float, float]  # from the left elbow to the right one [m]
    u: tuple[tuple[float, float], tuple[float, float]]
    r: tuple[tuple[float, float], tuple[float, float]]  # from each elbow to the handle [m]
    jacobian: tuple[tuple[float, float], tuple[float, float]]  # d(handle)/d(angles), rows x and y [m/rad]


class Inertia(NamedTuple):
    """A symmetric 2 x 2 matrix in motor coordinates [kg*m^2], or its derivative by one angle."""

    a: float
    b: float  # off the diagonal
    c: float

    def product(self, left: float, right: float) -> float:
        """Returns the quadratic form of a vector."""
        return self.a * left * left + 2.0 * self.b * left * right + self.c * right * right

    def solve(self, left: float, right: float) -> tuple[float, float]:
        """Returns the inverse times a vector."""
        determinant = self.a * self.c - self.b * self.b
        return (self.c * left - self.b * right) / determinant, (self.a * right - self.b * left) / determinant


class Linkage:
    """The links.

    Args:
        base: Distance of the motors [m].
        proximal: Length of the links on the motors [m].
        distal: Length of the links that carry the handle [m].
        motor_inertia: Rotor and proximal link about each motor [kg*m^2].
        distal_mass: Of each distal link [kg].
        handle_mass: [kg]
    """

    def __init__(
        self, base: float, proximal: float, distal: float, motor_inertia: float, distal_mass: float, handle_mass: float
    ) -> None:
        self._half_base, self._proximal, self._distal = 0.5 * base, proximal, distal
        self._motor_inertia = motor_inertia + distal_mass * proximal * proximal / 3.0
        self._half_rod = distal_mass / 6.0
        self._handle = handle_mass + 2.0 * distal_mass / 3.0

    def pose(self, left: float, right: float) -> LinkagePose:
        """Returns the pose at two motor angles [rad].

        Raises:
            ParameterError: The distal links are stretched or folded there, so that the handle has no one place.
        """
        length, half = self._proximal, self._half_base
        u = (
            (-length * math.sin(left), length * math.cos(left)),
            (-length * math.sin(right), length * math.cos(right)),
        )
        dx, dy = 2.0 * half + u[1][1] - u[0][1], u[0][0] - u[1][0]
        span = math.hypot(dx, dy)
        height_squared = self._distal * self._distal - 0.25 * span * span
        least = _CLEARANCE * self._distal
        if not (span > least and height_squared > least * least):  # NaN as well
            raise self.singular(left, right, span)
        rise = math.sqrt(height_squared) / span
        r_left = (0.5 * dx - rise * dy, 0.5 * dy + rise * dx)
        r_right = (r_left[0] - dx, r_left[1] - dy)
        handle = (u[0][1] - half + r_left[0], r_left[1] - u[0][0])
        r = (r_left, r_right)
        pulls = (_dot(r_left, u[0]), 0.0), (0.0, _dot(r_right, u[1]))
        return LinkagePose(handle, span, (dx, dy), u, r, _solved(r, pulls))

    @property
    def distal(self) -> float:
        """Length of the links that carry the handle [m]."""
        return self._distal

    def singular(self, left: float, right: float, span: float) -> ParameterError:
        """Returns the error for elbows that meet, or are as far apart as the distal links reach."""
        return ParameterError(
            f"five_bar: at {left:.6g} and {right:.6g} rad the elbows are {span:.6g} m apart, which is a singular "
            f"pose (expected between 0, where they meet, and {2.0 * self._distal:g} m, the distal links stretched); "
            "give the mechanism an elbow_stop short of it, or less force"
        )

    def inertia(self, pose: LinkagePose) -> Inertia:
        """Returns the inertia that the motors feel, T = 1/2 v' M v."""
        (x_left, x_right), (y_left, y_right) = pose.jacobian
        (u_left, u_right), rod, handle = pose.u, self._half_rod, self._handle
        left, right = (x_left, y_left), (x_right, y_right)
        return Inertia(
            self._motor_inertia + 2.0 * rod * _dot(u_left, left) + handle * _dot(left, left),
            rod * (_dot(u_left, right) + _dot(u_right, left)) + handle * _dot(left, right),
            self._motor_inertia + 2.0 * rod * _dot(u_right, right) + handle * _dot(right, right),
        )

    def inertia_rates(self, pose: LinkagePose) -> tuple[Inertia, Inertia]:
        """Returns the derivatives of the inertia by the left and by the right angle."""
        return self._rate(pose, 0), self._rate(pose, 1)

    def span_rates(self, pose: LinkagePose) -> tuple[float, float]:
        """Returns the derivatives of the elbows' distance by both angles [m/rad]."""
        return -_dot(pose.across, pose.u[0]) / pose.span, _dot(pose.across, pose.u[1]) / pose.span

    def _rate(self, pose: LinkagePose, by: int) -> Inertia:
        """Returns dM/dq of one angle; the Jacobian's derivative comes from that of (r . J) = (r . u)."""
        (x, y), u, r = pose.jacobian, pose.u, pose.r
        moves = (x[by], y[by])
        turn = (-u[by][1], u[by][0])  # d u / d angle of the motor that turns
        sides = []
        for elbow in (0, 1):
            own = elbow == by
            dr = (moves[0] - u[elbow][0], moves[1] - u[elbow][1]) if own else moves
            pull = _dot(dr, u[elbow]) + (_dot(r[elbow], turn) if own else 0.0)
            row = [-(dr[0] * x[k] + dr[1] * y[k]) for k in (0, 1)]
            row[elbow] += pull
            sides.append((row[0], row[1]))
        (dx_left, dx_right), (dy_left, dy_right) = _solved(r, (sides[0], sides[1]))
        left, right = (x[0], y[0]), (x[1], y[1])
        d_left, d_right = (dx_left, dy_left), (dx_right, dy_right)
        du_left, du_right = (turn, (0.0, 0.0)) if by == 0 else ((0.0, 0.0), turn)
        rod, handle = self._half_rod, self._handle
        return Inertia(
            2.0 * rod * (_dot(du_left, left) + _dot(u[0], d_left)) + 2.0 * handle * _dot(left, d_left),
            rod * (_dot(du_left, right) + _dot(u[0], d_right) + _dot(du_right, left) + _dot(u[1], d_left))
            + handle * (_dot(d_left, right) + _dot(left, d_right)),
            2.0 * rod * (_dot(du_right, right) + _dot(u[1], d_right)) + 2.0 * handle * _dot(right, d_right),
        )


_Rows = tuple[tuple[float, float], tuple[float, float]]


def _dot(left: tuple[float, float], right: tuple[float, float]) -> float:
    return left[0] * right[0] + left[1] * right[1]


def _solved(r: _Rows, sides: _Rows) -> _Rows:
    """Returns X of [r_left; r_right] X = sides."""
    (a, b), (c, d) = r
    determinant = a * d - b * c
    (p, q), (s, t) = sides
    return (
        ((d * p - b * s) / determinant, (d * q - b * t) / determinant),
        ((a * s - c * p) / determinant, (a * t - c * q) / determinant),
    )
