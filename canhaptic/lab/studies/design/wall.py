"""The largest stiffness, and then the largest damping, that `guarded` renders within a tolerance and with a margin.

A first batch samples the whole range, a second batch the interval in which walls cease to pass. A wall counts only if
every smaller wall that was tried passes or nearly passes, softer walls with the same damping included, because the
rendered share need not fall monotonically.

`felt_of` computes what the hand of a scene feels at walls on its rig:

held    the largest wall within the tolerance at rest, for a push that rises slowly to a fraction of the torque limit
drag    the largest torque in front of a wall, against a hand that approaches at an ordinary speed
start   the least speed at which the wall holds a hand on a spring, with at least half the force of the ideal wall at
        rest, instead of letting it pass
drags   the same for possible declared drags, after the distance over which drag and declared friction of the device
        earn the energy of a start
"""

import math
import os
from collections.abc import Callable
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np

from canhaptic.axis_units import stiffness_unit
from canhaptic.control.certificates.scalar_bounds import displacement_response, renderable_by_hand_force
from canhaptic.control.environments.spring_damper_wall import SpringDamperWall
from canhaptic.control.passivity.guarded import GuardedParameters, hand_response, kept_for_contacts
from canhaptic.errors import CheckFailedError
from canhaptic.lab.batch import Engine
from canhaptic.lab.loop.axis_loop import Array, able_under, loop_case, plant_parts, require_design_room
from canhaptic.lab.studies import Row
from canhaptic.lab.studies.compare import are_displays, compare
from canhaptic.lab.studies.design import trial as trials
from canhaptic.lab.studies.design.contact_quality import Bench, Leaning, SlowHand, enter, largest_held, settling_time
from canhaptic.lab.studies.runner import pool_of
from canhaptic.lab.studies.sweep.chunk import places_of
from canhaptic.scene.hints import DRAG, ENCODER, LEAN, guarantee, stability_hints
from canhaptic.scene.load import scene_from_text
from canhaptic.scene.models import AxisScene, Scene
from canhaptic.units import Parameters

_PUSHES: Final = (0.5 * LEAN, LEAN, 2.0 * LEAN)
"""Pushes, as fractions of the torque limit."""
_DEEPEST: Final = 0.1
"""Depth [m or rad] of the softest wall that is tried."""
_STIFFEST: Final = 4.0
"""Stiffness as a multiple of m / T^2, above which no certificate covers a wall."""
_ORDINARY: Final = {"m": 0.15, "rad": 1.5}
"""Ordinary speed of a hand [m/s or rad/s]."""
_SPEEDS: Final = (0.1, 10.0)
"""Slowest and fastest contact tried, as multiples of the ordinary speed."""
_HALVINGS: Final = 5
_HELD: Final = 0.5
_LONGEST: Final = 5.0  # leaning [s]
_FURTHER: Final = 1.25
"""Ratio of the free distance in front of a wall to the distance in which drag earns the energy that contact needs."""
_FURTHEST: Final = {"m": 0.5, "rad": 5.0}
"""Longest distance tried in front of a wall [m or rad]."""


def felt_of(scene: Scene, algorithm: str, hand: dict[str, float], tolerance: float, stiffness: float) -> Row:
    """Return the figures felt on the rig of a scene, as plain values.

    Args:
        scene: Scene of one simulated axis, with a wall.
        algorithm: Name of the algorithm that renders.
        hand: Stiffness and damping of the grip [N/m, N*s/m or N*m/rad, N*m*s/rad].
        tolerance: Largest relative difference of a stiffness from the requested one.
        stiffness: Stiffness of the wall that is entered slowly [N/m or N*m/rad].
    """
    axis = able_under(scene.axes[0], algorithm, scene).axis
    limit, (plant, _, effects, seed) = axis.parameters.torque_limit, plant_parts(axis)
    bench = Bench(loop_case(axis, scene), plant, effects, seed)
    period, speed = scene.bus.sample_time, _ORDINARY[axis.parameters.unit]
    duration = min(_LONGEST, 1.0 + settling_time(plant.mass, plant.damping + hand["damping"]))
    leaning = Leaning(duration=duration, tolerance=tolerance, damping=hand["damping"], per_decade=5, fine=0.02)
    walls = []
    for push in (part * limit for part in _PUSHES):
        found = largest_held(bench, replace(leaning, push=push), push / _DEEPEST, _STIFFEST * plant.mass / period**2)
        walls.append(
            {"push": push, "held": found.stiffness, "certified": _certified(axis, push), "softer": found.softer,
             "softer_not_held": found.failing}
        )  # fmt: skip
    comes = SlowHand(
        speed, hand["stiffness"], hand["damping"], 0.1 * speed, LEAN * limit / hand["stiffness"], settling=1.0, rest=0.3
    )
    wall = SpringDamperWall(stiffness=stiffness)
    return {
        "walls": walls,
        "drag": enter(bench, wall, comes).drag,
        "speed": speed,
        "start_speed": _start_speed(bench, wall, comes),
        "slowest": _SPEEDS[0] * speed,
        "drags": _drags(bench, axis, wall, comes),
    }


