"""What the simulated plant of a run costs and errs by, found in a moment after the run: for the line that it prints.

The scene's own controller drives a fresh plant without a bus, over the first periods of the run. The plant is timed
there, and run again coarser; the declared order, and for events the bracket that halves with every bit, turn the
difference into an error. An estimate, without a reference: `canhaptic accuracy` has one.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np

from canhaptic.drive.clock import WallClock
from canhaptic.errors import CanHapticError
from canhaptic.scene.accuracy_choice import observed, simulation_of, torque_history
from canhaptic.scene.models import AxisScene, AxisSimulation, Scene
from canhaptic.scene.parts import build_plant
from canhaptic.sim.plant.plant import AccuracyParameters, Plant

_PRODUCTS: Final = 12_000
"""Of the plant that is timed: about 50 ms."""
_FEWEST, _MOST = 50, 1000  # periods
_BITS_COARSER: Final = 6
_NS_PER_US: Final = 1e3


class PlantPrice(NamedTuple):
    """Of one axis."""

    unit: str
    microseconds: float  # per period, of the plant alone
    error: float | None  # of the position [m or rad]; None: exact, to rounding
    periods: int  # that it was found over


def plant_prices(scene: Scene, plants: Sequence[Plant], periods: int) -> list[PlantPrice]:
    """Returns price and estimated error of each simulated plant; none where nothing ran.

    Args:
        scene: What was run.
        plants: The plants of its axes after the run.
        periods: Sample times that they were moved by.
    """
    own = all(axis.simulation is not None and not axis.group for axis in scene.axes)
    if not periods or not scene.simulated or not own or len(plants) != len(scene.axes):
        return []
    try:
        return [_price(axis, scene, plant, periods) for axis, plant in zip(scene.axes, plants, strict=True)]
    except CanHapticError:  # the loop cannot run without what ended the run over the bus, either
        return []


def _price(axis: AxisScene, scene: Scene, plant: Plant, periods: int) -> PlantPrice:
    simulation, period = simulation_of(axis), scene.bus.sample_time_ns
    each = max(1.0, plant.products / periods)
    holds = min(periods, max(_FEWEST, min(_MOST, round(_PRODUCTS / each))))
    torques = torque_history(axis, scene, holds, simulation.accuracy)
    timed = build_plant(simulation, period)
    _step(timed, torques)  # its modes are compiled at the first time
    timed.reset()
    clock = WallClock()
    begin = clock.now()
    _step(timed, torques)
    spent = clock.now() - begin
    error = estimated_error(simulation, torques, period)
    return PlantPrice(axis.parameters.unit, spent / holds / _NS_PER_US, error, holds)


def estimated_error(simulation: AxisSimulation, torques: Sequence[float], sample_time_ns: int) -> float | None:
    """Returns the estimated largest error of the position at any SYNC [m or rad]; None where the plant is exact.

    Args:
        simulation: With the accuracy to be judged.
        torques: Of each hold [N or N*m].
        sample_time_ns: Of a hold [ns].
    """
    plant, accuracy = build_plant(replace(simulation, compiled=False), sample_time_ns), simulation.accuracy
    switches = any(part.has_guards for part in plant.scene.parts)
    if plant.is_exact and not switches:
        return None
    position = observed(plant, torques).position

    def apart(other: AccuracyParameters) -> float:
        changed = build_plant(replace(simulation, accuracy=other, compiled=False), sample_time_ns)
        return float(np.abs(observed(changed, torques).position - position).max())

    error = 0.0
    if switches:
        less = max(1, accuracy.event_bits - _BITS_COARSER)
        more = accuracy.event_bits + _BITS_COARSER if accuracy.event_bits == less else less
        factor = 2.0 ** abs(accuracy.event_bits - more)
        coarse = apart(accuracy.model_copy(update={"event_bits": more}))
        error += coarse / (factor - 1.0) if more < accuracy.event_bits else coarse * factor / (factor - 1.0)
    if not plant.is_exact:
        factor = 2.0 ** (1 if switches else _order(simulation))
        if accuracy.substeps > 1:
            error += apart(accuracy.model_copy(update={"substeps": accuracy.substeps // 2})) / (factor - 1.0)
        else:
            error += apart(accuracy.model_copy(update={"substeps": 2})) * factor / (factor - 1.0)
    return error


def _order(simulation: AxisSimulation) -> int:
    """Returns the least order that an effect of the scene declares."""
    orders = [getattr(effect.parameters, "order", None) for effect in simulation.effects]
    return min((order for order in orders if order is not None), default=1)


def _step(plant: Plant, torques: Sequence[float]) -> None:
    plant.begin(0)
    now, period, move = 0, plant.sample_time_ns, plant.advance_to
    for torque in torques:
        now += period
        move(now, torque)
