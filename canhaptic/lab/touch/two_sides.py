"""A scene twice in one rig: a handle under `unprotected`, its twin under a passivity algorithm, held by one hand.

Both are axes of one rig, on a bus each, moved by the same SYNC: every delay of the computer affects both.
Nothing real moves, so a page that keeps the processor busy does not end the run: the link policy waits long.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from canhaptic.control.environments.two_sided_wall import TwoSidedWall
from canhaptic.control.passivity.unprotected import UnprotectedParameters
from canhaptic.control.port_hamiltonian.shapes.box import Box
from canhaptic.errors import InputError
from canhaptic.lab.loop.algorithms import able_under
from canhaptic.lab.touch.display_sides import display_line, display_plane
from canhaptic.lab.touch.touch_scene import (
    GUARDED,
    HAND,
    PLAIN,
    Side,
    TouchScene,
    on_two_buses,
    pointer_hand,
    reach,
    sliders_of,
)
from canhaptic.scene.components import ComponentSpec
from canhaptic.scene.models import AxisScene, GroupScene, MechanismScene, Scene
from canhaptic.scene.torque_history import simulation_of
from canhaptic.sim.plant.mechanism.task_hand import PlaneMotion, PointerTaskHand, TaskHand
from canhaptic.sim.plant.user import UserParameters

_SLIDERS = ("stiffness", "damping")


def two_sides(scene: Scene, axis: str | None = None) -> TouchScene:
    """Return a scene twice in one rig.

    Args:
        scene: Scene simulated on one bus.
        axis: Name of the axis to touch; None for the first, or for its mechanism.

    Raises:
        InputError: Nothing is simulated, there are several buses, or a group that is no box in a plane renders.
    """
    if not scene.simulated:
        raise InputError(
            f"{scene.source}: simulates nothing in this process (needs `simulation` and `bus.interface: virtual`); "
            "a page must not move a real drive"
        )
    if scene.further_buses:
        raise InputError(f"{scene.source}: has {len(scene.buses)} buses, expected one; touch shows one handle")
    names = [one.parameters.name for one in scene.axes]
    name = axis or names[0]
    if name not in names:
        raise InputError(f"{scene.source}: has no axis {name!r}, expected one of: {', '.join(names)}")
    chosen = scene.axis(name)
    if chosen.parameters.admittance is not None:
        return display_plane(scene, chosen.group) if chosen.group else display_line(scene, chosen)
    return _plane(scene, chosen.group) if chosen.group else _line(scene, chosen)


# --- along an axis ------------------------------------------------------------------------------------------------


def _line(scene: Scene, axis: AxisScene) -> TouchScene:
    plain = able_under(axis, PLAIN, scene).axis
    guarded = axis if axis.passivity.name != PLAIN else able_under(axis, GUARDED, scene).axis
    protected = _name_of(guarded)
    sides = (Side(PLAIN, (PLAIN,)), Side(protected, (protected,)))
    simulation = simulation_of(axis)
    user, start = simulation.user or UserParameters(), simulation.plant.initial_position
    axes = tuple(
        replace(
            one,
            parameters=one.parameters.model_copy(update={"name": side.name, "energy_loss_limit": "none"}),
            bus=side.name,
            simulation=replace(simulation_of(one), user=pointer_hand(user, start)),
        )
        for one, side in zip((plain, guarded), sides, strict=True)
    )
    shown = reach(user.motion, user.rest, start)
    solid = _solid(axis.environment.parameters, shown)
    wall = axis.environment.parameters
    names = _SLIDERS if "stiffness" in type(wall).model_fields else ()
    return TouchScene(
        on_two_buses(scene, axes, sides),
        sides,
        axis.parameters.unit,
        (shown,),
        (start,),
        solid,
        sliders_of("environment", wall, names, axis.parameters.unit),
    )


def _name_of(axis: AxisScene) -> str:
    name = axis.passivity.name if axis.passivity.own is None else axis.passivity.own.__name__
    return name if name != PLAIN else GUARDED


def _solid(environment: Any, shown: tuple[float, float]) -> tuple[tuple[float, float], ...]:
    """Region where an environment is felt, within the page [m or rad]; nothing where it is felt everywhere."""
    low, high = shown
    step = (high - low) / 2000
    places = [low + step * k for k in range(2001)]
    felt = [bool(environment.contact(place)) for place in places]
    if all(felt):
        return ()
    spans: list[tuple[float, float]] = []
    for place, inside in zip(places, felt, strict=True):
        if inside and spans and place - spans[-1][1] < 1.5 * step:
            spans[-1] = (spans[-1][0], place)
        elif inside:
            spans.append((place, place))
    return tuple(spans)


# --- in a plane ---------------------------------------------------------------------------------------------------


def _stage_of(scene: Scene, group: GroupScene) -> tuple[MechanismScene, Box]:
    """Return the stage on which a group renders a box, and the box.

    Raises:
        InputError: It is no stage, or no box that is linear and solid outside.
    """
    of = next((one for one in scene.mechanisms if one.axes == group.axes), None)
    box = group.network.parameters
    is_square = of is not None and of.mechanism.name == "xy_stage" and group.kinematics.name == "identity"
    if of is None or not is_square or not isinstance(box, Box) or box.side != "inside" or box.hardening:
        raise InputError(
            f"{scene.source}: group {group.name!r} renders {group.network.name}; touch shows an axis by itself, or a "
            "box on an xy_stage from inside, with linear springs"
        )
    return of, box


def _plane(scene: Scene, name: str) -> TouchScene:
    index, group = next((i, one) for i, one in enumerate(scene.groups) if one.name == name)
    of, box = _stage_of(scene, group)
    sides = (
        Side(PLAIN, tuple(f"{PLAIN} {axis}" for axis in group.axes)),
        Side(group.passivity.name, tuple(f"{group.passivity.name} {axis}" for axis in group.axes), name),
    )
    members = [scene.axis(axis) for axis in group.axes]
    plain = [_walled(axis, box, k) for k, axis in enumerate(members)]
    axes = [
        replace(
            axis,
            parameters=axis.parameters.model_copy(update={"name": port, "energy_loss_limit": "none"}),
            bus=side.name,
        )
        for side, of_side in zip(sides, (plain, members), strict=True)
        for axis, port in zip(of_side, side.axes, strict=True)
    ]
    guarded = GroupScene(name, sides[1].axes, group.kinematics, group.network, group.passivity)
    mechanisms = tuple(_held(of, members, side) for side in sides)
    hand = of.hand or TaskHand()
    start = tuple(float(place) for place in getattr(of.mechanism.parameters, "initial_position", (0.0, 0.0)))
    reaches = zip(hand.motions, hand.rest, start, strict=True)
    solid = zip(box.lower, box.upper, strict=True)
    return TouchScene(
        on_two_buses(scene, axes, sides, groups=(guarded,), mechanisms=mechanisms),
        sides,
        "m",
        tuple(reach(motion, rest, at) for motion, rest, at in reaches),
        start,
        tuple((float(low), float(high)) for low, high in solid),
        sliders_of(f"groups.{index}.network", box, _SLIDERS, "m"),
    )


def _walled(axis: AxisScene, box: Box, direction: int) -> AxisScene:
    """Return an axis that renders the two faces of a box in its direction by itself, unprotected."""
    wall = TwoSidedWall(
        stiffness=box.stiffness, damping=box.damping, lower=box.lower[direction], upper=box.upper[direction]
    )
    return replace(
        axis,
        group="",
        environment=ComponentSpec("two_sided_wall", wall),
        passivity=ComponentSpec(PLAIN, UnprotectedParameters()),
    )


def _held(of: MechanismScene, members: Sequence[AxisScene], side: Side) -> MechanismScene:
    """Return the mechanism of one side, held by the pointer; its axes in the order of the mechanism."""
    port = dict(zip((axis.parameters.name for axis in members), side.axes, strict=True))
    hand = (of.hand or TaskHand(**HAND)).model_dump(exclude={"motion", "push"})
    start = getattr(of.mechanism.parameters, "initial_position", (0.0, 0.0))
    held = PointerTaskHand(**{**hand, "rest": start}, motion=PlaneMotion())
    return replace(of, axes=tuple(port[axis] for axis in of.axes), hand=held)
