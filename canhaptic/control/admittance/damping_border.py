"""Least damping with which a light virtual mass is stable against a spring to ground, without any guard.

A drive M v' = c (r - v) + F, the command r of m r' = F - b r after a lag tau, and F = -K q. At the border the loop
swings at w, and the real and imaginary parts of its equation vanish:

    w^2 (m + M b / c) = K (cos w tau + b / c)
    b = K sin(w tau) / w + m (M w^2 - K) / c

For w tau small, b = K (tau + (M - m) / c). The sampled loop with the mean force of a hold has tau = (delay + 1/2) T.
"""

from math import cos, sin, sqrt
from typing import Final

_ROUNDS: Final = 60


def damping_border(moved: float, gain: float, mass: float, stiffness: float, lag: float) -> float:
    """Return the virtual damping at the border; 0 where none is needed [N*s/m or N*m*s/rad].

    Args:
        moved: M, that the drive moves [kg or kg*m^2].
        gain: c of its velocity loop [N*s/m or N*m*s/rad].
        mass: m, virtual [kg or kg*m^2].
        stiffness: K of the spring to ground [N/m or N*m/rad], > 0.
        lag: tau from the force to the command that answers it [s].
    """
    square = stiffness / mass
    damping = 0.0
    for _ in range(_ROUNDS):
        rate = sqrt(square)
        damping = stiffness * sin(rate * lag) / rate + mass * (moved * square - stiffness) / gain
        found = stiffness * (cos(rate * lag) + damping / gain) / (mass + moved * damping / gain)
        square = 0.5 * (square + max(found, 0.01 * square))
    return max(0.0, damping)
