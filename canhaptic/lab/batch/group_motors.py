"""Models of the motors of a group for its loop: one flow, the stepper, or a five-bar."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from canhaptic.lab.batch.event_plants import PlantValues
from canhaptic.lab.batch.group_closed_loop import LinearMotors
from canhaptic.lab.batch.group_events import EventMotorsPlan, why_not_events
from canhaptic.lab.batch.group_five_bar import FiveBarPlan
from canhaptic.lab.batch.plants import is_linear, why_not_in_loop
from canhaptic.lab.loop.scenes import mechanism_of_group
from canhaptic.scene.models import AxisScene, MechanismScene, Scene
from canhaptic.scene.parts import build_mechanism, build_plant
from canhaptic.scene.torque_history import simulation_of
from canhaptic.sim.plant.mechanism.five_bar_linkage import FiveBarMotion
from canhaptic.sim.plant.mechanism.xy_stage import XYMotion
from canhaptic.sim.plant.plant import Plant
from canhaptic.sim.plant.propagator import Array


def motors_in_loop(scene: Scene, axes: Sequence[AxisScene]) -> LinearMotors | EventMotorsPlan | FiveBarPlan | str:
    """Return the motors of a group at their start; the reason by name where they cannot move in its loop.

    Args:
        scene: Scene with the group alone.
        axes: Axes of the group.

    Raises:
        InputError: The motors of the group are not simulated, or move with others.
    """
    of = mechanism_of_group(scene)
    if of is not None:
        return _of_mechanism(of, [of.axes.index(axis.parameters.name) for axis in axes], scene.bus.sample_time_ns)
    simulations = [simulation_of(axis) for axis in axes]
    reason = next(filter(None, map(why_not_in_loop, simulations)), "")
    if reason:
        return reason
    if all(map(is_linear, simulations)):
        return _side_by_side([build_plant(simulation, scene.bus.sample_time_ns) for simulation in simulations])
    values = [PlantValues(simulation, scene.bus.sample_time_ns) for simulation in simulations]
    forces = [len(one.scene().names) - 2 for one in values]
    return next(filter(None, (why_not_events(one.scene()) for one in values)), "") or EventMotorsPlan(
        [one.scene for one in values], [one.simulation.accuracy for one in values], list(range(len(axes))), forces,
        [0] * len(axes),
    )  # fmt: skip


def _of_mechanism(
    of: MechanismScene, order: Sequence[int], sample_time_ns: int
) -> LinearMotors | EventMotorsPlan | FiveBarPlan | str:
    """Model of a mechanism in the loop.

    Args:
        of: The mechanism.
        order: Places of the group's motors among the mechanism's.
        sample_time_ns: T [ns].
    """
    moving: Any = build_mechanism(of, sample_time_ns)
    if isinstance(moving, FiveBarMotion):
        return FiveBarPlan(moving, order.index(0), order.index(1))
    if not isinstance(moving, XYMotion):
        return f"the mechanism {of.mechanism.name} is own code"
    if moving.is_linear:
        return _stage(moving, order)
    places = [[part[at] for at in order] for part in (moving.force_places, moving.position_places)]
    return why_not_events(moving.model()) or EventMotorsPlan([moving.model], [None], [0] * len(order), *places)


def _side_by_side(plants: Sequence[Plant]) -> LinearMotors:
    """Return plants of states [position, ..., torque, 1] each as one."""
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
    """Return a stage, whose forces are states that do not change.

    Args:
        stage: Stage without dry friction.
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
