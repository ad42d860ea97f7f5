"""Both sides of admittance displays: force in, velocity out; one axis, or two axes with one account as a plane."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Final

from canhaptic.control.admittance.display_environment import DisplayEnvironment
from canhaptic.control.admittance.group_environment import GroupMass, PathMass
from canhaptic.control.admittance.loop_parameters import GuardedDisplayParameters
from canhaptic.errors import InputError
from canhaptic.lab.loop.algorithms import display_group_under, display_under
from canhaptic.lab.touch.touch_scene import (
    GUARDED,
    PLAIN,
    Side,
    TouchScene,
    on_two_buses,
    pointer_hand,
    reach,
    sliders_of,
)
from canhaptic.scene.components import ComponentSpec
from canhaptic.scene.models import AxisScene, Scene
from canhaptic.scene.torque_history import simulation_of
from canhaptic.sim.plant.user import UserParameters

_OVER: Final = 1.05
"""What is declared of a simulated drive over its true values, where the scene declares nothing."""
_SLIDERS: Final = ("mass", "cup", "damping")


def display_line(scene: Scene, axis: AxisScene) -> TouchScene:
    """Return an admittance display twice: unprotected, and under its own algorithm."""
    plain = display_under(axis, PLAIN)
    guarded = axis if axis.passivity.name != PLAIN else replace(axis, passivity=_guard_of(axis))
    sides = (Side(PLAIN, (PLAIN,)), _side(guarded.passivity, (guarded.passivity.name,)))
    axes = [_held(one, side, side.axes[0]) for one, side in zip((plain, guarded), sides, strict=True)]
    user, start = _hand_of(axis)
    shown = reach(user.motion, user.rest, start)
    environment: Any = axis.environment.parameters
    return TouchScene(
        on_two_buses(scene, axes, sides), sides, axis.parameters.unit, (shown,), (start,),
        _walls(environment, shown), sliders_of("environment", environment, _SLIDERS, axis.parameters.unit),
        is_display=True,
    )  # fmt: skip


def display_plane(scene: Scene, name: str) -> TouchScene:
    """Return two admittance displays with one account twice.

    Raises:
        InputError: The group has another number of axes, or moves them through a mechanism.
    """
    index, group = next((i, one) for i, one in enumerate(scene.groups) if one.name == name)
    if len(group.axes) != 2 or group.kinematics.name != "identity":
        raise InputError(
            f"{scene.source}: group {name!r} has {len(group.axes)} axes and kinematics {group.kinematics.name}; touch "
            "shows an axis by itself, or two axes with kinematics: identity as a plane"
        )
    members = [scene.axis(axis) for axis in group.axes]
    guarded = group if group.passivity.name != PLAIN else replace(group, passivity=_guard_of(*members))
    both = (display_group_under(group, PLAIN), guarded)
    sides = tuple(
        _side(one.passivity, tuple(f"{one.passivity.name} {axis}" for axis in group.axes), one.passivity.name)
        for one in both
    )
    axes = [
        _held(axis, side, port)
        for side in sides
        for axis, port in zip(members, side.axes, strict=True)
    ]  # fmt: skip
    groups = tuple(replace(one, name=side.group, axes=side.axes) for one, side in zip(both, sides, strict=True))
    hands = [_hand_of(axis) for axis in members]
    network: Any = group.network.parameters
    shown = tuple(reach(user.motion, user.rest, start) for user, start in hands)
    pair = (sides[0], sides[1])
    return TouchScene(
        on_two_buses(scene, axes, pair, groups), pair, members[0].parameters.unit, shown,
        tuple(start for _, start in hands), _box(network),
        sliders_of(f"groups.{index}.network", network, _SLIDERS, members[0].parameters.unit),
        path=_path(network), is_display=True,
    )  # fmt: skip


def _side(passivity: ComponentSpec, axes: tuple[str, ...], group: str = "") -> Side:
    allowance = float(getattr(passivity.parameters, "energy_allowance", 0.0))
    return Side(passivity.name, axes, group, allowance)


def _held(axis: AxisScene, side: Side, port: str) -> AxisScene:
    """Return an axis of one side, held by the pointer.

    A simulated sensor without noise shows one count while the pointer rests: the check for a frozen sensor is off here.
    """
    display = axis.parameters.admittance
    if display is not None:
        force = display.force.model_copy(update={"frozen_after": None})
        display = display.model_copy(update={"force": force})
    changes = {"name": port, "energy_loss_limit": "none", "admittance": display}
    return replace(
        axis,
        parameters=axis.parameters.model_copy(update=changes),
        bus=side.name,
        group=side.group,
        simulation=replace(simulation_of(axis), user=pointer_hand(*_hand_of(axis))),
    )


def _hand_of(axis: AxisScene) -> tuple[UserParameters, float]:
    """Return the hand of a scene, and where the handle is at the start [m or rad]."""
    simulation = simulation_of(axis)
    return simulation.user or UserParameters(), simulation.plant.initial_position


def _guard_of(*axes: AxisScene) -> ComponentSpec:
    """`guarded` with the simulated drives' properties, for a scene that is unprotected."""
    masses, gains, integrals = [0.0], [0.0], [0.0]
    for axis in axes:
        simulation = simulation_of(axis)
        masses.append(simulation.plant.mass)
        if simulation.admittance is not None:
            gains.append(simulation.admittance.loop.gain)
            integrals.append(simulation.admittance.loop.integral_gain)
    known = GuardedDisplayParameters(
        drive_mass=_OVER * max(masses), loop_gain=_OVER * max(gains), integral_gain=_OVER * max(integrals),
        energy_allowance=1e-3,
    )  # fmt: skip
    return ComponentSpec(GUARDED, known)


def _walls(environment: DisplayEnvironment, shown: tuple[float, float]) -> tuple[tuple[float, float], ...]:
    """Walls on the page [m or rad]."""
    spans = ((shown[0], environment.lower_wall), (environment.upper_wall, shown[1]))
    return tuple((low, high) for low, high in spans if low < high)


def _box(network: GroupMass) -> tuple[tuple[float, float], ...]:
    """Return where each direction is between its walls [m or rad]; nothing without walls."""
    if not network.lower and not network.upper:
        return ()
    far = (-1e3, -1e3), (1e3, 1e3)
    return tuple(zip(network.lower or far[0], network.upper or far[1], strict=True))


def _path(network: GroupMass) -> tuple[tuple[float, ...], ...]:
    if not isinstance(network, PathMass):
        return ()
    points: Sequence[tuple[float, ...]] = network.points
    return (*points, points[0]) if network.closed else tuple(points)
