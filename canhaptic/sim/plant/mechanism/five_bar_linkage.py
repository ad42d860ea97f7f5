"""A planar five-bar linkage that two motors move together: its geometry, its inertia, the force of a hand, its motion.

Two motors carry the proximal links; two distal links join their ends, the elbows, to the handle. The base points are
(-base/2, 0) and (base/2, 0); motor angles count from +x, counterclockwise. Seen from the left elbow towards the right
one, the handle is on the left: above them, in the usual pose. Distal links are uniform rods, whose kinetic energy
follows from the velocities v, w of their ends: mass / 6 (v.v + v.w + w.w). The functions are kernels.

The motion is nonlinear; it is stepped by a discrete gradient, which conserves energy exactly. With M(q) the inertia,
W = 1/M, p the momentum, H = p'W p / 2 + V(q), one substep h solves

    q+ - q = h Wm (p + p+) / 2                 Wm the mean of W at both ends
    p+ - p = h (-G + tau - B (q+ - q) / h + F)   G . (q+ - q) = [p'(W+ - W) p + p+'(W+ - W) p+] / 4 + V+ - V, exactly

(Gonzalez, "Time integration and discrete Hamiltonian systems", J. Nonlinear Science 6, 1996), so that H+ - H is
tau . dq - dq'B dq / h + F . dq to rounding: the work of each motor is torque times displacement, friction only takes,
and the hand's spring, whose force F is mapped by a Jacobian J with J dq = dx exactly, returns its energy. Order 2.
"""

import math
from dataclasses import dataclass, replace
from math import inf
from typing import Annotated, ClassVar, Final, NamedTuple

from pydantic import model_validator

from canhaptic.axis_units import Motion
from canhaptic.errors import ParameterError
from canhaptic.kernels import new
from canhaptic.signals import PlantEnergy
from canhaptic.sim.plant.mechanism.task_hand import Ellipse, TaskHand
from canhaptic.sim.plant.propagator import TICKS, SampleClock
from canhaptic.units import Parameters, quantity

_CLEARANCE: Final = 1e-9  # of the distal length: nearer to a singular pose there is no direction left
Pair = tuple[float, float]
Rows = tuple[Pair, Pair]


@dataclass(frozen=True, slots=True)
class Linkage:
    """Lengths and inertias of the links as numbers; left and right are identical."""

    half_base: float  # half the distance of the motors [m]
    proximal: float  # length of the links on the motors [m]
    distal: float  # length of the links that carry the handle [m]
    motor_inertia: float  # of rotor, proximal link and a third of the distal one, about each motor [kg*m^2]
    half_rod: float  # a sixth of the mass of a distal link [kg]
    handle: float  # what of the masses is at the handle [kg]


class LinkagePose(NamedTuple):
    """A pose and all its first-order quantities. Vectors are (x, y); `u` is d(elbow)/d(angle) of its own motor."""

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
    """Return the quadratic form v'Mv of a vector."""
    return matrix.a * left * left + 2.0 * matrix.b * left * right + matrix.c * right * right


def solved(matrix: Inertia, left: float, right: float) -> Pair:
    """Return the inverse of a matrix times a vector."""
    determinant = matrix.a * matrix.c - matrix.b * matrix.b
    return (matrix.c * left - matrix.b * right) / determinant, (matrix.a * right - matrix.b * left) / determinant


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
    """Error for elbows that coincide, or are farther apart than the distal links reach."""
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
    """Return dM/dq by one angle; the derivative of the Jacobian follows from that of (r . J) = (r . u)."""
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


@dataclass(frozen=True, slots=True)
class HandForce:
    """Parameters of a hand as numbers."""

    k_xx: float = 0.0  # stiffness [N/m]
    k_xy: float = 0.0
    k_yy: float = 0.0
    d_xx: float = 0.0  # damping [N*s/m]
    d_xy: float = 0.0
    d_yy: float = 0.0
    push_x: float = 0.0  # [N]
    push_y: float = 0.0
    rest_x: float = 0.0  # of the spring, with the offset of the motion [m]
    rest_y: float = 0.0
    amplitude_x: float = 0.0  # of the voluntary motion; 0: none [m]
    amplitude_y: float = 0.0
    omega_x: float = 0.0  # [rad/s]
    omega_y: float = 0.0
    phase_x: float = 0.0  # [rad]
    phase_y: float = 0.0


