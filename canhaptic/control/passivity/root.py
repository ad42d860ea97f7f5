"""The energy balance of eq. 8 solved for the state change: closed for a linear spring, safeguarded for any other.

Eq. 16 prints dx = (-b - sqrt(b^2 - 4 a c)) / 2 a. That loses all digits where k or the displacement is small, divides
by zero at k = 0, and needs the other sign for the sticky rule. The root nearest zero in the form

    dx = 2 H / (b + sgn(b) sqrt(b^2 + 2 k H)),    b = k x + f_d,    H = energy received

has none of these faults and covers the sticky rule. Near the double root the discriminant cancels, so it is formed from
exact products (Dekker 1971) and an exact sum.
"""

import math
from typing import Final, NamedTuple

from canhaptic.control.environments.environment import Environment

_SPLITTER: Final = 134217729.0  # 2^27 + 1 (Veltkamp)
_ITERATIONS: Final = 80  # bisection alone reaches the last bit of any bracket of one binade in 53
_SMALLEST_STEP: Final = 1e-16  # of the root: below half a unit in its last place


def discriminant(effort: float, product: float, energy: float) -> float:
    """Return effort^2 + product * energy, accurate to its last bits although the two terms may cancel."""
    square = effort * effort
    other = product * energy
    total = square + other
    if total > 0.125 * abs(other):
        return total  # three bits lost at most: no help needed, and this is nearly every hold
    high = _SPLITTER * effort
    high -= high - effort
    low = effort - high
    square_error = ((high * high - square) + 2.0 * high * low) + low * low
    part = total - square
    sum_error = (square - (total - part)) + (other - part)
    return total + (sum_error + (square_error + _product_error(product, energy, other)))


def _product_error(a: float, b: float, product: float) -> float:
    a_high = _SPLITTER * a
    a_high -= a_high - a
    b_high = _SPLITTER * b
    b_high -= b_high - b
    a_low, b_low = a - a_high, b - b_high
    return ((a_high * b_high - product) + a_high * b_low + a_low * b_high) + a_low * b_low


def solve_balance(stiffness: float, effort: float, energy: float, displacement: float) -> float:
    """Return the root nearest zero of k dx^2 / 2 + b dx = H [m or rad], or NaN where no state change balances.

    Args:
        stiffness: k >= 0 [N/m or N*m/rad].
        effort: b, the whole effort opposing motion at the old state: k x + f_d [N or N*m].
        energy: H, what the model received [J].
        displacement: Measured motion of the hold [m or rad]; its sign decides between two roots equally near, and it
            is the answer itself where nothing opposes motion and nothing was received (k = b = 0).
    """
    if energy == 0.0:
        return displacement if stiffness == 0.0 and effort == 0.0 else 0.0
    if effort == 0.0:
        if stiffness == 0.0 or energy < 0.0:
            return math.nan
        return math.copysign(math.sqrt(2.0 * energy / stiffness), displacement)
    if stiffness == 0.0:
        return energy / effort
    under_root = discriminant(effort, 2.0 * stiffness, energy)
    if under_root < 0.0:
        return math.nan
    return 2.0 * energy / (effort + math.copysign(math.sqrt(under_root), effort))


class Balance(NamedTuple):
    """A nonlinear storage before its state changes, and the damper in parallel."""

    state: float  # old one [m or rad]
    stored: float  # energy there [J]
    damper: float  # effort of the damper [N or N*m]


def gain(environment: Environment, old: Balance, change: float) -> float:
    """Return the energy that a state change [m or rad] takes up, stored and dissipated [J]."""
    return environment.stored_energy(old.state + change) - old.stored + old.damper * change


def slope(environment: Environment, old: Balance, change: float) -> float:
    """Return the derivative of `gain` [N or N*m]."""
    return environment.effort(old.state + change) + old.damper


def solve_balance_nonlinear(
    environment: Environment, old: Balance, energy: float, limit: float, tolerance: float
) -> float:
    """Return the root nearest zero of gain(dx) = H for a nonlinear storage, or NaN where no state change balances.

    The direction follows from the sign of H and of the slope at 0. Within it the root is bracketed - by the limit, or
    by the place where the slope turns - and found by Newton steps that fall back to bisection when they leave the
    bracket or do not halve; never more than 80 of them.

    Args:
        environment: Environment with a nonlinear storage.
        old: The state before.
        energy: H, what the model received [J].
        limit: Largest state change to look at [m or rad]; its sign decides where nothing opposes motion at first.
            With more received than the limit takes up the answer is the limit, and the caller leaks the rest.
        tolerance: Rounding of `gain` [J]; nothing finer is looked for.
    """
    if energy == 0.0 or limit == 0.0:
        return 0.0 if energy >= 0.0 else math.nan
    effort = slope(environment, old, 0.0)
    far = math.copysign(limit, energy * effort) if effort != 0.0 else limit
    if effort != 0.0 and (slope(environment, old, far) > 0.0) != (effort > 0.0):
        far = _turning_point(environment, old, far)
    gained = gain(environment, old, far)
    if abs(gained) < abs(energy) or (gained > 0.0) != (energy > 0.0):
        return far if energy > 0.0 else math.nan
    return _newton(environment, old, energy, far, tolerance)


def _turning_point(environment: Environment, old: Balance, far: float) -> float:
    """Return the last place before the slope changes its sign between 0 and `far`."""
    near, rising = 0.0, slope(environment, old, 0.0) > 0.0
    for _ in range(_ITERATIONS):
        middle = 0.5 * (near + far)
        if middle in (near, far):
            break
        if (slope(environment, old, middle) > 0.0) == rising:
            near = middle
        else:
            far = middle
    return near


def _newton(environment: Environment, old: Balance, energy: float, far: float, tolerance: float) -> float:
    """Return the root between 0 and `far`, where |gain| rises from 0 to at least |H|."""
    effort = slope(environment, old, 0.0)
    near, gain_far = 0.0, gain(environment, old, far)
    guess = energy / effort if effort != 0.0 else far
    step = abs(far)
    for _ in range(_ITERATIONS):
        if not min(near, far) < guess < max(near, far):
            guess = _between(near, far, energy, gain_far)
            step = abs(far - near)
            if guess in (near, far):
                break
        gained = gain(environment, old, guess)
        missing = energy - gained
        if abs(missing) <= tolerance:
            break
        if (missing > 0.0) == (energy > 0.0):
            near = guess
        else:
            far, gain_far = guess, gained
        steep = slope(environment, old, guess)
        halving = abs(2.0 * missing) <= step * abs(steep)
        following = guess + missing / steep if halving else _between(near, far, energy, gain_far)
        step = abs(following - guess)
        if step <= _SMALLEST_STEP * abs(guess):
            break
        guess = following
    return guess


def _between(near: float, far: float, energy: float, gain_far: float) -> float:
    """Return a place inside the bracket: its middle, or, while it begins at 0, where a parabola would have the root.

    Halving alone would not get from a motion of a millimetre to the root of a vanishing energy.
    """
    if near == 0.0 and gain_far != 0.0:
        return far * min(0.5, math.sqrt(energy / gain_far))
    return 0.5 * (near + far)
