"""Geometry and inertia of a five-bar: two motors, two proximal links, two distal links that meet in the handle.

The functions are kernels. The base points are (-base/2, 0) and (base/2, 0); motor angles count from +x,
counterclockwise. The handle is to the left of the way from the left elbow to the right one: above, in the usual pose.
Distal links are uniform rods, whose kinetic energy follows from the velocities v, w of their ends:
mass / 6 (v.v + v.w + w.w).
"""

import math
from dataclasses import dataclass
from typing import Final, NamedTuple

from canhaptic.errors import ParameterError
from canhaptic.kernels import new

_CLEARANCE: Final = 1e-9  # of the distal length: nearer to a singular pose there is no direction left
Pair = tuple[float, float]
Rows = tuple[Pair, Pair]


@dataclass(frozen=True, slots=True)
class Linkage:
    """The links, left and right alike."""

    half_base: float  # half the distance of the motors [m]
    proximal: float  # length of the links on the motors [m]
    distal: float  # length of the links that carry the handle [m]
    motor_inertia: float  # of rotor, proximal link and a third of the distal one, about each motor [kg*m^2]
    half_rod: float  # a sixth of the mass of a distal link [kg]
    handle: float  # what of the masses is at the handle [kg]


class LinkagePose(NamedTuple):
    """A pose and everything of first order in it. Vectors are (x, y); `u` is d(elbow)/d(angle) of its own motor."""

    is_regular: bool  # False: the distal links are stretched or folded, so that the handle has no one place
    handle: Pair  # [m]
    span: float  # from elbow to elbow [m]
    across: Pair  # from the left elbow to the right one [m]
    u: Rows
    r: Rows  # from each elbow to the handle [m]
    jacobian: Rows  # d(handle)/d(angles), rows x and y [m/rad]


class Inertia(NamedTuple):
    """A symmetric 2 x 2 matrix in motor coordinates [kg*m^2], or its derivative by one angle."""

    a: float
    b: float  # off the diagonal
    c: float


def quadratic(matrix: Inertia, left: float, right: float) -> float:
    """Return the quadratic form of a vector."""
    return matrix.a * left * left + 2.0 * matrix.b * left * right + matrix.c * right * right


def solved(matrix: Inertia, left: float, right: float) -> Pair:
    """Return the inverse times a vector."""
    determinant = matrix.a * matrix.c - matrix.b * matrix.b
    return (matrix.c * left - matrix.b * right) / determinant, (matrix.a * right - matrix.b * left) / determinant


def linkage_of(
    base: float, proximal: float, distal: float, motor_inertia: float, distal_mass: float, handle_mass: float
) -> Linkage:
    """Return links of given lengths and masses.

    Args:
        base: Distance of the motors [m].
        proximal: Length of the links on the motors [m].
        distal: Length of the links that carry the handle [m].
        motor_inertia: Rotor and proximal link about each motor [kg*m^2].
        distal_mass: Mass of each distal link [kg].
        handle_mass: Mass of the handle [kg].
    """
    return Linkage(
        0.5 * base, proximal, distal, motor_inertia + distal_mass * proximal * proximal / 3.0, distal_mass / 6.0,
        handle_mass + 2.0 * distal_mass / 3.0,
    )  # fmt: skip


def pose_at(links: Linkage, left: float, right: float) -> LinkagePose:
    """Return the pose at two motor angles [rad], which must be finite."""
    length, half = links.proximal, links.half_base
    u = (
        (-length * math.sin(left), length * math.cos(left)),
        (-length * math.sin(right), length * math.cos(right)),
    )
    dx, dy = 2.0 * half + u[1][1] - u[0][1], u[0][0] - u[1][0]
    span = math.sqrt(dx * dx + dy * dy)
    height_squared = links.distal * links.distal - 0.25 * span * span
    least = _CLEARANCE * links.distal
    if not (span > least and height_squared > least * least):
        none = (0.0, 0.0)
        return new(LinkagePose, (False, none, span, (dx, dy), u, (none, none), (none, none)))
    rise = math.sqrt(height_squared) / span
    r_left = (0.5 * dx - rise * dy, 0.5 * dy + rise * dx)
    r_right = (r_left[0] - dx, r_left[1] - dy)
    handle = (u[0][1] - half + r_left[0], r_left[1] - u[0][0])
    r = (r_left, r_right)
    jacobian = _over(r, ((dot(r_left, u[0]), 0.0), (0.0, dot(r_right, u[1]))))
    return new(LinkagePose, (True, handle, span, (dx, dy), u, r, jacobian))