def force_of_hand(hand: TaskHand | None) -> HandForce:
    """Return the parameters of a hand's force law as numbers; zeros without a hand."""
    if hand is None:
        return HandForce()
    swings = [(m.offset, m.amplitude, 2.0 * math.pi * m.frequency, m.phase) if m else (0.0,) * 4 for m in hand.motions]
    offsets, *moving = zip(*swings, strict=True)
    rest = [at + offset for at, offset in zip(hand.rest, offsets, strict=True)]
    flat = [value for pair in moving for value in pair]
    return HandForce(*hand.stiffness_matrix, *hand.damping_matrix, *hand.push, *rest, *flat)


def hand_target(hand: HandForce, time: float) -> Rows:
    """Target position of the hand [m], and its velocity [m/s]."""
    x, y, vx, vy = hand.rest_x, hand.rest_y, 0.0, 0.0
    if hand.amplitude_x != 0.0:
        x += hand.amplitude_x * math.sin(hand.omega_x * time + hand.phase_x)
        vx = hand.amplitude_x * hand.omega_x * math.cos(hand.omega_x * time + hand.phase_x)
    if hand.amplitude_y != 0.0:
        y += hand.amplitude_y * math.sin(hand.omega_y * time + hand.phase_y)
        vy = hand.amplitude_y * hand.omega_y * math.cos(hand.omega_y * time + hand.phase_y)
    return (x, y), (vx, vy)


def hand_pull(hand: HandForce, time: float, place: Pair, speed: Pair) -> Pair:
    """Return the force on a handle [N].

    Args:
        hand: Hand that holds the handle.
        time: Time since the start [s].
        place: Position of the handle [m].
        speed: Velocity of the handle [m/s].
    """
    (x, y), (vx, vy) = hand_target(hand, time)
    x, y, vx, vy = x - place[0], y - place[1], vx - speed[0], vy - speed[1]
    return (
        hand.k_xx * x + hand.k_xy * y + hand.d_xx * vx + hand.d_xy * vy + hand.push_x,
        hand.k_xy * x + hand.k_yy * y + hand.d_xy * vx + hand.d_yy * vy + hand.push_y,
    )


def mean_pull(hand: HandForce, before: Pair, after: Pair, time: float, step: float) -> Pair:
    """Return the mean force on the handle over a substep [N], of second order; the force of its spring is conservative.

    Args:
        hand: Hand that holds the handle.
        before: Position of the handle at `time` [m].
        after: Position of the handle at `time + step` [m].
        time: Time since the start [s].
        step: Duration of the substep [s].
    """
    middle = (0.5 * (before[0] + after[0]), 0.5 * (before[1] + after[1]))
    speed = ((after[0] - before[0]) / step, (after[1] - before[1]) / step)
    return hand_pull(hand, time + 0.5 * step, middle, speed)


def hand_slope(hand: HandForce, step: float) -> Ellipse:
    """Return minus the derivative of `mean_pull` with respect to `after` [N/m]."""
    return Ellipse(
        0.5 * hand.k_xx + hand.d_xx / step, 0.5 * hand.k_xy + hand.d_xy / step, 0.5 * hand.k_yy + hand.d_yy / step
    )


