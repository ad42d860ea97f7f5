"""Strict bounds on a guard between the two ends of a step, so that no dip below zero is missed.

A guard is a row c; along the flow of a mode, dz/dt = F z, its value is g(t) = c z(t). With d = F z(0), the rate of the
state at the start of a step of length h,

    g(t) = g(0) + p(t) d,   p(t) = c * integral of exp(F s) ds from 0 to t,   g''(t) = c F exp(F t) d.

Rows are taken component by component, so that components which stay (a held torque, a body at rest) count nothing.

Chord.  E_j bounds |p_j(t) - (t/h) p_j(h)| for all t in [0, h]. Then g(t) >= min(g(0), g(h)) - sum_j E_j |d_j|.
        From h to 2h: with M = |p(h) - p(2h)/2|, both halves of the chord lie within M of the whole one, and the second
        half starts at exp(F h) z(0), hence E(2h) = M + max(E(h), E(h) |exp(F h)|).
Bend.   S_j bounds |(c F (exp(F t) - I))_j| for all t in [0, h]. Then |g''(t) - c F d| <= sum_j S_j |d_j|.
        From h to 2h: S(2h) = max(S(h), |c F (exp(F h) - I)| + S(h) |exp(F h)|).
Start.  At a step h where ||F h|| <= 1/4: X = exp(|F| h) - I is at least |exp(F t) - I| for all t in [0, h], in every
        component, hence E = (|c F| + |c F| X) h^2 / 8 and S = |c F| X.

All are upper bounds for every spectrum; they fall as h^2 and as h, so that halving a step decides. They are strict
up to rounding, which is below the part of a guard's largest term that `stepper.py` takes for zero.

They hold at every length, also where h is a million periods of a fast mode: the doublings ask for the flow and the
triangle inequality, and for nothing of the spectrum. So a step may be as long as the hold. A mode at rest has no part
in d and widens no bound; of one that swings the step is halved until its swing is small against the guard. With every
level E and S of an undamped mode grow by a factor; they are cut at a number that excludes nothing and stays finite,
since infinity times a rate of 0 would be no number.
"""

from typing import Final, NamedTuple

import numpy as np

from canhaptic.sim.plant.accuracy_parameters import LEVELS
from canhaptic.sim.plant.propagator import Array, halvings_of, taylor_flow

_LOOSENING: Final = 1.0 + 1e-9
"""The bounds are raised by it for their own rounding."""
_USELESS: Final = 1e140  # a bound this large excludes nothing; its square is still a number


class GuardBounds(NamedTuple):
    """Bounds of one mode, for steps of T / 2^level; y = `scaled` z are the rates of the state, scaled.

    Attributes:
        scaled: Rates that are not always zero, each scaled, as rows, shape (m, n).
        slack: |y| * slack[level, guard] is at least the distance of the guard from its chord; shape (levels + 1, c).
        chord: The same, tighter: sum of |y_j| * chord[level, guard, j]; shape (levels + 1, c, m).
        bend: Second derivative of the guard at the start of a step: bend[guard] . y; shape (c, m).
        spread: Bound of its change in the step: sum of |y_j| * spread[level, guard, j]; shape (levels + 1, c, m).
    """

    scaled: Array
    slack: Array
    chord: Array
    bend: Array
    spread: Array


def guard_bounds(guards: Array, rates: Array, sample_time: float) -> GuardBounds:
    """Return the bounds of the guards of one mode.

    Args:
        guards: Rows of the guards, shape (c, n).
        rates: F of dz/dt = F z, shape (n, n).
        sample_time: T [s], the largest step; the rates are scaled to weigh alike there.
    """
    moving = rates.any(axis=1) if len(guards) else np.zeros(len(rates), dtype=bool)
    chord, spread = (_LOOSENING * bound[:, :, moving] for bound in _bounds(guards, rates, sample_time))
    largest = chord[0].max(axis=1, initial=0.0)
    largest[largest == 0.0] = 1.0
    weights = (chord[0] / largest[:, None]).max(axis=0, initial=0.0)
    weights = np.maximum(weights, 1e-3 * weights.max(initial=0.0))  # a rate that matters at finer steps only
    weights[weights == 0.0] = 1.0
    chord, spread, bend = chord / weights, spread / weights, (guards @ rates)[:, moving] / weights
    return GuardBounds(
        weights[:, None] * rates[moving], _LOOSENING * np.linalg.norm(chord, axis=2), chord, bend, spread
    )


def _bounds(guards: Array, rates: Array, sample_time: float) -> tuple[Array, Array]:
    """Return E and S of the module's text by level, shapes (levels + 1, c, n)."""
    if not len(guards):
        return np.zeros((LEVELS + 1, 0, len(rates))), np.zeros((LEVELS + 1, 0, len(rates)))
    halvings = halvings_of(rates, sample_time, LEVELS)
    step = sample_time * 0.5**halvings
    slopes, identity = guards @ rates, np.eye(len(rates))
    most = taylor_flow(np.abs(rates), step)
    spread = np.abs(slopes) @ most
    chord = (np.abs(slopes) + spread) * (step * step / 8.0)
    change, mean = taylor_flow(rates, step), _mean_flow(rates, step)
    path = step * (guards @ mean)
    chords, spreads = [], []
    for level in range(halvings, -1, -1):
        if level <= LEVELS:
            chords.append(chord)
            spreads.append(spread)
        flow = np.abs(identity + change)
        further = path @ change
        chord = np.minimum(0.5 * np.abs(further) + np.maximum(chord, chord @ flow), _USELESS)
        spread = np.minimum(np.maximum(spread, np.abs(slopes @ change) + spread @ flow), _USELESS)
        path = 2.0 * path + further
        change = 2.0 * change + change @ change
    return np.array(chords[::-1]), np.array(spreads[::-1])


def _mean_flow(rates: Array, step: float) -> Array:
    """Return the mean of exp(F t) for t from 0 to h, for ||F h|| below about one."""
    scaled = rates * step
    term = np.eye(len(rates))
    total = term.copy()
    order = 1
    while np.abs(term).max() > 1e-18 * np.abs(total).max():
        order += 1
        term = term @ scaled / order
        total += term
    return total
