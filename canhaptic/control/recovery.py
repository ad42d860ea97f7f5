"""Recovery of surplus energy: the modulated damper of eq. 19, with its total capped for the actual delay."""

import math
from typing import Annotated, Any

from pydantic import BeforeValidator

from canhaptic.units import quantity


def _with_unit(value: Any) -> Any:
    bare = isinstance(value, (int, float)) and value != 0
    if isinstance(value, str):
        try:
            bare = float(value) != 0.0
        except ValueError:
            return value
    if bare:
        raise ValueError("damping per joule has no natural unit: write it, as in '200 s/m^2' or '5 s/rad^2'")
    return value


Alpha = Annotated[float, quantity("s/m^2", "s/rad^2", ge=0.0), BeforeValidator(_with_unit)]
"""Modulated damping per joule of surplus (eq. 19). A number other than 0 must come with its unit."""


def least_oscillating_damping(delay: int, mass: float, sample_time: float) -> float:
    """Return the damping [N*s/m or N*m*s/rad] above which a sampled damper makes a free mass ripple.

    A mass under zero-order-held damping with a velocity from the last displacement has the characteristic equation
    (z - 1) z^n + g (z + 1) = 0 with n = 1 + delay, g = d T / 2m. Its roots leave the real axis where
    g = (1 - z) z^n / (1 + z) is largest, at z = (sqrt(1 + n^2) - 1) / n: d T / m = 0.343, 0.180, 0.122
    for delay 0, 1, 2.

    Args:
        delay: Whole holds between computation and action.
        mass: Inertia rigid with the encoder [kg or kg*m^2]; an under-estimate is safe.
        sample_time: Sample time [s].
    """
    n = 1 + delay
    z = (math.sqrt(1.0 + n * n) - 1.0) / n
    return float(2.0 * mass / sample_time * (1.0 - z) * z**n / (1.0 + z))


def largest_stable_damping(delay: int, mass: float, sample_time: float) -> float:
    """Return the damping [N*s/m or N*m*s/rad] above which a sampled damper makes a free mass diverge.

    On z = exp(i theta) the equation above has (z - 1) / (z + 1) = i tan(theta / 2), so theta = pi / 2n and
    d T / m = 2 tan(pi / 4n): 2, 0.828, 0.536 for delay 0, 1, 2.
    """
    return 2.0 * mass / sample_time * math.tan(math.pi / (4.0 * (1 + delay)))


def damping_cap(delay: int, mass: float | None, sample_time: float) -> float:
    """Return the largest total damping to render [N*s/m or N*m*s/rad]; infinite when the moving mass is not known."""
    return math.inf if mass is None else least_oscillating_damping(delay, mass, sample_time)


def modulated_damping(
    alpha: float,
    surplus: float,
    model_damping: float,
    cap: float,
    displacement: float = 0.0,
    sample_time: float = 1.0,
) -> float:
    """Return d_pas of eq. 19 [N*s/m or N*m*s/rad]: in proportion to the surplus, the total not above the cap.

    Nor is it more than dissipates the surplus in one hold like the last: eq. 19 alone would take out more than there
    is where alpha is large, and set up an oscillation of its own.

    Args:
        alpha: Damping per joule of surplus [s/m^2 or s/rad^2].
        surplus: Energy still to be dissipated [J]; at or below 0 the damper is off.
        model_damping: Damping that the model itself has inside the same torque [N*s/m or N*m*s/rad].
        cap: Largest total damping [N*s/m or N*m*s/rad].
        displacement: Motion of the hold that ended [m or rad]; 0 for no limit by the surplus.
        sample_time: Sample time [s].
    """
    if surplus <= 0.0:
        return 0.0
    damping = min(alpha * surplus, cap - model_damping)
    if damping * displacement * displacement > surplus * sample_time:
        damping = surplus * sample_time / (displacement * displacement)
    return max(0.0, damping)
