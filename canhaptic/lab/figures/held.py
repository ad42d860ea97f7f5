"""Largest stiffness that a loop holds at rest under a slowly rising push, found by bisection.

    push     from 0 to its full force while it rises, from in front of the wall; then constant
    held     over the last part of the run: mean torque over mean depth is within the tolerance of the stiffness, depth
             swings by no more than the tolerance, and no more energy came out than the allowance

Initial oscillations must have died away by the damping of device and hand when a wall is judged: `settling_time`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np

from canhaptic.control.environments.spring_damper_wall import SpringDamperWall
from canhaptic.lab.figures.guided import Leg, guided_case
from canhaptic.lab.figures.guided_hand import GuidedHand
from canhaptic.lab.loop.axis_loop import LoopCase, Recorder, render
from canhaptic.sim.plant.effects import Effect
from canhaptic.sim.plant.plant import PlantParameters

_FURTHEST: Final = 4.0
"""Way that counts as divergence, over the depth asked for."""
_LEAST_FURTHEST: Final = 0.2  # [m or rad]
_TIMES: Final = 5.0
"""Time constants of a free swing in a run."""


@dataclass(frozen=True, slots=True)
class Leaning:
    """A push against a wall at the origin."""

    push: float = 5.0  # [N or N*m]
    rise: float = 0.3  # [s]
    clearance: float = 5e-4  # [m or rad] in front of the wall
    duration: float = 5.0  # [s]
    rest: float = 0.5  # at the end, over which it is judged [s]
    tolerance: float = 0.05
    allowance: float = 1e-6  # of energy given out [J]
    damping: float = 0.0  # of the hand [N*s/m or N*m*s/rad]
    per_decade: int = 12  # walls tried before the largest is bracketed
    fine: float = 0.005  # part to which the largest stiffness is found


def settling_time(mass: float, damping: float) -> float:
    """Time of leaning until a swing of the device on an ideal spring has died away to 1 % [s]."""
    return _TIMES * 2.0 * mass / damping


class Held(NamedTuple):
    """Outcome of a trial of one wall."""

    share: float  # mean torque over the requested one at the mean depth
    ripple: float  # way to and fro over the mean depth
    least: float  # least true sum of h_i [J]
    passed: bool


@dataclass(frozen=True, slots=True)
class Bench:
    """The device that is loaded."""

    case: LoopCase  # its environment and plant are replaced
    plant: PlantParameters
    effects: Sequence[Effect] = ()
    seed: int = 0


def held(bench: Bench, stiffness: float, leaning: Leaning, damping: float = 0.0) -> Held:
    """Outcome of one wall.

    Args:
        bench: Device and loop.
        stiffness: Stiffness of the wall [N/m or N*m/rad].
        leaning: Push on the wall.
        damping: Damping of the wall [N*s/m or N*m*s/rad].
    """
    plant = bench.plant.model_copy(update={"initial_position": leaning.clearance, "initial_velocity": 0.0})
    course = (Leg(0.0, push_rate=-leaning.push / leaning.rise), Leg(leaning.rise))
    wall = SpringDamperWall(stiffness=stiffness, damping=damping)
    hand = GuidedHand(damping=leaning.damping)
    case = guided_case(replace(bench.case, environment=wall), plant, hand, course, bench.effects, bench.seed)
    period = case.sample_time_ns * 1e-9
    deepest = max(_FURTHEST * leaning.push / stiffness, _LEAST_FURTHEST)
    run = render(case, round(leaning.duration / period), Recorder(furthest=deepest))
    if run.ended:
        return Held(float("nan"), float("nan"), run.least_interaction, passed=False)
    last = slice(-max(2, round(leaning.rest / period)), None)
    depth, torque = -run.true_position[last], run.torque[last]
    mean = float(depth.mean())
    share = float(torque.mean()) / (stiffness * mean) if mean > 0.0 else 0.0
    ripple = float(np.ptp(depth)) / mean if mean > 0.0 else float("inf")
    least = run.least_interaction
    within = abs(share - 1.0) <= leaning.tolerance and ripple <= leaning.tolerance
    return Held(share, ripple, least, within and least >= -leaning.allowance)


class LargestHeld(NamedTuple):
    """Result of `largest_held`."""

    stiffness: float  # 0: none [N/m or N*m/rad]
    softer: int  # walls that were tried and are softer
    failing: int  # those of them that are not held


def largest_held(bench: Bench, leaning: Leaning, softest: float, stiffest: float) -> LargestHeld:
    """Largest stiffness that is held; counts the softer walls that are not.

    Args:
        bench: Device and loop.
        leaning: Push on the walls.
        softest: Stiffness tried first [N/m or N*m/rad].
        stiffest: Largest stiffness tried; below the softest none is.
    """
    if stiffest < softest:
        return LargestHeld(0.0, 0, 0)
    walls = np.geomspace(softest, stiffest, 2 + int(leaning.per_decade * np.log10(stiffest / softest))).tolist()
    passed = [held(bench, stiffness, leaning).passed for stiffness in walls]
    if True not in passed:
        return LargestHeld(0.0, 0, 0)
    last = len(passed) - 1 - passed[::-1].index(True)
    low, high = walls[last], walls[min(last + 1, len(walls) - 1)]
    while high > (1.0 + leaning.fine) * low:
        middle = (low * high) ** 0.5
        low, high = (middle, high) if held(bench, middle, leaning).passed else (low, middle)
    return LargestHeld(float(low), last, passed[:last].count(False))