def _drags(bench: Bench, axis: AxisScene, wall: SpringDamperWall, comes: SlowHand) -> list[dict[str, float | None]]:
    """Return rows on the energy earned by drag; none if every contact is felt without, or hand or mass are unknown."""
    parameters, loop = bench.case.parameters, axis.loop
    if not isinstance(parameters, GuardedParameters):
        return []
    asks = parameters.model_copy(update={"earned_energy": None, "drag": 0.0})
    energy = kept_for_contacts(wall, asks, loop, hand_response(asks, loop))
    rows: list[dict[str, float | None]] = []
    for drag in sorted({0.0, parameters.drag, DRAG}) if energy else ():
        earning = drag + (loop.device_friction or 0.0)
        way, start = energy / earning if earning > 0.0 else None, None
        if way is not None and _FURTHER * way <= _FURTHEST[axis.parameters.unit]:
            tried = replace(bench, case=replace(bench.case, parameters=asks.model_copy(update={"drag": drag})))
            start = _start_speed(tried, wall, replace(comes, free=max(comes.free, _FURTHER * way)))
        rows.append({"drag": drag, "energy": energy, "way": way, "start_speed": start})
    return rows


def _certified(axis: AxisScene, push: float) -> float | None:
    """Return the stiffness that the hand-force certificate covers at a push; None if no hand force is declared."""
    force, loop = getattr(axis.passivity.parameters, "hand_force", None), axis.loop
    if force is None or loop.moving_mass is None:
        return None
    pull, most = force + (loop.device_friction_bound or 0.0), loop.device_damping_bound or 0.0
    least = loop.device_damping or 0.0
    response = displacement_response(loop.sample_time, loop.moving_mass, pull, least, most, timing=loop.timing)
    return renderable_by_hand_force(response, loop.delay, push)


def _start_speed(bench: Bench, wall: SpringDamperWall, comes: SlowHand) -> float | None:
    """Return the speed of approach [m/s or rad/s] from which the wall holds the hand; None if it never does."""

    def is_held(speed: float) -> bool:
        hand = replace(comes, speed=speed)
        ideal = comes.into * comes.stiffness / (comes.stiffness + wall.stiffness)
        lacking = comes.into - enter(bench, wall, hand).depth
        return lacking >= _HELD * (comes.into - ideal)

    slow, fast = (part * comes.speed for part in _SPEEDS)
    if is_held(slow):
        return slow
    if not is_held(fast):
        return None
    for _ in range(_HALVINGS):
        middle = (slow * fast) ** 0.5
        slow, fast = (slow, middle) if is_held(middle) else (middle, fast)
    return fast


TOLERANCE: Final = 0.05
MARGIN: Final = 0.2
_DECADES: Final = 4.0
"""Decades of damping that are tried, below the limit of rendering."""
_DEVICE: Final = ("moving_mass", "device_damping", "device_damping_bound", "device_friction", "device_friction_bound")
"""Keys of the loop that declare the device; keys of the timing belong to the rig."""
_DIGITS: Final = 3
_SHARES: Final = (1.0, 0.6, 0.3)
"""Fractions of the largest stiffness for which the largest damping is shown, as the trade-off of the two."""
_BELOW: Final = (0.2, 0.4, 0.6, 0.8, 1.0)
"""Fractions of a stiffness with which a damping must also pass."""


class _Places(NamedTuple):
    """Number of walls that are tried in each step of a search."""

    stiffnesses: tuple[int, ...]  # in the whole range, then in each interval found
    dampings: tuple[int, ...]  # the same
    below: int  # stiffnesses, and dampings, at which walls below the answer are tried

    @property
    def most(self) -> int:
        """Largest number of walls of a whole search."""
        return sum(self.stiffnesses) + len(_SHARES) * len(_BELOW) * sum(self.dampings) + self.below**2 + 1


_COMPILED: Final = _Places((128, 64), (32, 32), 10)
_ONE_BY_ONE: Final = _Places((12, 6, 6), (8, 6), 5)
_GROUPS: Final = _Places((12, 6), (6,), 3)
"""Numbers of walls if Python runs the loop of a group, which takes four times as long as the loop of an axis."""


