"""The port of a scene that a study of accuracy is about, how long it is compared, and how the study runs."""

from collections.abc import Callable, Iterator
from dataclasses import KW_ONLY, dataclass, replace
from typing import Final, NamedTuple

import numpy as np

from canhaptic.errors import InputError
from canhaptic.lab.loop.axis_loop import mechanism_moved, parts_of, require_near, under
from canhaptic.lab.studies import Row
from canhaptic.lab.studies.accuracy import plant_solvers
from canhaptic.lab.studies.accuracy.accuracy_table import length
from canhaptic.lab.studies.accuracy.loop_sensitivity import HOLDS, Stop, holds_of, settings_now
from canhaptic.scene.far_side import build_plant
from canhaptic.scene.method import simulation_of, torque_history
from canhaptic.scene.models import AxisScene, Scene
from canhaptic.sim.plant import AccuracyParameters
from canhaptic.sim.plant.direct_rig import observed

UNITS: Final = 1000
"""Units of progress in the whole study."""


def first_rows(alone: Scene, holds: int) -> Iterator[str]:
    """Yield a line for each setting of the plant of an axis: its evaluations, and its difference from the finest."""
    if alone.groups:
        return
    (axis,), period = alone.axes, alone.bus.sample_time_ns
    simulation = simulation_of(axis)
    torques = torque_history(axis, alone, holds, simulation.accuracy)
    settings = plant_solvers.own_ladder(simulation, period)
    best = observed(build_plant(replace(simulation, accuracy=settings[-1]), period), torques).position
    for accuracy in dict.fromkeys((plant_solvers.own_setting(simulation, period), *settings)):
        rung = plant_solvers.ours(simulation, accuracy, torques, period)
        motion, evaluations, _ = rung.observe()
        apart = length(float(np.abs(motion.position - best).max()), axis.parameters.unit)
        yield f"{rung.setting}: {evaluations / holds:.3g} evaluations per period, {apart} from the finest setting"


def now(alone: Scene) -> Row:
    """Return a port's own values of the settings that variants change, by kind of change, and its accuracy."""
    accuracy, plant = AccuracyParameters(), alone.axes[0].simulation  # none where a mechanism moves the axes
    if plant is not None:
        accuracy = plant_solvers.own_setting(plant, alone.bus.sample_time_ns)
    return {"accuracy": accuracy.model_dump(include={"event_bits", "substeps"}), **settings_now(alone)}


def studied(scene: Scene, name: str | None) -> Scene:
    """Return the scene with only one port, by its name or that of one of its axes; by default that of the first axis.

    Raises:
        InputError: There is none of that name, or its mechanism also moves others.
    """
    require_near(scene)
    parts = parts_of(scene)
    chosen = next((axis.port for axis in scene.axes if name in (None, axis.parameters.name, axis.port)), None)
    if chosen is None:
        raise InputError(f"{scene.source}: got axis {name!r}, expected one of: {', '.join(parts)}")
    mechanism_moved(parts[chosen])
    return parts[chosen]


_LONGEST: Final = 4000
"""Largest number of sample times that are searched for the second contact."""
_AFTER: Final = 100
"""Number of sample times of the second contact that are compared."""
_JUDGED_WITH: Final = "unprotected"
"""Algorithm of a study if the scene's own algorithm sends no torque."""


class Length(NamedTuple):
    """The scene that an accuracy study runs, and the number of holds that it compares."""

    scene: Scene
    holds: int
    remark: str = ""  # why the scene is not the one that was given


def length_of(scene: Scene, name: str | None, duration: float | None = None) -> Length:
    """Return the length over which a scene is compared: until its second contact, unless a duration is given [s].

    If the algorithm of the scene sends no torque, the unprotected controller is used instead.
    """
    alone = studied(scene, name)
    if alone.groups:
        return Length(scene, holds_of(scene, duration))
    most = holds_of(scene, duration) if duration is not None else _LONGEST
    if duration is None and scene.run.duration is not None:
        most = min(_LONGEST, round(scene.run.duration / scene.bus.sample_time))
    (own,), remark = alone.axes, ""
    begins = _contacts(own, scene, most)
    if not begins and own.passivity.name != _JUDGED_WITH:
        [axis] = under(alone, _JUDGED_WITH).permitted().axes
        plain = replace(scene, axes=tuple(axis if of is own else of for of in scene.axes))
        begins = _contacts(axis, plain, most)
        if begins:
            scene, remark = plain, f"this loop gives no torque; judged with {_JUDGED_WITH}"
    if duration is not None:
        return Length(scene, most, remark)
    last = begins[1] + _AFTER if len(begins) > 1 else (begins[0] if begins else 0) + HOLDS
    return Length(scene, min(most, last), remark)


def _contacts(axis: AxisScene, scene: Scene, holds: int) -> list[int]:
    """Return the sample times at which the torque of an axis begins."""
    torques = torque_history(axis, scene, holds, simulation_of(axis).accuracy)
    return [k for k, torque in enumerate(torques) if torque and not (k and torques[k - 1])]


def require_own_axis(axis: AxisScene, scene: Scene) -> None:
    """Refuse an axis without its own plant and its own controller.

    Raises:
        InputError: The axis belongs to a group, or moves a mechanism together with others.
    """
    what = f"group {axis.group} renders on it" if axis.group else ""
    if what or axis.simulated_drive is not None:
        what = what or "it moves a mechanism with other drives"
        raise InputError(
            f"{scene.source}: axis {axis.parameters.name}: {what}, expected an axis with its own plant and "
            "algorithm; to run the scene, give accuracy: {event_bits, substeps} instead of auto"
        )


@dataclass
class PortStudy:
    """Runs the loop of a port with one thing changed at a time, and compares it with a motion that is exact.

    Args:
        scene: Simulated scene.
        axis: Name of an axis or a group; the first axis by default, or its group.
        duration: Length of the comparison [s]; by default 1000 sample times, or the scene's if that is shorter; see
            `length_of`.
        progress: Called with the number of units done, of `UNITS`.
        stop: Polled often; true stops the study.

    Raises:
        InputError: No axis or group has this name, or it is not simulated.
    """

    scene: Scene
    axis: str | None = None
    _: KW_ONLY
    duration: float | None = None
    progress: Callable[[int], None] | None = None
    stop: Stop = lambda: False

    def __post_init__(self) -> None:
        self.alone, self.holds = studied(self.scene, self.axis), holds_of(self.scene, self.duration)
        self._rows: list[Row] = []
        self._status, self._done = "stopped", 0

    def run(self) -> Row:
        """Return the result; `status` is "completed", or "stopped" with all results so far."""
        try:
            self._measure()
            self._status = "completed"
        except InputError:
            if not self.stop():
                raise
        return self.result()

    def result(self) -> Row:
        """Return all results so far, as plain values."""
        raise NotImplementedError

    def _measure(self) -> None:
        raise NotImplementedError

    def _check(self) -> None:
        if self.stop():
            raise InputError("stopped")

    def _reach(self, share: float) -> None:
        """Report the completed fraction, unless more was reported before."""
        self._done = max(self._done, min(UNITS, round(UNITS * share)))
        if self.progress is not None:
            self.progress(self._done)