_ITERATIONS: Final = 60
_CONVERGED: Final = 1e-15  # [rad] of a correction, in addition to the rounding of the step
_ACCEPTED: Final = 1e-12  # [rad] where rounding lets it stagnate; or
_ENERGY_OPEN: Final = 1e-15  # of the energy at hand, which is all that it then leaves open
_FURTHEST: Final = 1.0  # [rad] in one substep; further away a solver has lost its way
_TINY: Final = 1e-11  # [rad^2] below which the secant correction of the handle's place is below its rounding
_TINIEST: Final = 1e-16  # [rad^2] below which that of the kinetic energy is, which gets small with the motion
_HALVINGS: Final = 18
_DEEP: Final = 10  # halvings, after which a singular pose close by is why
_DIVERGING: Final = 4.0  # times the last correction
_NEAR: Final = 1e-3  # of the distal length, of the handle from the line of the elbows or of these from each other


@dataclass(frozen=True, slots=True)
class FiveBarSettings:
    """Constants of a five-bar in a run."""

    links: Linkage
    hand: HandForce
    damping: float  # of the bearings of each motor [N*m*s/rad]
    stop: float  # stiffness of the elbow stop; 0: none [N/m]
    least: float  # distance of the elbows below which it pushes them apart [m]
    most: float  # beyond which it draws them together [m]
    substeps: int  # in one sample time
    tick_time: float  # [s]


@dataclass(slots=True)
class FiveBarState:
    """Momenta, works since the start, and solver results."""

    left: float = 0.0  # angles [rad]
    right: float = 0.0
    left_momentum: float = 0.0  # [N*m*s]
    right_momentum: float = 0.0
    left_motor: float = 0.0  # works [J]
    right_motor: float = 0.0
    left_user: float = 0.0
    right_user: float = 0.0
    left_lost: float = 0.0
    right_lost: float = 0.0
    iterations: int = 0  # of the solver
    stuck: float = 0.0  # substep for which no motion was found; 0: none [s]


class FiveBarPlace(NamedTuple):
    """A pose with its inertia."""

    left: float
    right: float
    pose: LinkagePose
    inertia: Inertia


class Solved(NamedTuple):
    """Result of a solver for a substep."""

    is_found: bool
    after: FiveBarPlace
    momentum: Pair  # [N*m*s]
    hand: Pair  # torques of the hand [N*m]


def place_at(links: Linkage, left: float, right: float) -> FiveBarPlace:
    """Pose and inertia at two motor angles [rad]; the inertia is undefined where the pose is singular."""
    pose = pose_at(links, left, right)
    return new(FiveBarPlace, (left, right, pose, inertia_in(links, pose)))


def advance_five_bar(
    settings: FiveBarSettings, state: FiveBarState, place: FiveBarPlace, begin: int, ticks: int, torques: Pair
) -> FiveBarPlace:
    """Move under torques [N*m]; return the final pose, or the one where the solver failed.

    Args:
        settings: Properties of links and hand.
        state: State of the motion; changed in place.
        place: Pose of the state.
        begin: Tick at which the motion begins.
        ticks: Length of the motion [ticks].
        torques: Torques of the left and the right motor.
    """
    count = (ticks * settings.substeps + TICKS - 1) // TICKS
    step = ticks * settings.tick_time / count
    start = begin * settings.tick_time
    for k in range(count):
        if state.stuck == 0.0:
            place = take_substep(settings, state, place, start + k * step, step, torques)
    return place


def take_substep(
    settings: FiveBarSettings, state: FiveBarState, place: FiveBarPlace, time: float, step: float, torques: Pair
) -> FiveBarPlace:
    """Take one substep; where the solver does not converge, in parts: it is halved, part `k` of 2^`depth` parts."""
    k, depth = 0, 0
    while k < 1 << depth:
        begin, part = time, step
        for bit in range(depth - 1, -1, -1):
            part *= 0.5
            if k >> bit & 1:
                begin += part
        found = solve(settings, state, place, begin, part, torques)
        if found.is_found:
            book_substep(settings, state, place, found, part, torques)
            place, k = found.after, k + 1
            while depth and not k & 1:
                k, depth = k >> 1, depth - 1
        elif depth == _HALVINGS or (depth >= _DEEP and is_near_singular(settings, place)):
            state.stuck = part
            return place
        else:
            k, depth = 2 * k, depth + 1
    return place


