"""The largest stiffness, and then the largest damping, that `guarded` renders within a tolerance and with a margin.

Bisection by many walls at once: a range is tried at evenly spaced places, the interval in which walls stop passing is
tried again, until it is as narrow as the answer's digits. A wall counts only if every smaller one that was tried
passes, softer ones with the same damping included: what a rig renders need not fall evenly.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from canhaptic.errors import CheckFailedError, InputError
from canhaptic.scene.hints import stability_hints
from canhaptic.scene.load import scene_from_text
from canhaptic.scene.models import Scene
from canhaptic.study.compare import compare
from canhaptic.study.design.trial import ALGORITHM, DAMPING, DURATION, STIFFEST, STIFFNESS, Trial, Verdict
from canhaptic.study.loop import Array
from canhaptic.study.sweep.places import places_of
from canhaptic.study.sweep.sweep import Engine

TOLERANCE: Final = 0.05
MARGIN: Final = 0.2
_PLACES: Final = 16
_ROUNDS: Final = 3
_DIGITS: Final = 3
_SHARES: Final = (1.0, 0.6, 0.3)
"""Of the stiffest wall: the stiffnesses whose largest damping is shown, so that one can be traded for the other."""
_BELOW: Final = (0.2, 0.4, 0.6, 0.8, 1.0)
"""Of a stiffness: where a damping has to pass, too."""
_GRID: Final = 10
"""Stiffnesses and dampings at which walls below the answer are tried."""
_MOST_WALLS: Final = _ROUNDS * _PLACES * (1 + len(_SHARES) * len(_BELOW)) + _GRID * _GRID + 1


@dataclass(frozen=True, slots=True)
class Design:
    """A wall, and what it costs."""

    stiffness: float  # [N/m or N*m/rad]
    damping: float  # [N*s/m or N*m*s/rad]
    trade: tuple[tuple[float, float], ...]  # other walls: (stiffness, largest damping)
    result: dict[str, Any]  # plain values, as `canhaptic design --json` prints them


def design_wall(
    scene: Scene,
    margin: float = MARGIN,
    tolerance: float = TOLERANCE,
    engine: Engine = "auto",
    progress: Callable[[int, int], None] = lambda _tried, _most: None,
) -> Design:
    """Returns the stiffest wall for the rig of a scene, and the largest damping at that stiffness.

    Args:
        scene: Of one axis, simulated or with `passivity.moving_mass` declared.
        margin: Part by which stiffness and damping could both be larger and still pass.
        tolerance: How far a rendering may be from what is asked, as a part of it.
        engine: Of the trials, as for a sweep.
        progress: Told the number of walls tried, and how many there can be at most.

    Raises:
        InputError: The scene cannot be designed for, or a margin or tolerance is out of range.
        CheckFailedError: Not even the softest wall passes.
    """
    if not 0.0 <= margin <= 10.0 or not 0.0 < tolerance < 1.0:
        raise InputError(
            f"got margin {margin:g} and tolerance {tolerance:g}, expected 0 <= margin <= 10, 0 < tolerance < 1"
        )
    trial = Trial(scene, tolerance, engine)
    search = _Search(trial, 1.0 + margin, progress)
    stiffest = search.largest_stiffness()
    trade = tuple((k, search.largest_damping(k)) for k in (_rounded(share * stiffest) for share in _SHARES))
    stiffness, damping = trade[0]
    hollow = search.failing_below(stiffness, damping)
    result = _account(trial, stiffness, damping)
    result |= {"margin": margin, "tolerance": tolerance, "failing_below": hollow, "walls": trial.walls}
    result["trade"] = [{"stiffness": k, "damping": d} for k, d in trade]
    return Design(stiffness, damping, trade, result)


class _Search:
    """Bisection with a factor on everything that is tried."""

    def __init__(self, trial: Trial, factor: float, progress: Callable[[int, int], None]) -> None:
        self._trial, self._factor, self._progress = trial, factor, progress

    def largest_stiffness(self) -> float:
        """Returns the largest stiffness without damping, a few digits of it.

        Raises:
            CheckFailedError: Not even the softest wall passes.
        """
        softest = self._trial.softest
        low, high = softest, STIFFEST / self._factor
        for _ in range(_ROUNDS):
            places = np.geomspace(low, high, _PLACES)
            count = _before_failing(self._verdict(places, np.zeros(_PLACES)).passed)
            if count == 0 and low == softest:
                verdict = self._verdict(places[:1], np.zeros(1))
                raise CheckFailedError(
                    f"{self._trial.scene.source}: not even {low * self._factor:g} is rendered within the tolerance "
                    f"(stiffness {100.0 * float(verdict.stiffness_share[0]):.3g} % of what was asked, "
                    f"{float(verdict.least_interaction[0]):.3g} J given out); raise bus.rate, or declare what is "
                    "certain (passivity.moving_mass, device_damping)"
                )
            if count == _PLACES:
                return _rounded(high)
            low, high = float(places[max(0, count - 1)]), float(places[count])
        return _rounded(low)

    def largest_damping(self, stiffness: float) -> float:
        """Returns the largest damping at a stiffness, 0 when none passes."""
        scale = self._damping_scale(stiffness)
        low, high = 0.0, 4.0 * scale
        for _ in range(_ROUNDS):
            places = np.linspace(low, high, _PLACES)
            below = np.array(_BELOW) * stiffness
            verdict = self._verdict(np.tile(below, _PLACES), np.repeat(places, len(below)))
            count = _before_failing(verdict.passed.reshape(_PLACES, len(below)).all(axis=1))
            if count == 0:
                return 0.0
            if count == _PLACES:
                return _rounded(high)
            low, high = float(places[count - 1]), float(places[count])
        return _rounded(low)

    def failing_below(self, stiffness: float, damping: float) -> int:
        """Returns how many of the walls tried below a wall do not pass: 0 for a wall without hidden weakness."""
        parts = np.linspace(1.0 / _GRID, 1.0, _GRID)
        dampings = parts if damping else np.zeros(1)
        grid = np.array([(k, d) for k in parts for d in dampings])
        return int((~self._verdict(grid[:, 0] * stiffness, grid[:, 1] * damping).passed).sum())

    def _damping_scale(self, stiffness: float) -> float:
        """Returns a damping that is hardly rendered: it stops the mass in one hold, or is half the critical one."""
        scene = self._trial.scene
        [axis] = scene.axes
        assert axis.simulation is not None
        mass = axis.simulation.plant.mass
        return max(mass / scene.bus.sample_time, math.sqrt(stiffness * mass))

    def _verdict(self, stiffness: Array, damping: Array) -> Verdict:
        found = self._trial.verdict(self._factor * stiffness, self._factor * damping)
        self._progress(self._trial.walls, _MOST_WALLS)
        return found


def _before_failing(passed: Any) -> int:
    """Returns how many pass before the first that does not."""
    return int(np.logical_and.accumulate(passed).sum())


def _rounded(value: float) -> float:
    """Returns a value with a few digits, never a larger one."""
    if value <= 0.0:
        return 0.0
    unit = 10.0 ** (math.floor(math.log10(value)) - _DIGITS + 1)
    return float(f"{math.floor(value / unit * (1.0 + 1e-12)) * unit:.{_DIGITS}g}")


def _account(trial: Trial, stiffness: float, damping: float) -> dict[str, Any]:
    """Returns what the wall is and costs: one run of it, leant on, beside the continuous wall."""
    verdict = trial.verdict(np.array([stiffness]), np.array([damping]))
    values = {STIFFNESS: stiffness, DAMPING: damping}
    places = places_of(trial.scene, tuple(values))
    overrides = [f"{place}={value!r}" for key, value in values.items() for place in places[key]]
    wall = scene_from_text(trial.scene.text, trial.scene.source, [*trial.scene.overrides, *overrides])
    [axis] = wall.axes
    axes = compare(wall, [ALGORITHM], duration=DURATION, repeats=0).result["axes"]
    run = axes[axis.parameters.name]["algorithms"][ALGORITHM]
    hints = [hint for hint in stability_hints(axis) if hint.what.startswith("stiffness, certified")]
    return {
        "scene": trial.scene.source,
        "unit": axis.parameters.unit,
        "stiffness": stiffness,
        "damping": damping,
        "stiffness_rendered": float(verdict.stiffness_share[0]),
        "damping_rendered": float(verdict.damping_share[0]) if damping else None,
        "least_interaction": float(verdict.least_interaction[0]),
        "least_judged": float(verdict.least_judged[0]),
        "certificate": run.get("certificate"),
        "certified": {
            hint.what.removeprefix("stiffness, certified").strip() or "largest": hint.limit for hint in hints
        },
        "engine": trial.engine,
        "told": trial.remark,
        "loop": {key: getattr(axis.loop, key) for key in ("moving_mass", "device_damping", "device_damping_bound")},
        "hand_force": getattr(axis.passivity.parameters, "hand_force", 0.0),
    }
