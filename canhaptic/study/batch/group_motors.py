"""Motors of a group that move by one flow: plants of their own side by side, or a stage, as one matrix."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from canhaptic.scene.accuracy_choice import simulation_of
from canhaptic.scene.models import AxisScene, Scene
from canhaptic.scene.parts import build_mechanism, build_plant
from canhaptic.sim.plant.mechanism.xy_stage import XYMotion
from canhaptic.sim.plant.plant import Plant
from canhaptic.sim.plant.propagator import Array
from canhaptic.study.batch.event_plants import PlantValues
from canhaptic.study.batch.group_closed_loop import LinearMotors
from canhaptic.study.batch.group_events import EventMotorsPlan, why_not_events
from canhaptic.study.batch.plants import is_linear
from canhaptic.study.batch.signal_effects import SIGNAL_EFFECTS
from canhaptic.study.scenes import mechanism_of_group


def linear_motors(scene: Scene, axes: Sequence[AxisScene]) -> LinearMotors | None:
    """Returns the motors of a group at their start; None where they do not move by one flow.

    Args:
        scene: Of the group alone.
        axes: Of the group.

    Raises:
        InputError: The motors of the group are not simulated, or move with others.
    """
    of = mechanism_of_group(scene)
    if of is not None:
        moving: Any = build_mechanism(of, scene.bus.sample_time_ns)
        if not isinstance(moving, XYMotion) or not moving.is_linear:
            return None
        return _stage(moving, [of.axes.index(axis.parameters.name) for axis in axes])
    simulations = [simulation_of(axis) for axis in axes]
    effects = [effect.name for simulation in simulations for effect in simulation.effects]
    if not all(is_linear(simulation) for simulation in simulations) or not set(effects).isdisjoint(SIGNAL_EFFECTS):
        return None
    return _side_by_side([build_plant(simulation, scene.bus.sample_time_ns) for simulation in simulations])


def event_motors(scene: Scene, axes: Sequence[AxisScene]) -> EventMotorsPlan | str:
    """Returns the motors of a group whose plants have events; the reason by name where they cannot move in its loop.

    Args:
        scene: Of the group alone.
        axes: Of the group.

    Raises:
        InputError: The motors of the group are not simulated, or move with others.
    """
    of, names = mechanism_of_group(scene), [axis.parameters.name for axis in axes]
    if of is not None:
        moving: Any = build_mechanism(of, scene.bus.sample_time_ns)
        if not isinstance(moving, XYMotion):
            return f"a {of.mechanism.name} moves by equations that are solved at every hold"
        order = [of.axes.index(name) for name in names]
        reason = why_not_events(moving.model())
        places = [[part[at] for at in order] for part in (moving.force_places, moving.position_places)]
        return reason or EventMotorsPlan([moving.model], [None], [0] * len(axes), *places)
    values = [PlantValues(simulation_of(axis), scene.bus.sample_time_ns) for axis in axes]
    every = [why_not_events(one.scene()) for one in values]
    forces = [len(one.scene().names) - 2 for one in values]
    plan = EventMotorsPlan(
        [one.scene for one in values], [one.simulation.accuracy for one in values], list(range(len(axes))), forces,
        [0] * len(axes),
    )  # fmt: skip
    return next(filter(None, every), "") or plan


def _side_by_side(plants: Sequence[Plant]) -> LinearMotors:
    """Returns plants of states [position, ..., torque, 1] each as one."""
    flows, starts = [plant.whole_flow() for plant in plants], [plant.initial_state() for plant in plants]
    sizes = [len(start) - 2 for start in starts]
    places = [sum(sizes[:i]) for i in range(len(sizes))]
    states, motors = sum(sizes), len(plants)
    whole, state = np.zeros((states, states + motors + 1)), np.zeros(states + motors + 1)
    for i, (flow, start, place, size) in enumerate(zip(flows, starts, places, sizes, strict=True)):
        rows = slice(place, place + size)
        whole[rows, rows], whole[rows, states + i], whole[rows, -1] = (
            flow[:size, :size],
            flow[:size, -2],
            flow[:size, -1],
        )
        state[rows] = start[:size]
    return _listed(whole, state, places)


def _stage(stage: XYMotion, order: Sequence[int]) -> LinearMotors:
    """Returns a stage, whose forces are states that do not change.

    Args:
        stage: Without dry friction.
        order: Places of the motors of the group among those of the stage.
    """
    flow, start = stage.whole_flow(), stage.state
    forces = [stage.force_places[at] for at in order]
    rest = [i for i in range(len(start) - 1) if i not in forces]
    columns = [*rest, *forces, len(start) - 1]
    return _listed(flow[np.ix_(rest, columns)], start[columns], [rest.index(stage.position_places[at]) for at in order])


def _listed(flow: Array, state: Array, places: Sequence[int]) -> LinearMotors:
    state[-1] = 1.0
    return LinearMotors(flow.tolist(), state.tolist(), [0.0] * len(flow), list(places))