def book_substep(
    settings: FiveBarSettings, state: FiveBarState, place: FiveBarPlace, found: Solved, step: float, torques: Pair
) -> None:
    """Record the works of a substep and the state at its end."""
    left, right = found.after.left - place.left, found.after.right - place.right
    state.left_motor += torques[0] * left
    state.right_motor += torques[1] * right
    state.left_user += found.hand[0] * left
    state.right_user += found.hand[1] * right
    state.left_lost += settings.damping * left * left / step
    state.right_lost += settings.damping * right * right / step
    state.left, state.right = found.after.left, found.after.right
    state.left_momentum, state.right_momentum = found.momentum


def is_near_singular(settings: FiveBarSettings, place: FiveBarPlace) -> bool:
    """Return whether a singular pose is close."""
    distal = settings.links.distal
    return not _NEAR * distal < place.pose.span < (2.0 - _NEAR * _NEAR) * distal


def stored(settings: FiveBarSettings, state: FiveBarState, place: FiveBarPlace) -> float:
    """Return the kinetic energy, and that in the elbow stop, from the state [J]."""
    v_left, v_right = solved(place.inertia, state.left_momentum, state.right_momentum)
    kinetic = 0.5 * (state.left_momentum * v_left + state.right_momentum * v_right)
    return kinetic + potential(settings, place.pose)


def solve(
    settings: FiveBarSettings, state: FiveBarState, before: FiveBarPlace, time: float, step: float, torques: Pair
) -> Solved:
    """Solution of a substep, by a simplified Newton iteration on the displacement."""
    p_left, p_right = state.left_momentum, state.right_momentum
    v_left, v_right = solved(before.inertia, p_left, p_right)
    d_left, d_right = step * v_left, step * v_right
    slope, drag = residual_slope(settings, before, step), settings.damping / step
    last, enough = inf, _ENERGY_OPEN * stored(settings, state, before)
    nothing = new(Solved, (False, before, (0.0, 0.0), (0.0, 0.0)))
    for _ in range(_ITERATIONS):
        if not abs(d_left) + abs(d_right) < _FURTHEST:  # NaN as well
            return nothing
        state.iterations += 1
        after = place_at(settings.links, before.left + d_left, before.right + d_right)
        change = (after.left - before.left, after.right - before.right)
        middle = place_at(settings.links, before.left + 0.5 * change[0], before.right + 0.5 * change[1])
        if not (after.pose.is_regular and middle.pose.is_regular):
            return nothing
        momentum = momentum_after(state, before, after, change, step)
        gradient = discrete_gradient(settings, state, before, middle, after, momentum, change)
        hand = hand_torques(settings.hand, before.pose, middle.pose, after.pose, change, time, step)
        r_left = (momentum[0] - p_left) / step - (torques[0] - gradient[0] - drag * change[0] + hand[0])
        r_right = (momentum[1] - p_right) / step - (torques[1] - gradient[1] - drag * change[1] + hand[1])
        c_left, c_right = solved(slope, r_left, r_right)
        size = abs(c_left) + abs(c_right)
        if size <= _CONVERGED or (
            size >= 0.5 * last and (size <= _ACCEPTED or abs(r_left * d_left) + abs(r_right * d_right) <= enough)
        ):
            return new(Solved, (True, after, momentum, hand))
        if not size < _DIVERGING * last:
            return nothing
        last = size
        d_left, d_right = d_left - c_left, d_right - c_right
    return nothing


def momentum_after(state: FiveBarState, before: FiveBarPlace, after: FiveBarPlace, change: Pair, step: float) -> Pair:
    """Return the momentum p+ after a substep, from q+ - q = h Wm (p + p+) / 2."""
    w0, w1 = before.inertia, after.inertia
    det0, det1 = w0.a * w0.c - w0.b * w0.b, w1.a * w1.c - w1.b * w1.b
    mean = new(Inertia, (
        0.5 * (w0.c / det0 + w1.c / det1), -0.5 * (w0.b / det0 + w1.b / det1), 0.5 * (w0.a / det0 + w1.a / det1)
    ))  # fmt: skip
    p_left, p_right = solved(mean, change[0] / step, change[1] / step)
    return 2.0 * p_left - state.left_momentum, 2.0 * p_right - state.right_momentum


