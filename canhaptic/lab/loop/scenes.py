"""Parts of a scene for a study: the loop of an axis without a bus, and the plant without a controller."""

from dataclasses import replace
from typing import Final, cast

from canhaptic.control.environments.environment import Environment
from canhaptic.drive.axis_parameters import BusParameters
from canhaptic.errors import InputError
from canhaptic.lab.loop.axis_loop import LoopCase
from canhaptic.scene.display_checks import refuse_displays
from canhaptic.scene.models import AxisScene, AxisSimulation, GroupScene, MechanismScene, Scene
from canhaptic.scene.parts import build_plant
from canhaptic.scene.torque_history import simulation_of
from canhaptic.sim.plant.effects import Effect
from canhaptic.sim.plant.plant import PlantParameters
from canhaptic.sim.plant.user import UserParameters

_DEFAULT_DURATION: Final = 5.0
"""Duration of scenes that name none [s]."""
_PER_MILLE: Final = 1e-3


def cycles_of(scene: Scene, duration: float | None) -> int:
    """SYNCs of a run of a duration [s], at least 2; for None the duration of the scene."""
    return max(2, round((duration or scene.run.duration or _DEFAULT_DURATION) / scene.bus.sample_time))


def require_design_room(margin: float, tolerance: float) -> None:
    """Refuse a margin or a tolerance of a design that is out of range.

    Raises:
        InputError: One is.
    """
    if not 0.0 <= margin <= 10.0 or not 0.0 < tolerance < 1.0:
        raise InputError(
            f"got margin {margin:g} and tolerance {tolerance:g}, expected 0 <= margin <= 10, 0 < tolerance < 1"
        )


def require_single_axes(scene: Scene, command: str, axis: str | None = None) -> None:
    """Refuse axes that a group of the scene moves together.

    Args:
        scene: Scene of the study.
        command: Command of the study, for the message.
        axis: The only axis studied; None for all.

    Raises:
        InputError: A group renders on one of them, or one is an admittance display.
    """
    refuse_displays(scene, command)
    for group in scene.groups:
        if axis is None or axis in group.axes:
            raise InputError(
                f"{scene.source}: group {group.name!r} renders on the axes {', '.join(group.axes)} together, expected "
                f"axes that render by themselves: {command} judges one axis at a time; `canhaptic run` and "
                "`canhaptic inspect` give the account of a group"
            )


def parts_of(scene: Scene) -> dict[str, Scene]:
    """Independently rendering parts, axes or groups, by name, each as a scene alone."""
    alone = {
        axis.parameters.name: replace(scene, axes=(axis,), groups=(), mechanisms=())
        for axis in scene.axes
        if not axis.group
    }
    return alone | {group.name: _of_group(scene, group) for group in scene.groups}


def _of_group(scene: Scene, group: GroupScene) -> Scene:
    axes = tuple(axis for axis in scene.axes if axis.group == group.name)
    moved = tuple(of for of in scene.mechanisms if not set(of.axes).isdisjoint(group.axes))
    return replace(scene, axes=axes, groups=(group,), mechanisms=moved)


def mechanism_of_group(scene: Scene) -> MechanismScene | None:
    """Return the mechanism that the one group of a scene moves; None where each of its axes has a plant of its own.

    Raises:
        InputError: Its motors move with others.
    """
    (group,) = scene.groups
    if not scene.mechanisms:
        return None
    (of, *others) = scene.mechanisms
    if others or set(of.axes) != set(group.axes):
        raise InputError(
            f"{scene.source}: group {group.name!r} moves the axes {', '.join(group.axes)}, its mechanism "
            f"{', '.join(of.axes)}; expected the same axes: use canhaptic run, which moves all of them"
        )
    return of


def at_rate(scene: Scene, rate: float) -> Scene:
    """The scene at another rate [Hz], without a check of the bus load.

    Nor is the torque's arrival time checked: it acts in the first half of its hold at the latest.

    Raises:
        ParameterError: The rate is out of range.
    """
    bus = BusParameters(**{**scene.bus.model_dump(), "rate": rate})
    return replace(scene, bus=bus, axes=tuple(axis_at(axis, bus.sample_time) for axis in scene.axes))


def axis_at(axis: AxisScene, sample_time: float) -> AxisScene:
    """Return an axis at another sample time [s]; its torques act in the first half of a hold at the latest."""
    window = axis.loop.torque_window and min(axis.loop.torque_window, 0.5 * sample_time)
    return replace(axis, loop=axis.loop.model_copy(update={"sample_time": sample_time, "torque_window": window}))


def environment_of(axis: AxisScene) -> Environment:
    """Return the environment of an axis; every class of `ENVIRONMENTS` is one.

    Raises:
        InputError: A group renders on it.
    """
    if axis.group:
        raise InputError(
            f"{axis.parameters.name}: group {axis.group!r} renders on this axis, expected one that renders by itself"
        )
    return cast(Environment, axis.environment.parameters)


def plant_parts(axis: AxisScene) -> tuple[PlantParameters, UserParameters | None, list[Effect], int]:
    """Return moving mass, hand, effects and seed of an axis.

    Raises:
        InputError: The axis is not simulated.
    """
    simulation = simulation_of(axis)
    effects = [cast(Effect, effect.parameters) for effect in simulation.effects]
    return simulation.plant, simulation.user, effects, simulation.seed


def loop_case(axis: AxisScene, scene: Scene) -> LoopCase:
    """Return an axis as a loop without a bus, with the quantisation, delay and torque limit of its scene."""
    simulation, sample_time_ns = simulation_of(axis), scene.bus.sample_time_ns
    rated = axis.parameters.rated_torque
    return LoopCase(
        environment=environment_of(axis),
        algorithm=axis.passivity.name,
        own=axis.passivity.own,
        parameters=axis.passivity.parameters,
        loop=axis.loop,
        make_plant=lambda: build_plant(simulation, sample_time_ns),
        simulation=simulation,
        sample_time_ns=sample_time_ns,
        delay=scene.bus.delay,
        counts_per_unit=axis.parameters.counts_per_unit,
        torque_quantum=None if rated is None else rated * _PER_MILLE,
        torque_limit=axis.parameters.torque_limit,
        device_damping=_device_damping(axis),
        device_friction=sum(float(getattr(effect.parameters, "kinetic", 0.0)) for effect in simulation.effects),
    )


def _device_damping(axis: AxisScene) -> float:
    """Declared damping of the device, else that of the simulated plant."""
    if axis.loop.device_damping is not None:
        return axis.loop.device_damping
    if axis.simulation is None:
        return 0.0
    return axis.simulation.plant.damping + viscous_friction(axis.simulation)


def viscous_friction(simulation: AxisSimulation) -> float:
    """Return the damping that effects add to that of the plant [N*s/m or N*m*s/rad]."""
    viscous = (effect.parameters for effect in simulation.effects if effect.name == "viscous_friction")
    return sum((float(getattr(effect, "damping", 0.0)) for effect in viscous), 0.0)
