"""Networks of a group on trial: each leant on and stroked by the hands of the scene, without a bus.

    lean      the hands rest where the network of the scene pushes most
    stroke    the hands move as in the scene

A network passes if the torques that were held are its spring within the tolerance, by least squares over the holds in
contact, if stroked its damping is rendered within it, and if no more energy came out than went in.
"""

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from typing import Any, Final, NamedTuple

import numpy as np

from canhaptic.control.balance import RANKS, WEAKEST_LAST, Certificate
from canhaptic.control.verdict import PASSIVE_TOLERANCE
from canhaptic.errors import CanHapticError, InputError
from canhaptic.lab.batch.engine import ChosenEngine, Engine, chosen_engine
from canhaptic.lab.batch.group_case import group_case
from canhaptic.lab.batch.group_closed_loop import shares
from canhaptic.lab.batch.group_loop import GroupRecorder, render_group
from canhaptic.lab.batch.group_scalar import group_meter
from canhaptic.lab.loop.axis_loop import Array
from canhaptic.lab.studies.design.network_scale import network_scale
from canhaptic.lab.studies.design.trial import STIFFEST, TrialVerdict, verdict_of
from canhaptic.scene.models import AxisScene, MechanismScene, Scene, task_unit
from canhaptic.sim.plant.mechanism.task_hand import PlaneMotion
from canhaptic.sim.plant.user import SinusoidMotion

_SPAN: Final = 10.0
"""Stiffness of the scene over the least that is tried."""
_TIME: Final = 0.05
"""Damping over stiffness that is hardly rendered [s]."""
_LEAN: Final = 1.0  # [s]
_STROKE: Final = (1.0, 5.0)
"""Least and longest time in which the hands move [s]."""
_DECLARED: Final = ("moving_mass", "device_damping", "device_damping_bound")


class _Tried(NamedTuple):
    """What one loop gave."""

    spring: float  # share
    damper: float
    least: float  # [J]
    covered: float
    passed: bool  # whether it ran to its end, in contact
    certificate: int  # its place in `WEAKEST_LAST`