def discrete_gradient(
    settings: FiveBarSettings, state: FiveBarState, before: FiveBarPlace, middle: FiveBarPlace, after: FiveBarPlace,
    momentum: Pair, change: Pair,
) -> Pair:  # fmt: skip
    """Return G: the discrete gradient of the kinetic energy at given momenta, and of the stop's potential."""
    by_left, by_right = (inertia_rate(settings.links, middle.pose, 0), inertia_rate(settings.links, middle.pose, 1))
    left = right = value = 0.0
    for p in ((state.left_momentum, state.right_momentum), momentum):
        v_left, v_right = solved(middle.inertia, p[0], p[1])
        left -= 0.25 * quadratic(by_left, v_left, v_right)
        right -= 0.25 * quadratic(by_right, v_left, v_right)
        v0, v1 = solved(before.inertia, p[0], p[1]), solved(after.inertia, p[0], p[1])
        value += 0.25 * (p[0] * (v1[0] - v0[0]) + p[1] * (v1[1] - v0[1]))
    left, right = corrected(left, right, change, value, _TINIEST)
    if settings.stop == 0.0:
        return left, right
    pull, rates = settings.stop * depth(settings, middle.pose.span), span_rates(middle.pose)
    value = potential(settings, after.pose) - potential(settings, before.pose)
    push = corrected(pull * rates[0], pull * rates[1], change, value, 0.0)  # always, for its slope has a kink
    return left + push[0], right + push[1]


def corrected(left: float, right: float, change: Pair, value: float, tiny: float) -> Pair:
    """Return a gradient, corrected along the motion so that their product is `value`."""
    square = change[0] * change[0] + change[1] * change[1]
    if square <= tiny:
        return left, right
    excess = (value - left * change[0] - right * change[1]) / square
    return left + excess * change[0], right + excess * change[1]


def hand_torques(
    hand: HandForce, before: LinkagePose, middle: LinkagePose, after: LinkagePose, change: Pair, time: float,
    step: float,
) -> Pair:  # fmt: skip
    """Torques of the hand at the motors over a substep [N*m].

    The Jacobian in the middle is corrected so that it maps the displacement of the motors to the handle's.
    """
    x, y = mean_pull(hand, before.handle, after.handle, time, step)
    (xl, xr), (yl, yr) = middle.jacobian
    xl, xr = corrected(xl, xr, change, after.handle[0] - before.handle[0], _TINY)
    yl, yr = corrected(yl, yr, change, after.handle[1] - before.handle[1], _TINY)
    return xl * x + yl * y, xr * x + yr * y


def depth(settings: FiveBarSettings, span: float) -> float:
    """Return how far the elbows are beyond their stop [m]; positive if too far apart, negative if too close."""
    return max(0.0, span - settings.most) - max(0.0, settings.least - span)


def potential(settings: FiveBarSettings, pose: LinkagePose) -> float:
    """Return the energy in the elbow stop [J]."""
    if settings.stop == 0.0:
        return 0.0
    beyond = depth(settings, pose.span)
    return 0.5 * settings.stop * (beyond * beyond)


