"""`accuracy: auto`: the cheapest accuracy of a simulated plant that keeps its position within a tolerance.

The scene's own controller is run once on a finely solved plant; under the torques of that run every setting of the
ladder is compared with the reference plant by event-located DOP853 (`canhaptic.lab.judge`). The fewest products win,
which are equal on every machine; no time is measured.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from canhaptic.errors import InputError
from canhaptic.lab.judge.reference_model import MotionError, difference
from canhaptic.lab.judge.solvers import reference
from canhaptic.lab.reference import textbook_model
from canhaptic.scene.far_side import build_plant
from canhaptic.scene.method import declared_order, simulation_of, torque_history
from canhaptic.scene.models import AxisScene, AxisSimulation, Scene
from canhaptic.sim.plant.accuracy_parameters import AccuracyParameters
from canhaptic.sim.plant.direct_rig import Motion, observed

HOLDS: Final = 1000
"""Holds that settings are compared over; a scene that lasts shorter is compared over all of it."""
_BITS: Final = (4, 8, 12, 16, 20, 24)
_FEW_BITS: Final = (8, 16, 24)
"""Where substeps are to be chosen too."""
_SUBSTEPS: Final = (1, 2, 4, 8, 16, 32)
FLOOR: Final = 2e-13
"""Fraction of the travel below which errors count as equal: they come from the reference, or rounding."""
LEAST_ORDER: Final = 0.5
"""Part of the declared order: where the errors of a scene fall by less, no setting of it is advised or chosen."""
_CEILING: Final = 3e-2
"""Part of the travel above which errors do not yet show an order."""


@dataclass(frozen=True, slots=True)
class Setting:
    """One setting of the ladder with its result."""

    accuracy: AccuracyParameters
    error: MotionError
    products: int


@dataclass(frozen=True, slots=True)
class AccuracyChoice:
    """The choice of `accuracy: auto` for one axis, and its grounds."""

    tolerance: float  # [m or rad]
    holds: int
    setting: Setting

    def as_plain(self) -> dict[str, object]:
        """Return the choice as stored in the resolved configuration and the log."""
        error = self.setting.error
        return {
            "tolerance": self.tolerance,
            "holds": self.holds,
            "position_error": error.position,
            "force_error": error.force,
            "energy_error": error.energy,
            "products_per_period": self.setting.products / self.holds,
        }


def with_chosen_accuracy(scene: Scene) -> Scene:
    """Return the scene with the accuracy of every simulated plant chosen; the scene itself where it is not `auto`.

    Raises:
        InputError: scipy is missing, or no setting keeps the tolerance.
    """
    if scene.accuracy_tolerance is None or scene.accuracy_choices or scene.simulation is None:
        return scene
    axes, choices = [], {}
    for axis in scene.axes:
        require_own_axis(axis, scene)
        choice, simulation = choose(axis, scene, scene.accuracy_tolerance), simulation_of(axis)
        axes.append(replace(axis, simulation=replace(simulation, accuracy=choice.setting.accuracy)))
        choices[axis.parameters.name] = choice.as_plain()
    return replace(scene, axes=tuple(axes), accuracy_choices=choices)


def choose(axis: AxisScene, scene: Scene, tolerance: float) -> AccuracyChoice:
    """Return the cheapest accuracy of one axis with an error of the position within a tolerance [m or rad].

    Raises:
        InputError: scipy is missing, no setting keeps the tolerance, or the errors do not fall as declared.
    """
    torques = torque_history(axis, scene, holds_of(scene))
    simulation, period = simulation_of(axis), scene.bus.sample_time_ns
    exact = reference(textbook_model(simulation), torques, period)
    tried = [_tried_setting(simulation, period, accuracy, torques, exact) for accuracy in ladder(simulation, period)]
    chosen = cheapest(tried, tolerance)
    _require_order(tried, simulation, max(float(np.ptp(exact.position)), 1e-12), f"{scene.source}: accuracy: auto of "
                   f"axis {axis.parameters.name}")  # fmt: skip
    if chosen is None:
        best = tried[-1]
        raise InputError(
            f"{scene.source}: accuracy: auto of axis {axis.parameters.name} with tolerance {tolerance:g}: the finest "
            f"setting errs by {best.error.position:.2g} in position; allow at least that, or a higher rate"
        )
    return AccuracyChoice(tolerance, len(torques), chosen)


def cheapest(tried: Sequence[Setting], tolerance: float) -> Setting | None:
    """Return the setting with the fewest products that keeps the tolerance, together with every finer one.

    Errors of events and of substeps may cancel by chance, which need not last beyond the compared holds.
    """
    good = [setting for setting in tried if setting.error.is_finite and setting.error.position <= tolerance]
    kept = {(setting.accuracy.event_bits, setting.accuracy.substeps) for setting in good}
    every = {(setting.accuracy.event_bits, setting.accuracy.substeps) for setting in tried}

    def lasts(bits: int, substeps: int) -> bool:
        return all((b, s) in kept for b, s in every if b >= bits and s >= substeps)

    good = [setting for setting in good if lasts(setting.accuracy.event_bits, setting.accuracy.substeps)]
    return min(good, key=lambda setting: (setting.products, setting.error.position), default=None)


def fitted_order(sizes: Sequence[float], errors: Sequence[float], travel: float) -> float | None:
    """Return the slope of log error over log size between the coarsest and the finest significant error.

    Args:
        sizes: Sizes of the steps, relative.
        errors: Errors of the position [m or rad].
        travel: Travel of the reference [m or rad].
    """
    points = [
        (math.log(size), math.log(error))
        for size, error in zip(sizes, errors, strict=True)
        if FLOOR * travel < error < _CEILING * travel
    ]
    if len(points) < 2:
        return None
    count = len(points)
    x, y = sum(p[0] for p in points) / count, sum(p[1] for p in points) / count
    spread = sum((p[0] - x) ** 2 for p in points)
    return sum((p[0] - x) * (p[1] - y) for p in points) / spread if spread else None


def _require_order(tried: Sequence[Setting], simulation: AxisSimulation, travel: float, where: str) -> None:
    """Refuse errors that do not fall as declared: one of them may keep a tolerance by luck.

    Raises:
        InputError: They do not.
    """
    declared = declared_order(simulation)
    own = [setting for setting in tried if setting.accuracy.event_bits == max(s.accuracy.event_bits for s in tried)]
    fitted = fitted_order([1.0 / s.accuracy.substeps for s in own], [s.error.position for s in own], travel)
    if declared is None or fitted is None or fitted >= LEAST_ORDER * declared:
        return
    raise InputError(
        f"{where}: the error falls with an order of {fitted:.2g} in the substep, expected at least half of the "
        f"declared {declared}: no setting can be chosen; raise the rate, or give accuracy: {{substeps}} yourself"
    )


def ladder(simulation: AxisSimulation, sample_time_ns: int) -> list[AccuracyParameters]:
    """Return every setting that makes a difference for this plant, coarse to fine."""
    plant = build_plant(simulation, sample_time_ns)
    most = simulation.accuracy.max_events
    bits: Sequence[int] = (24,)
    if any(part.has_guards for part in plant.scene.parts):
        bits = _BITS if plant.is_exact else _FEW_BITS
    substeps = (1,) if plant.is_exact else _SUBSTEPS
    return [AccuracyParameters(event_bits=b, substeps=s, max_events=most) for s in substeps for b in bits]


def _tried_setting(
    simulation: AxisSimulation,
    sample_time_ns: int,
    accuracy: AccuracyParameters,
    torques: Sequence[float],
    exact: Motion,
) -> Setting:
    """Return the error and the cost of one setting under the torques."""
    plant = build_plant(replace(simulation, accuracy=accuracy), sample_time_ns)
    motion = observed(plant, torques)
    error = difference(motion, exact, simulation.plant.mass, sample_time_ns * 1e-9)
    return Setting(accuracy, error, plant.products)


def holds_of(scene: Scene, duration: float | None = None) -> int:
    """Return the number of holds over which a scene is compared."""
    if duration is not None:
        return max(2, round(duration / scene.bus.sample_time))
    whole = HOLDS if scene.run.duration is None else round(scene.run.duration / scene.bus.sample_time)
    return max(2, min(HOLDS, whole))


def require_own_axis(axis: AxisScene, scene: Scene) -> None:
    """Refuse an axis that does not move as one plant under one controller.

    Raises:
        InputError: A group renders on it, or it moves a mechanism with others.
    """
    if axis.group or axis.simulated_drive is not None:
        what = f"group {axis.group} renders on it" if axis.group else "it moves a mechanism with other drives"
        raise InputError(
            f"{scene.source}: axis {axis.parameters.name}: {what}, expected an axis with a plant and an algorithm "
            "of its own for a study or choice of accuracy; give accuracy: {event_bits, substeps} instead of auto"
        )
