"""The force of a hand in the plane over one substep, for mechanisms that are not piecewise affine."""

import math

from canhaptic.sim.plant.mechanism.task_hand import Ellipse, TaskHand


class HandForce:
    """Mean force of the hand over a substep, second order, and conservative where its spring is.

    Args:
        hand: Its parameters.
    """

    def __init__(self, hand: TaskHand) -> None:
        self._stiffness, self._damping = hand.stiffness_matrix, hand.damping_matrix
        self._hand = hand
        self._rest = tuple(r + (m.offset if m else 0.0) for r, m in zip(hand.rest, hand.motions, strict=True))
        self._swings = [
            (m.amplitude, 2.0 * math.pi * m.frequency, m.phase) if m is not None else None for m in hand.motions
        ]

    def target(self, time: float) -> tuple[tuple[float, float], tuple[float, float]]:
        """Returns where the hand wants the handle to be [m], and how fast it moves there [m/s]."""
        x, y, vx, vy = *self._rest, 0.0, 0.0
        if self._swings[0] is not None:
            amplitude, omega, phase = self._swings[0]
            x += amplitude * math.sin(omega * time + phase)
            vx = amplitude * omega * math.cos(omega * time + phase)
        if self._swings[1] is not None:
            amplitude, omega, phase = self._swings[1]
            y += amplitude * math.sin(omega * time + phase)
            vy = amplitude * omega * math.cos(omega * time + phase)
        return (x, y), (vx, vy)

    def force(
        self, before: tuple[float, float], after: tuple[float, float], time: float, step: float
    ) -> tuple[float, float]:
        """Returns the force on the handle [N] while it moves from `before` to `after`.

        Args:
            before: Handle at `time` [m].
            after: Handle at `time + step` [m].
            time: Since the start [s].
            step: [s]
        """
        (x, y), (vx, vy) = self.target(time + 0.5 * step)
        x, y = x - 0.5 * (before[0] + after[0]), y - 0.5 * (before[1] + after[1])
        vx, vy = vx - (after[0] - before[0]) / step, vy - (after[1] - before[1]) / step
        k, d, push = self._stiffness, self._damping, self._hand.push
        return (
            k.xx * x + k.xy * y + d.xx * vx + d.xy * vy + push[0],
            k.xy * x + k.yy * y + d.xy * vx + d.yy * vy + push[1],
        )

    def slope(self, step: float) -> Ellipse:
        """Returns minus the derivative of the force by `after` [N/m]."""
        k, d = self._stiffness, self._damping
        return Ellipse(*(0.5 * stiff + damp / step for stiff, damp in zip(k, d, strict=True)))