def singular(links: Linkage, left: float, right: float, span: float) -> ParameterError:
    """Error for elbows that meet, or are as far apart as the distal links reach."""
    return ParameterError(
        f"five_bar: at {left:.6g} and {right:.6g} rad the elbows are {span:.6g} m apart, which is a singular "
        f"pose (expected between 0, where they meet, and {2.0 * links.distal:g} m, the distal links stretched); "
        "give the mechanism an elbow_stop short of it, or less force"
    )


def inertia_in(links: Linkage, pose: LinkagePose) -> Inertia:
    """Return the inertia that the motors feel, T = 1/2 v' M v."""
    (x_left, x_right), (y_left, y_right) = pose.jacobian
    (u_left, u_right), rod, handle = pose.u, links.half_rod, links.handle
    left, right = (x_left, y_left), (x_right, y_right)
    return new(Inertia, (
        links.motor_inertia + 2.0 * rod * dot(u_left, left) + handle * dot(left, left),
        rod * (dot(u_left, right) + dot(u_right, left)) + handle * dot(left, right),
        links.motor_inertia + 2.0 * rod * dot(u_right, right) + handle * dot(right, right),
    ))  # fmt: skip


def span_rates(pose: LinkagePose) -> Pair:
    """Return the derivatives of the elbows' distance by both angles [m/rad]."""
    return -dot(pose.across, pose.u[0]) / pose.span, dot(pose.across, pose.u[1]) / pose.span


def inertia_rate(links: Linkage, pose: LinkagePose, by: int) -> Inertia:
    """Return dM/dq of one angle; the Jacobian's derivative comes from that of (r . J) = (r . u)."""
    (x, y), u, none = pose.jacobian, pose.u, (0.0, 0.0)
    turn = (-u[by][1], u[by][0])  # d u / d angle of the motor that turns
    du_left, du_right = (turn, none) if by == 0 else (none, turn)
    sides = _side(pose, 0, by, du_left), _side(pose, 1, by, du_right)
    (dx_left, dx_right), (dy_left, dy_right) = _over(pose.r, sides)
    left, right = (x[0], y[0]), (x[1], y[1])
    d_left, d_right = (dx_left, dy_left), (dx_right, dy_right)
    rod, handle = links.half_rod, links.handle
    return new(Inertia, (
        2.0 * rod * (dot(du_left, left) + dot(u[0], d_left)) + 2.0 * handle * dot(left, d_left),
        rod * (dot(du_left, right) + dot(u[0], d_right) + dot(du_right, left) + dot(u[1], d_left))
        + handle * (dot(d_left, right) + dot(left, d_right)),
        2.0 * rod * (dot(du_right, right) + dot(u[1], d_right)) + 2.0 * handle * dot(right, d_right),
    ))  # fmt: skip


def _side(pose: LinkagePose, elbow: int, by: int, turn: Pair) -> Pair:
    """Return the row of an elbow in (r . dJ) = d(r . u) - (dr . J) by one angle."""
    (x, y), u = pose.jacobian, pose.u[elbow]
    dr = (x[by] - u[0], y[by] - u[1]) if elbow == by else (x[by], y[by])
    pull = dot(dr, u) + dot(pose.r[elbow], turn)
    left, right = -(dr[0] * x[0] + dr[1] * y[0]), -(dr[0] * x[1] + dr[1] * y[1])
    return (left + pull, right) if elbow == 0 else (left, right + pull)


def dot(left: Pair, right: Pair) -> float:
    """Return the scalar product."""
    return left[0] * right[0] + left[1] * right[1]


def _over(r: Rows, sides: Rows) -> Rows:
    """Return X of [r_left; r_right] X = sides."""
    (a, b), (c, d) = r
    determinant = a * d - b * c
    (p, q), (s, t) = sides
    return (
        ((d * p - b * s) / determinant, (d * q - b * t) / determinant),
        ((a * s - c * p) / determinant, (a * t - c * q) / determinant),
    )
