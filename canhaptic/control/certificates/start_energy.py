"""Energy that a wall needs before a contact, so that the hand-force certificate holds it from the first hold on.

At rest at a force F every hold may give out F D_i, the hand pulling with F_h, while the spring of stiffness k has taken
in F^2 / 2k. What is lacking is largest at some force on the way in,

    E = max over F of (sum of F D_i)(F) - F^2 / 2k,

with D_i of the holds under way and the next one (`scalar_bounds`). Undamped the sum is h F (F + F_h), h = T^2 / m at
delay 0 and 3 T^2 / m at delay 1, so that E = (h F_h)^2 / 4 a with a = 1 / 2k - h. A faster contact needs less: its own
inward motion brings energy in. A drag f earns f times the way, in
motion above the speed of `start_speed`: slower, the hand may turn within the holds under way and pull the drag along.

For every hand of any force, what the device dissipates permits a torque: with b and f_c certain a torque F at
rest needs (1 + delay) (F - f_c)^2 T / 4b to be there (`sum_of_certificates`), of which the wall has F^2 / 2k and the
friction on the way in f_c F / k. The rest is to be there before (`energy_for_any_hand`); friction earns it over
rest / f_c of any motion, without a drag.
"""

import math
from typing import Final

from canhaptic.control.certificates.scalar_bounds import DisplacementResponse, next_displacement, tail_reach

_FIRST: Final = 1e-3  # [N or N*m]


def start_energy(response: DisplacementResponse, delay: int, stiffness: float) -> float:
    """Return the energy [J] with which a contact of any speed is held; infinite where the stiffness is too large.

    Args:
        response: Displacement response of the axis, with the force of the hand.
        delay: Delay in whole holds.
        stiffness: Stiffness of the wall [N/m or N*m/rad].
    """
    if response.hand == 0.0:
        return 0.0
    # the sum is a quadratic polynomial in F without a constant: two values give it
    one, two = _given_out(response, delay, _FIRST), _given_out(response, delay, 2.0 * _FIRST)
    square = (two - 2.0 * one) / (2.0 * _FIRST * _FIRST)
    linear = one / _FIRST - square * _FIRST
    left = 0.5 / stiffness - square
    return linear * linear / (4.0 * left) if left > 0.0 else math.inf


def _given_out(response: DisplacementResponse, delay: int, torque: float) -> float:
    displacement = energy = 0.0
    for _ in range(delay + 1):
        displacement = next_displacement(displacement, torque, torque, response, response.hand)
        energy += torque * displacement
    return energy + torque * tail_reach(displacement, torque, torque, response, response.hand)


def energy_for_any_hand(
    damping: float, friction: float, sample_time: float, delay: int, stiffness: float, push: float
) -> float:
    """Return the energy [J] that a wall needs before a contact, so that it holds every hand up to a push; >= 0.

    Args:
        damping: Certain viscous damping of the device, > 0 [N*s/m or N*m*s/rad].
        friction: Certain dry friction of the device [N or N*m].
        sample_time: Sample time [s].
        delay: Delay in whole holds.
        stiffness: Stiffness of the wall [N/m or N*m/rad].
        push: Largest force at rest [N or N*m].
    """
    net = max(0.0, push - friction)
    needed = (1 + delay) * net * net * sample_time / (4.0 * damping)
    return max(0.0, needed - push * push / (2.0 * stiffness) - friction * push / stiffness)
