"""Torques of the scene's own controller on a simulated plant, without a bus: the input for judging a plant."""

from dataclasses import replace
from typing import Final

from canhaptic.errors import InputError
from canhaptic.scene.models import AxisScene, AxisSimulation, Scene
from canhaptic.scene.parts import build_axis_controller, build_plant
from canhaptic.sim.plant.accuracy_parameters import AccuracyParameters
from canhaptic.sim.plant.direct_rig import DirectRig

_FINE: Final = AccuracyParameters(substeps=16)


def torque_history(axis: AxisScene, scene: Scene, holds: int, accuracy: AccuracyParameters = _FINE) -> list[float]:
    """Return the torque of each hold [N or N*m] of the scene's own controller on a simulated plant, without a bus.

    Args:
        axis: Simulated axis.
        scene: Scene of the axis, for rate, delay and quantisation.
        holds: Number of holds.
        accuracy: Accuracy of the plant; fine by default.
    """
    simulation, period = simulation_of(axis), scene.bus.sample_time_ns
    plant = build_plant(replace(simulation, accuracy=accuracy), period)
    given, quantum = axis.parameters, axis.loop.torque_quantum or None
    step = build_axis_controller(axis).step
    rig = DirectRig(plant, step, period, scene.bus.delay, given.counts_per_unit, quantum, given.torque_limit)
    held: list[float] = rig.run(holds + 1).torque_applied[1:].tolist()
    return held


def declared_order(simulation: AxisSimulation) -> int | None:
    """Return the least order in the substep that an effect or an own hand declares; None where all are exact."""
    parts = (*(effect.parameters for effect in simulation.effects), simulation.user)
    orders = [getattr(part, "order", None) for part in parts]
    return min((order for order in orders if order is not None), default=None)


def simulation_of(axis: AxisScene) -> AxisSimulation:
    """Return the simulation of an axis.

    Raises:
        InputError: It has none.
    """
    if axis.simulation is None:
        raise InputError(f"{axis.parameters.name}: is not simulated, expected a plant and a user; add `simulation`")
    return axis.simulation