def residual_slope(settings: FiveBarSettings, place: FiveBarPlace, step: float) -> Inertia:
    """Return an estimate of d(residual)/d(displacement): inertia, damping, hand and stop."""
    inertia, damping, k = place.inertia, settings.damping / step, hand_slope(settings.hand, step)
    scale = 2.0 / (step * step)
    a, b, c = scale * inertia.a + damping, scale * inertia.b, scale * inertia.c + damping
    (xl, xr), (yl, yr) = place.pose.jacobian
    a += xl * (k.xx * xl + k.xy * yl) + yl * (k.xy * xl + k.yy * yl)
    b += xl * (k.xx * xr + k.xy * yr) + yl * (k.xy * xr + k.yy * yr)
    c += xr * (k.xx * xr + k.xy * yr) + yr * (k.xy * xr + k.yy * yr)
    if settings.stop != 0.0 and depth(settings, place.pose.span) != 0.0:
        left, right = span_rates(place.pose)
        half = 0.5 * settings.stop
        a, b, c = a + half * left * left, b + half * left * right, c + half * right * right
    return new(Inertia, (a, b, c))


_Angle = Annotated[float, quantity("rad", ge=-100.0, le=100.0)]


class ElbowStop(Parameters):
    """Springs that keep the distance of the elbows within bounds, away from singular poses."""

    least: Annotated[float, quantity("m", ge=0.0, le=1e3)] = 0.0
    """Distance of the elbows below which the spring pushes them apart."""
    most: Annotated[float, quantity("m", gt=0.0, le=1e3)]
    """Distance of the elbows above which the spring pulls them together."""
    stiffness: Annotated[float, quantity("N/m", gt=0.0, le=1e8)]
    """Stiffness of the springs."""


class FiveBarLinkage(Parameters):
    """Lengths and masses of a five-bar; identical left and right."""

    motion: ClassVar[Motion] = "rad"
    axes: ClassVar[int] = 2
    order: ClassVar[int | None] = 2

    base: Annotated[float, quantity("m", ge=0.0, le=100.0)]
    """Distance of the two motors."""
    proximal: Annotated[float, quantity("m", gt=0.0, le=100.0)]
    """Length of the links on the motors."""
    distal: Annotated[float, quantity("m", gt=0.0, le=100.0)]
    """Length of the links that carry the handle."""
    motor_inertia: Annotated[float, quantity("kg*m^2", gt=0.0, le=1e4)]
    """Inertia of rotor and proximal link about each motor."""
    distal_mass: Annotated[float, quantity("kg", ge=0.0, le=1e4)] = 0.0
    """Mass of each distal link, a uniform rod."""
    handle_mass: Annotated[float, quantity("kg", ge=0.0, le=1e4)] = 0.0
    """Mass at the joint of the distal links."""
    damping: Annotated[float, quantity("N*m*s/rad", ge=0.0, le=1e4)] = 0.0
    """Viscous friction of the bearings of each motor."""
    elbow_stop: ElbowStop | None = None
    """Springs between the elbows; None: none."""
    initial_angles: tuple[_Angle, _Angle]
    """Angles of the left and the right motor, from +x, counterclockwise."""

    @model_validator(mode="after")
    def _stop_is_short_of_singular(self) -> "FiveBarLinkage":
        stop = self.elbow_stop
        if stop is not None and not stop.least < stop.most < 2.0 * self.distal:
            raise ValueError(
                f"elbow_stop from {stop.least:g} to {stop.most:g} m, expected least < most < {2.0 * self.distal:g} m "
                "(twice the distal length)"
            )
        return self

    def linkage(self) -> Linkage:
        """Return geometry and inertia of the links as numbers."""
        inertia = self.motor_inertia + self.distal_mass * self.proximal * self.proximal / 3.0
        handle = self.handle_mass + 2.0 * self.distal_mass / 3.0
        return Linkage(0.5 * self.base, self.proximal, self.distal, inertia, self.distal_mass / 6.0, handle)

    def build(self, hand: TaskHand | None, sample_time_ns: int, substeps: int) -> "FiveBarMotion":
        """Return the five-bar at rest at its initial angles.

        Raises:
            ParameterError: The initial angles are a singular pose.
        """
        return FiveBarMotion(self, hand, sample_time_ns, substeps)