def design(
    scene: Scene,
    margin: float = MARGIN,
    tolerance: float = TOLERANCE,
    engine: Engine = "auto",
    progress: Callable[[int, int], None] = lambda _tried, _most: None,
) -> Row:
    """Return the stiffest wall for the rig of a scene, and the largest damping at that stiffness, as plain values.

    For admittance displays it is the lightest mass of each, see `design_displays`.

    Args:
        scene: Simulated scene of one group; or scene of one axis, simulated or with `passivity.moving_mass` declared.
        margin: Relative reserve by which stiffness and damping could both be larger and still pass.
        tolerance: Largest relative difference of a rendering from the requested one.
        engine: Engine of the trials, as for a sweep.
        progress: Called with the number of walls tried, and the largest possible number.

    Raises:
        InputError: The scene cannot be designed for, or a margin or tolerance is out of range.
        CheckFailedError: Not even the softest wall passes.
    """
    if are_displays(scene):
        from canhaptic.lab.studies.design.admittance_design import design_displays

        return design_displays(scene, margin, tolerance, progress)
    require_design_room(margin, tolerance)
    if not scene.groups:
        return _designed(trials.Trial(scene, tolerance, engine), margin, tolerance, progress)
    trial, cores = trials.GroupTrial(scene, tolerance, engine), os.cpu_count() or 1
    with pool_of(1 if trial.is_quick else cores) as pool:  # a group that Python runs gets a process on each core
        trial.executor = None if pool is None else pool.executor
        return _designed(trial, margin, tolerance, progress)


def _designed(
    trial: trials.Trial | trials.GroupTrial, margin: float, tolerance: float, progress: Callable[[int, int], None]
) -> Row:
    search = _WallSearch(trial, 1.0 + margin, progress)
    stiffest = search.largest_stiffness()
    stiffnesses = [_rounded(share * stiffest) for share in _SHARES]
    dampings = search.largest_dampings(np.array(stiffnesses))
    stiffness, damping = stiffnesses[0], dampings[0]
    below, verdict = search.below_and_at(stiffness, damping)
    if isinstance(trial, trials.Trial):
        result = _account(trial, verdict, stiffness, damping)
        result["felt"] = felt_of(trial.scene, trials.ALGORITHM, trial.hand, tolerance, stiffness)
    else:
        result = trial.account(verdict, stiffness, damping)
    result |= {"margin": margin, "tolerance": tolerance, "walls": trial.walls}
    result |= {"tried_below": len(below), "failing_below": int((~below).sum())}
    result["trade"] = [{"stiffness": k, "damping": d} for k, d in zip(stiffnesses, dampings, strict=True)]
    return result


class _WallSearch:
    """Search in batches, one for the whole range and one per interval found; `factor` scales the walls tried."""

    def __init__(
        self, trial: trials.Trial | trials.GroupTrial, factor: float, progress: Callable[[int, int], None]
    ) -> None:
        self._trial, self._factor, self._progress = trial, factor, progress
        self._places = _COMPILED if trial.is_quick else _ONE_BY_ONE if isinstance(trial, trials.Trial) else _GROUPS
        progress(0, self._places.most)

    def largest_stiffness(self) -> float:
        """Return the largest stiffness without damping, rounded to a few digits.

        Raises:
            CheckFailedError: Not even the softest wall passes.
        """
        low, high = self._trial.softest, trials.STIFFEST / self._factor
        for places in self._places.stiffnesses:
            tried = np.geomspace(low, high, places)
            verdict = self._verdict(tried, np.zeros(places))
            last, first = _edges(verdict.passed, verdict.nearly)
            if last < 0 and low == self._trial.softest:
                raise self._nothing_passes(verdict)
            if first == places:
                return _rounded(high)
            low, high = float(tried[max(last, 0)]), float(tried[first])
        return _rounded(low)

    def _nothing_passes(self, verdict: trials.TrialVerdict) -> CheckFailedError:
        softest = f"{self._trial.softest * self._factor:g} {stiffness_unit(self._trial.unit)}"
        return CheckFailedError(
            f"{self._trial.scene.source}: not even {softest} is rendered within the tolerance "
            f"(stiffness {100.0 * float(verdict.stiffness_share[0]):.3g} % of what was asked, "
            f"{float(verdict.least_interaction[0]):.3g} J given out); raise bus.rate, or declare what is "
            "certain (passivity.moving_mass, device_damping)"
            + (", or a smaller passivity.max_consecutive_losses" if self._trial.scene.groups else "")
        )

    def largest_dampings(self, stiffnesses: Array) -> list[float]:
        """Return the largest damping at each stiffness, shape (n,), or 0 if none passes; all are searched at once."""
        highest = 4.0 * np.array([self._trial.damping_scale(stiffness) for stiffness in stiffnesses.tolist()])
        first, *others = self._places.dampings
        shares = np.concatenate([[0.0], np.logspace(-_DECADES, 0.0, first - 1)])
        low, high = self._between(stiffnesses, highest[:, None] * shares)
        for places in others:
            low, high = self._between(stiffnesses, np.linspace(low, high, places, axis=1))
        return [_rounded(damping) for damping in low.tolist()]

    def _between(self, stiffnesses: Array, dampings: Array) -> tuple[Array, Array]:
        """Return the last damping that passes and the first that is excluded, shape (n,) each.

        Args:
            stiffnesses: Shape (n,).
            dampings: Rising, shape (n, m). If all pass, both results are the last; if none does, both are the first.
        """
        walls = np.broadcast_arrays(stiffnesses[:, None, None] * np.array(_BELOW), dampings[:, :, None])
        verdict = self._verdict(*(wall.ravel() for wall in walls))
        passed, nearly = (np.all(found.reshape(walls[0].shape), axis=2) for found in (verdict.passed, verdict.nearly))
        edges = np.array([_edges(*row) for row in zip(passed, nearly, strict=True)]).clip(0, dampings.shape[1] - 1)
        rows = np.arange(len(dampings))
        return dampings[rows, edges[:, 0]], dampings[rows, edges[:, 1]]

    def below_and_at(self, stiffness: float, damping: float) -> tuple[trials.Booleans, trials.TrialVerdict]:
        """Return which weaker walls pass, and the verdict on the wall itself.

        A wall is accepted if all weaker walls pass too. They are tried with the factor, the wall itself without it.
        """
        parts = np.linspace(1.0 / self._places.below, 1.0, self._places.below)
        dampings = parts if damping else np.zeros(1)
        grid = np.array([(k, d) for k in parts for d in dampings])
        own = np.array([[1.0, 1.0]]) / self._factor
        verdict = self._verdict(*(np.concatenate([grid, own]) * (stiffness, damping)).T)
        return verdict.passed[:-1], verdict.last()

    def _verdict(self, stiffness: Array, damping: Array) -> trials.TrialVerdict:
        found = self._trial.verdict(self._factor * stiffness, self._factor * damping)
        self._progress(self._trial.walls, self._places.most)
        return found


