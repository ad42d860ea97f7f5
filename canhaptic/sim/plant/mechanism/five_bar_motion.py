"""A five-bar in motion: nonlinear, so it is stepped by a discrete gradient, which keeps every joule; kernels.

With M(q) the inertia, W = 1/M, p the momentum, H = p'W p / 2 + V(q), one substep h solves

    q+ - q = h Wm (p + p+) / 2                 Wm the mean of W at both ends
    p+ - p = h (-G + tau - B (q+ - q) / h + F)   G . (q+ - q) = [p'(W+ - W) p + p+'(W+ - W) p+] / 4 + V+ - V, exactly

(Gonzalez, "Time integration and discrete Hamiltonian systems", J. Nonlinear Science 6, 1996), so that H+ - H is
tau . dq - dq'B dq / h + F . dq to rounding: the work of each motor is torque times displacement, friction only takes,
and the hand's spring, whose force F is mapped by a Jacobian J with J dq = dx exactly, gives back what it got. Order 2.
"""

from dataclasses import dataclass
from math import inf
from typing import Final, NamedTuple

from canhaptic.kernels import Buffer, Indices, list_of_zeros, new
from canhaptic.sim.plant.mechanism.linkage import (
    Inertia,
    Linkage,
    LinkagePose,
    Pair,
    Rows,
    inertia_in,
    inertia_rate,
    pose_at,
    quadratic,
    solved,
    span_rates,
)
from canhaptic.sim.plant.mechanism.plane_force import HandForce, hand_slope, mean_pull
from canhaptic.sim.plant.propagator import TICKS

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
    """Constants of a run."""

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


class FiveBarStack(NamedTuple):
    """Pending substeps, the next one last."""

    times: Buffer  # [s]
    steps: Buffer  # [s]
    depths: Indices  # halvings


class FiveBarPlace(NamedTuple):
    """A pose with its inertia."""

    left: float
    right: float
    pose: LinkagePose
    inertia: Inertia


class Solved(NamedTuple):
    """What a solver found for a substep."""

    is_found: bool
    after: FiveBarPlace
    momentum: Pair  # [N*m*s]
    hand: Pair  # torques of the hand [N*m]


def five_bar_stack() -> FiveBarStack:
    """Buffer for the halvings."""
    room = _HALVINGS + 2
    return FiveBarStack(list_of_zeros(room), list_of_zeros(room), [0] * room)


def place_at(links: Linkage, left: float, right: float) -> FiveBarPlace:
    """Pose and inertia at two motor angles [rad]; the inertia is undefined where the pose is singular."""
    pose = pose_at(links, left, right)
    return new(FiveBarPlace, (left, right, pose, inertia_in(links, pose)))


def advance_five_bar(
    settings: FiveBarSettings, state: FiveBarState, stack: FiveBarStack, place: FiveBarPlace, begin: int, ticks: int,
    torques: Pair,
) -> FiveBarPlace:  # fmt: skip
    """Move under torques [N*m]; return the final place, or the one where it got stuck.

    Args:
        settings: Properties of links and hand.
        state: State of the motion; changed in place.
        stack: Buffer for the halvings.
        place: Place of the state.
        begin: Tick at which the motion begins.
        ticks: Length of the motion [ticks].
        torques: Torques of the left and the right motor.
    """
    count = (ticks * settings.substeps + TICKS - 1) // TICKS
    step = ticks * settings.tick_time / count
    start = begin * settings.tick_time
    for k in range(count):
        if state.stuck == 0.0:
            place = take_substep(settings, state, stack, place, start + k * step, step, torques)
    return place


def take_substep(
    settings: FiveBarSettings, state: FiveBarState, stack: FiveBarStack, place: FiveBarPlace, time: float, step: float,
    torques: Pair,
) -> FiveBarPlace:  # fmt: skip
    """Take one substep, in halves where the solver does not converge."""
    stack.times[0], stack.steps[0], stack.depths[0], top = time, step, 0, 0
    while top >= 0:
        time, step, depth = stack.times[top], stack.steps[top], stack.depths[top]
        found = solve(settings, state, place, time, step, torques)
        if found.is_found:
            book_substep(settings, state, place, found, step, torques)
            place = found.after
            top -= 1
        elif depth == _HALVINGS or (depth >= _DEEP and is_near_singular(settings, place)):
            state.stuck = step
            return place
        else:
            stack.times[top], stack.steps[top], stack.depths[top] = time + 0.5 * step, 0.5 * step, depth + 1
            top += 1
            stack.times[top], stack.steps[top], stack.depths[top] = time, 0.5 * step, depth + 1
    return place


def book_substep(
    settings: FiveBarSettings, state: FiveBarState, place: FiveBarPlace, found: Solved, step: float, torques: Pair
) -> None:
    """Record the works of a substep, and its end."""
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
    slope = residual_slope(settings, before, step)
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
        r_left = (momentum[0] - p_left) / step - balance(settings, torques[0], gradient[0], change[0], hand[0], step)
        r_right = (momentum[1] - p_right) / step - balance(settings, torques[1], gradient[1], change[1], hand[1], step)
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


def balance(
    settings: FiveBarSettings, torque: float, gradient: float, change: float, hand: float, step: float
) -> float:
    """Total torque on one coordinate [N*m]."""
    return torque - gradient - settings.damping / step * change + hand


def momentum_after(state: FiveBarState, before: FiveBarPlace, after: FiveBarPlace, change: Pair, step: float) -> Pair:
    """Return p+ of q+ - q = h Wm (p + p+) / 2."""
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
    """Return a gradient changed along the motion, so that its product with that is `value`."""
    square = change[0] * change[0] + change[1] * change[1]
    if square <= tiny:
        return left, right
    excess = (value - left * change[0] - right * change[1]) / square
    return left + excess * change[0], right + excess * change[1]


def hand_torques(
    hand: HandForce, before: LinkagePose, middle: LinkagePose, after: LinkagePose, change: Pair, time: float,
    step: float,
) -> Pair:  # fmt: skip
    """Torques of the hand at the motors over a substep [N*m]."""
    x, y = mean_pull(hand, before.handle, after.handle, time, step)
    (xl, xr), (yl, yr) = secant_jacobian(before, middle, after, change)
    return xl * x + yl * y, xr * x + yr * y


def secant_jacobian(before: LinkagePose, middle: LinkagePose, after: LinkagePose, change: Pair) -> Rows:
    """Return the Jacobian in the middle, corrected so that it maps the displacement of the motors to the handle's."""
    x, y = middle.jacobian
    return (
        corrected(x[0], x[1], change, after.handle[0] - before.handle[0], _TINY),
        corrected(y[0], y[1], change, after.handle[1] - before.handle[1], _TINY),
    )


def depth(settings: FiveBarSettings, span: float) -> float:
    """Return how far the elbows are beyond their stop, positive where too far apart [m]."""
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
