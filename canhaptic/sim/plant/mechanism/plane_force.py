"""The force of a hand in the plane, for mechanisms that are not piecewise affine; kernels."""

import math
from dataclasses import dataclass

from canhaptic.sim.plant.mechanism.linkage import Pair, Rows
from canhaptic.sim.plant.mechanism.task_hand import Ellipse, TaskHand


@dataclass(frozen=True, slots=True)
class HandForce:
    """A hand in numbers."""

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
    """Return a hand in numbers; zeros for None."""
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
    """Return the mean force on the handle over a substep [N]: second order, and conservative where its spring is.

    Args:
        hand: Hand that holds the handle.
        before: Handle at `time` [m].
        after: Handle at `time + step` [m].
        time: Since the start [s].
        step: Duration of the substep [s].
    """
    middle = (0.5 * (before[0] + after[0]), 0.5 * (before[1] + after[1]))
    speed = ((after[0] - before[0]) / step, (after[1] - before[1]) / step)
    return hand_pull(hand, time + 0.5 * step, middle, speed)


def hand_slope(hand: HandForce, step: float) -> Ellipse:
    """Return minus the derivative of `mean_pull` by `after` [N/m]."""
    return Ellipse(
        0.5 * hand.k_xx + hand.d_xx / step, 0.5 * hand.k_xy + hand.d_xy / step, 0.5 * hand.k_yy + hand.d_yy / step
    )