def _edges(passed: trials.Booleans, nearly: trials.Booleans) -> tuple[int, int]:
    """Return the index of the last wall that passes, or -1, before the first that clearly fails, and that index too."""
    first = int(np.logical_and.accumulate(nearly).sum())
    return int(np.flatnonzero(np.append(True, passed[:first]))[-1]) - 1, first


def _chosen(parameters: Parameters) -> Row:
    """Return the values that differ from their defaults, without `alpha`, which has its own unit."""
    fields = type(parameters).model_fields.items()
    return {k: value for k, of in fields if (value := getattr(parameters, k)) != of.default and k != "alpha"}


def _rounded(value: float) -> float:
    """Return a value rounded down to a few digits."""
    if value <= 0.0:
        return 0.0
    unit = 10.0 ** (math.floor(math.log10(value)) - _DIGITS + 1)
    return float(f"{math.floor(value / unit * (1.0 + 1e-12)) * unit:.{_DIGITS}g}")


def _account(trial: trials.Trial, verdict: trials.TrialVerdict, stiffness: float, damping: float) -> Row:
    """Return the figures of a wall: its verdict, and a run with the leaning hand, compared with the continuous wall."""
    scene, values = trial.scene, {trials.STIFFNESS: stiffness, trials.DAMPING: damping}
    places = places_of(scene, tuple(values))
    overrides = [f"{place}={value!r}" for key, value in values.items() for place in places[key]]
    allowed = bool(scene.own_code)
    wall = scene_from_text(scene.text, scene.source, [*scene.overrides, *overrides], allow_code=allowed)
    [axis] = wall.axes
    axes = compare(wall, [trials.ALGORITHM], duration=trials.DURATION, repeats=0).result["axes"]
    hints = stability_hints(axis)
    run, parameters = axes[axis.parameters.name]["algorithms"][trials.ALGORITHM], axis.passivity.parameters
    return {
        "scene": scene.source,
        "unit": axis.parameters.unit,
        "stiffness": stiffness,
        "damping": damping,
        **verdict.account(damping),
        "certificate": run.get("certificate"),
        "certified": {hint.certificate: hint.limit for hint in hints if hint.certificate},
        "guarantee": [guarantee(axis, hints), *(f"{h.what}: {h.text}" for h in hints if h.what.endswith(ENCODER))],
        "engine": trial.engine,
        "remark": trial.remark,
        "loop": {key: value for key, value in _chosen(axis.loop).items() if key in _DEVICE},
        "hand": {"hand_force": getattr(parameters, "hand_force", 0.0), **_chosen(parameters)},
    }
