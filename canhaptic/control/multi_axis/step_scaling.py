"""The scalar balance of a scaled step: how much of a state change the energy of a hold pays for.

    H(x + l s) - H(x) + l L = H_m

H is convex along most steps but not along all (double wells), so the root is bracketed first and then found by Newton
steps that fall back to halving the bracket. Whatever happens, at most `_EVALUATIONS` evaluations are made; the energy
that the answer leaves over is booked by the caller, so that an early end costs fidelity and never energy.
"""

import math
from collections.abc import Callable
from typing import Final, NamedTuple

_EVALUATIONS: Final = 60
_SEARCH: Final = 20
"""Evaluations for the bracket; halving has the rest."""
_PIECES: Final = 8
"""In which a step is searched for a place that takes up the energy received, where its end does not."""


class ScaledHold(NamedTuple):
    """What a share of the step takes up, and how that grows."""

    energy: float  # [J]
    slope: float  # [J]


class StepScaling(NamedTuple):
    """A share of the step."""

    share: float
    found: bool  # False: nothing balances; `share` is where the most is given, or the end where the most is taken
    evaluations: int


def solve_scale(taken: Callable[[float], ScaledHold], energy: float, limit: float, tolerance: float) -> StepScaling:
    """Returns the share l nearest 0, |l| <= limit, at which `taken` equals an energy.

    Args:
        taken: Of the share; 0 at 0.
        energy: H_m, what the model received [J].
        limit: Of |l|.
        tolerance: Rounding of `taken` [J].
    """
    search = _ScaleSearch(taken)
    if abs(energy) <= tolerance:
        return StepScaling(0.0, True, 0)
    slope = search.at(0.0).slope
    if slope == 0.0 and energy < 0.0:
        return StepScaling(0.0, False, 1)
    far = limit if (slope > 0.0) == (energy > 0.0) or slope == 0.0 else -limit
    bracket = search.upwards(energy, far) if energy > 0.0 else search.downwards(energy, far)
    if bracket is None:
        return StepScaling(search.best, False, search.evaluations)
    share = search.root(energy, *bracket, tolerance)
    return StepScaling(share, True, search.evaluations)


class _ScaleSearch:
    def __init__(self, taken: Callable[[float], ScaledHold]) -> None:
        self._taken = taken
        self.evaluations = 0
        self.best = 0.0

    def at(self, share: float) -> ScaledHold:
        self.evaluations += 1
        return self._taken(share)

    def upwards(self, energy: float, far: float) -> tuple[float, float] | None:
        """Returns a bracket of a place that takes up at least an energy > 0, from 0 towards `far`."""
        self.best = far
        if self.at(far).energy >= energy:
            return 0.0, far
        for piece in range(1, _PIECES):
            if self.at(far * piece / _PIECES).energy >= energy:
                return 0.0, far * piece / _PIECES
        return None

    def downwards(self, energy: float, far: float) -> tuple[float, float] | None:
        """Returns a bracket of a place that gives at least -energy, from 0 towards the lowest place before `far`."""
        near, here, least = 0.0, far, 0.0
        for _ in range(_SEARCH):
            taken = self.at(here)
            if taken.energy < least:
                least, self.best = taken.energy, here
            if taken.energy <= energy:
                return 0.0, here
            downhill = taken.slope * far < 0.0 and taken.energy <= least
            if downhill:
                if here == far:
                    return None
                near = here
            else:
                far = here
            here = 0.5 * (near + far)
        return None

    def root(self, energy: float, near: float, far: float, tolerance: float) -> float:
        """Returns the share between `near`, which takes up too little of the energy, and `far`, with enough of it."""
        share, width = far, abs(far - near)
        if energy > 0.0:
            slope = self.at(0.0).slope
            if slope * far > 0.0 and abs(energy / slope) < abs(far):
                share = energy / slope
        while self.evaluations < _EVALUATIONS:
            taken = self.at(share)
            missing = energy - taken.energy
            if abs(missing) <= tolerance:
                break
            if (missing > 0.0) == (energy > 0.0):
                near = share
            else:
                far = share
            following = share + missing / taken.slope if taken.slope != 0.0 else math.inf
            if not min(near, far) < following < max(near, far) or abs(following - share) > 0.5 * width:
                following = 0.5 * (near + far)
            width = abs(following - share)
            if following == share:
                break
            share = following
        return share