class GroupTrial:
    """The rig on which networks are tried.

    Args:
        scene: With one group, simulated; its network has a spring at its ports (`network_scale`).
        tolerance: How far a rendering may be from what is asked, as a part of it.
        engine: Engine of the trials.
        executor: Runs the loops that are not compiled; None: this thread.

    Attributes:
        scene: With the hands in motion.
        unit: In which the handle moves.
        softest: Stiffness that is tried [N/m or N*m/rad].
        engine: What computes the trials.
        is_quick: Whether they are compiled.
        walls: How many were tried.

    Raises:
        InputError: Several groups, other axes, a network without a spring at its ports, or motors that are not
            simulated.
    """

    def __init__(
        self, scene: Scene, tolerance: float, engine: Engine = "auto", executor: Executor | None = None
    ) -> None:
        if len(scene.groups) != 1 or any(not axis.group for axis in scene.axes):
            raise InputError(f"{scene.source}: has more than one group; one is designed for, make a scene of each")
        (group,) = scene.groups
        self._scale = network_scale(group.network.parameters, group.network.name)
        self.scene, self._tolerance, self._executor = scene, tolerance, executor
        self.unit = task_unit(group.kinematics.name, scene.axis(group.axes[0]).parameters.unit)
        self.softest = min(self._scale.stiffness, STIFFEST) / _SPAN
        self._stroke = _stroke_time(scene)
        self._leaning = self._with_hands_at_rest()
        self._chosen: ChosenEngine = chosen_engine(engine, pays=True)
        self.is_quick = self._chosen == "numba" and group_case(scene).is_compilable
        self.engine, self.walls, self.remark = "numba" if self.is_quick else "python", 0, ""
        self._allowance = float(getattr(group.passivity.parameters, "energy_allowance", 0.0)) + PASSIVE_TOLERANCE
        self._has_damping = all(axis.loop.device_damping for axis in scene.axes)

    def damping_scale(self, stiffness: float) -> float:
        """Return a damping that is hardly rendered."""
        return _TIME * stiffness

    def verdict(self, stiffness: Array, damping: Array) -> TrialVerdict:
        """Try networks; see `Trial.verdict`."""
        self.walls += len(stiffness)
        pairs = list(zip(stiffness.tolist(), damping.tolist(), strict=True))
        scenes = [(scene, time) for scene, time in self._hands() for _ in pairs]
        jobs = [
            (self._with_network(scene, *pair), time, self._chosen)
            for (scene, time), pair in zip(scenes, 2 * pairs, strict=True)
        ]
        run: Callable[..., Any] = map if self._executor is None or self.is_quick else self._executor.map
        table = np.array([*run(_tried, jobs)], dtype=float).reshape(2, len(pairs), -1)
        spring, damper, least, covered, ran, _ = np.moveaxis(table, 2, 0)
        judged = covered if self._has_damping else least
        return verdict_of(
            spring, np.where(damping > 0.0, damper[1], np.nan), least.min(axis=0), judged.min(axis=0),
            ran.all(axis=0), self._allowance, self._tolerance, damping,
        )  # fmt: skip

    def account(self, verdict: TrialVerdict, stiffness: float, damping: float) -> dict[str, Any]:
        """Return what the network is and costs."""
        (group,) = self.scene.groups
        axes = [self.scene.axis(name) for name in group.axes]
        worst = max(
            _tried((self._with_network(scene, stiffness, damping), time, "python"))[5] for scene, time in self._hands()
        )
        network = self._scale.with_values(stiffness, damping).model_dump(mode="json", exclude_unset=True)
        given = group.passivity.parameters
        losses = getattr(given, "max_consecutive_losses", 0)
        hand = {"hand_force": getattr(given, "hand_force", 0.0)} | (
            {"max_consecutive_losses": losses} if losses else {}
        )
        return {
            "scene": self.scene.source,
            "group": group.name,
            "unit": self.unit,
            "network": {"type": group.network.name, **network},
            "stiffness": stiffness,
            "damping": damping,
            **verdict.account(damping),
            "certificate": WEAKEST_LAST[worst].name.lower(),
            "certified": {},
            "engine": self.engine,
            "remark": self.remark,
            "loop": {key: value for key in _DECLARED if (value := getattr(axes[0].loop, key)) is not None},
            "hand": hand,
        }

    def _hands(self) -> Sequence[tuple[Scene, float]]:
        return (self._leaning, _LEAN), (self.scene, self._stroke)

    def _with_network(self, scene: Scene, stiffness: float, damping: float) -> Scene:
        (group,) = scene.groups
        network = group.network._replace(parameters=self._scale.with_values(stiffness, damping))
        return replace(scene, groups=(replace(group, network=network),))

    def _with_hands_at_rest(self) -> Scene:
        """Return the scene with its hands where the torques were largest while they moved."""
        period = self.scene.bus.sample_time
        run = render_group(self.scene, round(self._stroke / period), GroupRecorder(len(self.scene.axes)))
        time = int(np.abs(run.torque).max(axis=1).argmax()) * period
        axes = tuple(_at_rest(axis, time) for axis in self.scene.axes)
        return replace(
            self.scene, axes=axes, mechanisms=tuple(_handle_at_rest(of, time) for of in self.scene.mechanisms)
        )


def _tried(job: tuple[Scene, float, ChosenEngine]) -> _Tried:
    scene, time, engine = job
    try:
        meter = group_meter(group_case(scene, explains=True), round(time / scene.bus.sample_time), engine)
    except CanHapticError:
        return _Tried(np.nan, np.nan, 0.0, 0.0, False, RANKS[Certificate.NONE])
    figures = meter.figures
    passed = figures.diverged == 0.0 and figures.contacts > 0.0
    return _Tried(
        *shares(meter), figures.least_interaction, figures.least_covered, passed, round(figures.certificate)
    )  # fmt: skip


def _motions(scene: Scene) -> list[SinusoidMotion]:
    users = [axis.simulation.user for axis in scene.axes if axis.simulation is not None]
    hands = [motion for of in scene.mechanisms if of.hand is not None for motion in of.hand.motions]
    found = [*(user.motion for user in users if user is not None), *hands]
    return [motion for motion in found if motion is not None]


def _stroke_time(scene: Scene) -> float:
    slowest = min((motion.frequency for motion in _motions(scene)), default=1.0)
    return min(max(1.0 / slowest, _STROKE[0]), _STROKE[1])


def _at_rest(axis: AxisScene, time: float) -> AxisScene:
    user = axis.simulation.user if axis.simulation is not None else None
    if axis.simulation is None or user is None or user.motion is None:
        return axis
    still = user.model_copy(update={"rest": user.rest + user.motion.position(time), "motion": None})
    return replace(axis, simulation=replace(axis.simulation, user=still))


def _handle_at_rest(of: MechanismScene, time: float) -> MechanismScene:
    if of.hand is None:
        return of
    moved = [0.0 if motion is None else motion.position(time) for motion in of.hand.motions]
    rest = tuple(at + by for at, by in zip(of.hand.rest, moved, strict=True))
    return replace(of, hand=of.hand.model_copy(update={"rest": rest, "motion": PlaneMotion()}))