class FiveBarMotion(SampleClock):
    """A five-bar in motion.

    Args:
        links: Lengths and masses of the links.
        hand: Hand at the handle; None without a hand.
        sample_time_ns: T [ns].
        substeps: Number of substeps in one sample time.

    Attributes:
        settings: Constants of the run.
        state: State of the motion.

    Raises:
        ParameterError: The initial angles are a singular pose.
    """

    def __init__(self, links: FiveBarLinkage, hand: TaskHand | None, sample_time_ns: int, substeps: int) -> None:
        super().__init__(sample_time_ns)
        linkage, stop = links.linkage(), links.elbow_stop
        stiffness, least, most = (stop.stiffness, stop.least, stop.most) if stop is not None else (0.0, 0.0, 0.0)
        self.settings = FiveBarSettings(
            linkage, force_of_hand(hand), links.damping, stiffness, least, most, substeps, self.tick_time
        )
        self._place = place_at(linkage, *links.initial_angles)
        self.state = FiveBarState(*links.initial_angles)
        if not self._place.pose.is_regular:
            raise singular(linkage, *links.initial_angles, self._place.pose.span)

    @property
    def positions(self) -> tuple[float, ...]:
        """True angles of the motors [rad]."""
        return self.state.left, self.state.right

    @property
    def velocities(self) -> tuple[float, ...]:
        """True velocities of the motors [rad/s]."""
        return solved(self._place.inertia, self.state.left_momentum, self.state.right_momentum)

    @property
    def handle(self) -> tuple[float, float]:
        """Position of the handle [m]."""
        return self._place.pose.handle

    def move_hand(self, x: float, y: float) -> None:
        """Move the rest of a hand without motion to a position [m] for the following holds; only between two holds.

        Raises:
            ParameterError: The position is not finite.
        """
        self.require_finite("hand position", (x, y))
        self.settings = replace(self.settings, hand=replace(self.settings.hand, rest_x=x, rest_y=y))

    def force_of(self, torques: tuple[float, ...]) -> Pair:
        """Return the force at the handle that does the work of the motors' torques [N]."""
        (a, b), (c, d) = self._place.pose.jacobian
        left, right = torques
        return (d * left - c * right) / (a * d - b * c), (a * right - b * left) / (a * d - b * c)

    @property
    def iterations(self) -> int:
        """Number of solver iterations since the start, a machine-independent cost."""
        return self.state.iterations

    @property
    def stored(self) -> float:
        """Kinetic energy, and that in the elbow stop, from the state [J]."""
        return stored(self.settings, self.state, self._place)

    def advance_to(self, now: int, torques: tuple[float, ...]) -> None:
        """Move to `now` [ns] under torques [N*m] that were constant since the last call.

        Raises:
            ParameterError: `now` lies before the last call, a torque is not finite, or the links are pushed through a
                singular pose.
        """
        self.require_finite("torque", torques)
        begin = self.tick
        ticks = self.pass_until(now)
        if ticks:
            left, right = torques
            self._place = advance_five_bar(self.settings, self.state, self._place, begin, ticks, (left, right))
            if self.state.stuck:
                raise self._stuck(self.state.stuck)

    def energy(self, axis: int) -> PlantEnergy:
        """Return the true works done through one motor coordinate since the start [J].

        The kinetic energy of coupled links belongs to no motor alone: `stored` is the balance of the works done through
        this coordinate. Its sum over both motors is the energy stored in the linkage, but for the integrator's error.
        """
        now = self.state
        works = (now.left_motor, now.left_user, now.left_lost), (now.right_motor, now.right_user, now.right_lost)
        motor, user, lost = works[axis]
        return PlantEnergy(motor, user, lost, motor + user - lost)

    def _stuck(self, step: float) -> ParameterError:
        """Return the error for a failed solver: a singular pose, or forces too large for any substep."""
        left, right = self.positions
        if is_near_singular(self.settings, self._place):
            return singular(self.settings.links, left, right, self._place.pose.span)
        return ParameterError(
            f"five_bar: the solver found no motion at {left:.6g} and {right:.6g} rad in a substep of {step:.3g} s; "
            "raise accuracy.substeps, or lower the stiffness of elbow_stop or hand"
        )
