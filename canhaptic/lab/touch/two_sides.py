"""Scene of `canhaptic touch`: one handle under `unprotected` and one under a passivity algorithm, held by one hand.

A handle is an axis, an admittance display, an xy stage, a five-bar, or two admittance displays as a plane. Both handles
belong to one simulated rig with a bus each and the same SYNC, so that a delay of the computer affects both alike. The
link timeouts are long: nothing real moves, and a busy browser must not end the run.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from typing import Any, Final, NamedTuple

from canhaptic.axis_units import damping_unit, effort_unit, mass_unit, stiffness_unit
from canhaptic.control.admittance.group_environment import GroupEnvironment, PathMass
from canhaptic.control.admittance.velocity_loop import GuardedAdmittanceParameters
from canhaptic.control.environments.detents import Detents
from canhaptic.control.multi_axis.unprotected_group import UnprotectedGroupParameters
from canhaptic.control.port_hamiltonian.shapes.box import Box
from canhaptic.control.port_hamiltonian.shapes.guided_path import GuidedPath
from canhaptic.control.port_hamiltonian.shapes.sphere import Sphere
from canhaptic.errors import InputError
from canhaptic.lab.loop.axis_loop import under, with_algorithm
from canhaptic.scene.components import ComponentSpec
from canhaptic.scene.far_side import build_mechanism
from canhaptic.scene.method import simulation_of
from canhaptic.scene.models import AxisScene, FurtherBus, GroupScene, MechanismScene, Scene
from canhaptic.sim.plant.mechanism.five_bar_linkage import FiveBarLinkage
from canhaptic.sim.plant.mechanism.task_hand import PlaneMotion, PointerTaskHand, TaskHand
from canhaptic.sim.plant.user import PointerHand, UserParameters

PLAIN: Final = "unprotected"
GUARDED: Final = "guarded"
HAND: Final = {"stiffness": 300.0, "damping": 3.0}
"""Hand of a scene without one [N/m, N*s/m] or [N*m/rad, N*m*s/rad]."""


@dataclass(frozen=True, slots=True)
class Side:
    """One of the two handles.

    Attributes:
        name: Name of its algorithm.
        axes: Names of its axes in the rig.
        group: Name of its group of axes; empty without a group.
        allowance: Energy that its algorithm may give out beyond the energy received [J].
    """

    name: str
    axes: tuple[str, ...]
    group: str = ""
    allowance: float = 0.0


class TouchSlider(NamedTuple):
    """A value of the scene that the page can change."""

    title: str
    key: str  # its path in the scene
    value: float
    unit: str
    decades: float  # logarithmic range up and down from the value; 0: linear, from 0 to five times the value


@dataclass(frozen=True, slots=True)
class TouchScene:
    """The scene that `touch` runs: both handles on one rig, and what the page shows.

    Attributes:
        scene: Scene with the axes of both handles, to be built.
        sides: The two handles, unprotected first.
        unit: Unit of the handle's motion.
        shown: Range of positions on the page in each direction [m or rad].
        start: Position of the handle at the start [m or rad].
        solid: Solid regions [low, high] along an axis; in a plane the free range in each direction [m or rad].
        sliders: Values that the page can change in addition to rate and delay.
        path: Corners of a path that guides the handle in a plane [m or rad]; empty: none.
        discs: Centre x, y and radius of discs in a plane [m].
        links: Half the distance of the motors of a five-bar, and the length of its proximal links [m]; empty: none.
        is_display: Whether the handles are admittance displays: force in, velocity out.
        notches: Position of one notch of detents, and their pitch [m or rad]; empty: no detents.
    """

    scene: Scene
    sides: tuple[Side, Side]
    unit: str
    shown: tuple[tuple[float, float], ...]
    start: tuple[float, ...]
    solid: tuple[tuple[float, float], ...]
    sliders: tuple[TouchSlider, ...]
    path: tuple[tuple[float, ...], ...] = ()
    discs: tuple[tuple[float, ...], ...] = ()
    links: tuple[float, ...] = ()
    is_display: bool = False
    notches: tuple[float, ...] = ()

    @property
    def directions(self) -> tuple[str, ...]:
        """Names of the directions in which the handle moves: x, and y in a plane."""
        return ("x", "y")[: len(self.shown)]

    @property
    def is_plane(self) -> bool:
        """Whether the handle moves in a plane."""
        return len(self.shown) == 2


def sliders_of(section: str, parts: Sequence[ComponentSpec], unit: str) -> tuple[TouchSlider, ...]:
    """Return sliders for the parameters of a section, or of each part of its sum; 0 is on no logarithmic one.

    Args:
        section: Path of the section in the scene.
        parts: What it renders; several are a sum.
        unit: "m" or "rad".
    """
    kinds = {
        "mass": (mass_unit(unit), 1.0),
        "cup": (mass_unit(unit), 1.0),
        "stiffness": (stiffness_unit(unit), 2.0),
        "damping": (damping_unit(unit), 0.0),
        "peak": (effort_unit(unit), 1.0),
        "pitch": (unit, 0.5),
    }
    many = len(parts) > 1
    return tuple(
        TouchSlider(
            f"{part.name}: {name}" if many else name, f"{section}.{n}.{name}" if many else f"{section}.{name}",
            float(getattr(part.parameters, name)), *kinds[name],
        )
        for n, part in enumerate(parts)
        for name, (_, decades) in kinds.items()
        if name in type(part.parameters).model_fields and (getattr(part.parameters, name) or not decades)
    )  # fmt: skip


def reach(motion: Any, rest: float, start: float) -> tuple[float, float]:
    """Return the range of a direction on the page [m or rad]: 1.5 times the motion of the scene's hand."""
    middle = rest + (motion.offset if motion else 0.0)
    half = 1.5 * motion.amplitude if motion else 0.1
    return min(middle - half, start), max(middle + half, start)


def on_two_buses(scene: Scene, axes: Sequence[AxisScene], sides: tuple[Side, Side], **parts: Any) -> Scene:
    """Return a scene with a bus for each handle and long link timeouts; `parts` replace its groups and mechanisms."""
    bus = scene.bus.model_copy(update={"heartbeat_timeout": 10.0, "stop_cycles": max(2000, scene.bus.stop_cycles)})
    log, further = scene.log.model_copy(update={"energy": None, "bus": None}), (FurtherBus(name=sides[1].name),)
    parts = {"groups": (), "mechanisms": (), **parts}
    return replace(scene, bus=bus, bus_name=sides[0].name, further_buses=further, axes=tuple(axes), log=log, **parts)


_OVER: Final = 1.05
"""Ratio of declared to true values of a simulated drive for which the scene declares nothing."""


def display_plane(scene: Scene, name: str) -> TouchScene:
    """Return the handles of a plane: a group of two admittance displays, unprotected and protected.

    Raises:
        InputError: The group does not have two axes with kinematics `identity`.
    """
    index, group = next((i, one) for i, one in enumerate(scene.groups) if one.name == name)
    if len(group.axes) != 2 or group.kinematics.name != "identity":
        raise InputError(
            f"{scene.source}: group {name!r} has {len(group.axes)} axes and kinematics {group.kinematics.name}; touch "
            "shows one axis, or two axes in a plane; choose such a group, with `kinematics: identity`"
        )
    members = [scene.axis(axis) for axis in group.axes]
    guarded = group if group.passivity.name != PLAIN else replace(group, passivity=_guard_of(*members))
    both = (with_algorithm(group, PLAIN, displays=True), guarded)
    sides = _side(both[0].passivity, group.axes), _side(guarded.passivity, group.axes)
    axes = [_held_axis(axis, side, f"{side.name} {axis.parameters.name}") for side in sides for axis in members]
    groups = tuple(replace(one, name=side.group, axes=side.axes) for one, side in zip(both, sides, strict=True))
    hands, unit = [_hand_of(axis) for axis in members], members[0].parameters.unit
    network: Any = group.network.parameters
    shown = tuple(reach(user.motion, user.rest, start) for user, start in hands)
    sliders = sliders_of(f"groups.{index}.network", (group.network,), unit)
    return TouchScene(
        on_two_buses(scene, axes, sides, groups=groups), sides, unit, shown, tuple(start for _, start in hands),
        _box(network), sliders, path=_corners(network) if isinstance(network, PathMass) else (), is_display=True,
    )  # fmt: skip


def _side(passivity: ComponentSpec, axes: Sequence[str]) -> Side:
    """Return the description of a handle, named after its algorithm."""
    name, allowance = passivity.name, float(getattr(passivity.parameters, "energy_allowance", 0.0))
    return Side(name, tuple(f"{name} {axis}" for axis in axes), name, allowance)


def _held_axis(axis: AxisScene, side: Side, port: str) -> AxisScene:
    """Return an axis of one handle, held by the pointer.

    Its check for a frozen force sensor is off, since a simulated sensor without noise is constant while the pointer
    rests.
    """
    display = axis.parameters.admittance
    if display is not None:
        display = display.model_copy(update={"force": display.force.model_copy(update={"frozen_after": None})})
    user, start = _hand_of(axis)
    grip = {"stiffness": user.stiffness, "damping": user.damping} if user.stiffness else HAND
    simulation = replace(simulation_of(axis), user=PointerHand(**grip, place=start))
    return replace(_named(axis, side, port, admittance=display), group=side.group, simulation=simulation)


def _named(axis: AxisScene, side: Side, port: str, **changes: Any) -> AxisScene:
    """Return an axis of one handle with the name `port` and changed parameters."""
    changes |= {"name": port, "energy_loss_limit": "none"}
    return replace(axis, parameters=axis.parameters.model_copy(update=changes), bus=side.name)


def _hand_of(axis: AxisScene) -> tuple[UserParameters, float]:
    """Return the simulated hand of an axis, and the initial position of its handle [m or rad]."""
    simulation = simulation_of(axis)
    return simulation.user or UserParameters(), simulation.plant.initial_position


def _guard_of(*axes: AxisScene) -> ComponentSpec:
    """Return `guarded` for admittance displays whose scene is unprotected, from the properties of the simulation."""
    simulations = [simulation_of(axis) for axis in axes]
    loops = [one.admittance.loop for one in simulations if one.admittance is not None]
    known = GuardedAdmittanceParameters(
        drive_mass=_OVER * max(one.plant.mass for one in simulations),
        loop_gain=_OVER * max((loop.gain for loop in loops), default=0.0),
        integral_gain=_OVER * max((loop.integral_gain for loop in loops), default=0.0),
        energy_allowance=1e-3,
    )
    return ComponentSpec(GUARDED, known)


def _box(network: GroupEnvironment) -> tuple[tuple[float, float], ...]:
    """Return the range between the walls in each direction [m or rad]; empty without walls."""
    if not network.lower and not network.upper:
        return ()
    far = (-1e3, -1e3), (1e3, 1e3)
    return tuple(zip(network.lower or far[0], network.upper or far[1], strict=True))


def _corners(path: GuidedPath | PathMass) -> tuple[tuple[float, ...], ...]:
    return (*path.points, path.points[0]) if path.closed else tuple(path.points)


def two_sides(scene: Scene, axis: str | None = None) -> TouchScene:
    """Return the scene with both handles.

    Args:
        scene: Scene simulated on one bus.
        axis: Name of the axis to touch, with the other axis of its plane; None for the first.

    Raises:
        InputError: The scene is not simulated, has several buses or no such axis, or its group cannot be shown.
    """
    if not scene.simulated:
        raise InputError(
            f"{scene.source}: is not simulated in this process, and touch must not move a real drive; it needs a "
            "section `simulation` and `bus.interface: virtual`"
        )
    if scene.further_buses:
        raise InputError(f"{scene.source}: got {len(scene.buses)} buses, expected one; choose a scene with one bus")
    names = [one.parameters.name for one in scene.axes]
    name = axis or names[0]
    if name not in names:
        raise InputError(f"{scene.source}: --axis: got {name!r}, expected one of: {', '.join(names)}")
    chosen = scene.axis(name)
    if not chosen.group:
        return _line(scene, chosen)
    return (_plane if chosen.parameters.admittance is None else display_plane)(scene, chosen.group)


# --- along an axis ------------------------------------------------------------------------------------------------


def _line(scene: Scene, axis: AxisScene) -> TouchScene:
    """Return the handles of one axis or admittance display: unprotected, and under the algorithm of the scene."""
    is_display = axis.parameters.admittance is not None
    if is_display:
        plain = with_algorithm(axis, PLAIN, displays=True)
        guarded = axis if axis.passivity.name != PLAIN else replace(axis, passivity=_guard_of(axis))
    else:
        alone = replace(scene, axes=(axis,), groups=())
        [plain] = under(alone, PLAIN).permitted().axes
        [guarded] = (axis,) if axis.passivity.name != PLAIN else under(alone, GUARDED).permitted().axes
    own, allowance = guarded.passivity.own, _side(guarded.passivity, ()).allowance
    name = guarded.passivity.name if own is None else own.__name__
    name = name if name != PLAIN else GUARDED
    sides = (Side(PLAIN, (PLAIN,)), Side(name, (name,), allowance=allowance))
    axes = [_held_axis(one, side, side.axes[0]) for one, side in zip((plain, guarded), sides, strict=True)]
    user, start = _hand_of(axis)
    shown = reach(user.motion, user.rest, start)
    parts = axis.environment.parts or (axis.environment,)
    notched: Any = next((part.parameters for part in parts if isinstance(part.parameters, Detents)), None)
    notches = () if notched is None else (notched.position, notched.pitch)
    environment: Any = axis.environment.parameters
    if is_display or (hasattr(environment, "rests") and axis.environment.parts):
        rests = (environment.lower_wall, environment.upper_wall) if is_display else environment.rests()
        solid = tuple((low, high) for low, high in ((shown[0], rests[0]), (rests[1], shown[1])) if low < high)
    else:
        solid = () if notches else _solid(environment, shown)
    sliders = sliders_of("environment", parts, axis.parameters.unit)
    return TouchScene(
        on_two_buses(scene, axes, sides), sides, axis.parameters.unit, (shown,), (start,), solid, sliders,
        is_display=is_display, notches=notches,
    )  # fmt: skip


def _solid(environment: Any, shown: tuple[float, float]) -> tuple[tuple[float, float], ...]:
    """Return the regions of the page in which an environment acts [m or rad]; empty if it acts everywhere."""
    low, high = shown
    places = [low + (high - low) / 2000 * k for k in range(2001)]
    runs = [[*run] for felt, run in groupby(places, lambda place: bool(environment.contact(place))) if felt]
    return () if len(runs) == 1 and len(runs[0]) == 2001 else tuple((run[0], run[-1]) for run in runs)


# --- in a plane ---------------------------------------------------------------------------------------------------

_MECHANISMS: Final = {"xy_stage": "identity", "five_bar": "five_bar"}
"""Mechanism -> kinematics of a group on it that can be shown."""


def _mechanism_of(scene: Scene, group: GroupScene) -> tuple[MechanismScene, Sequence[ComponentSpec]]:
    """Return the mechanism of a group, and the parts that it renders.

    Raises:
        InputError: They are not a box from inside with linear springs, discs and paths, on an xy stage or a five-bar.
    """
    of = next((one for one in scene.mechanisms if one.axes == group.axes), None)
    parts = group.network.parts or (group.network,)
    kinds = [type(part.parameters) for part in parts]
    boxes = [part.parameters for part in parts if isinstance(part.parameters, Box)]
    is_known = of is not None and _MECHANISMS.get(of.mechanism.name) == group.kinematics.name
    is_drawn = all(box.side == "inside" and not box.hardening for box in boxes) and kinds.count(Box) <= 1
    if of is None or not is_known or not is_drawn or not {*kinds} <= {Box, GuidedPath, Sphere}:
        raise InputError(
            f"{scene.source}: group {group.name!r} renders {group.network.name}; touch shows an axis by itself, or on "
            "an xy_stage or a five_bar a box from inside with linear springs, spheres and paths"
        )
    return of, parts


def _plane(scene: Scene, name: str) -> TouchScene:
    index, group = next((i, one) for i, one in enumerate(scene.groups) if one.name == name)
    of, parts = _mechanism_of(scene, group)
    sides = (
        Side(PLAIN, tuple(f"{PLAIN} {axis}" for axis in group.axes), PLAIN),
        replace(_side(group.passivity, group.axes), group=name),
    )
    members = [scene.axis(axis) for axis in group.axes]
    axes = [
        replace(_named(axis, side, port), group=side.group)
        for side in sides
        for axis, port in zip(members, side.axes, strict=True)
    ]
    guarded = GroupScene(name, sides[1].axes, group.kinematics, group.network, group.passivity)
    plain = ComponentSpec(PLAIN, UnprotectedGroupParameters())
    groups = (replace(guarded, name=PLAIN, axes=sides[0].axes, passivity=plain), guarded)
    hand, start = of.hand or TaskHand(), build_mechanism(of, scene.bus.sample_time_ns).handle
    mechanisms = tuple(_held(of, members, side, start) for side in sides)
    rendered, links = [part.parameters for part in parts], of.mechanism.parameters
    return TouchScene(
        on_two_buses(scene, axes, sides, groups=groups, mechanisms=mechanisms), sides, "m",
        tuple(map(reach, hand.motions, hand.rest, start)), start,
        next((tuple(zip(one.lower, one.upper, strict=True)) for one in rendered if isinstance(one, Box)), ()),
        sliders_of(f"groups.{index}.network", parts, "m"),
        path=next((_corners(path) for path in rendered if isinstance(path, GuidedPath)), ()),
        discs=tuple((*disc.centre, disc.radius) for disc in rendered if isinstance(disc, Sphere)),
        links=(0.5 * links.base, links.proximal) if isinstance(links, FiveBarLinkage) else (),
    )  # fmt: skip


def _held(of: MechanismScene, members: Sequence[AxisScene], side: Side, start: tuple[float, ...]) -> MechanismScene:
    """Return the mechanism of one handle, held by the pointer, with its axes in the order of the mechanism."""
    port = dict(zip((axis.parameters.name for axis in members), side.axes, strict=True))
    hand = (of.hand or TaskHand(**HAND)).model_dump(exclude={"motion", "push"})
    held = PointerTaskHand(**{**hand, "rest": start}, motion=PlaneMotion())
    return replace(of, axes=tuple(port[axis] for axis in of.axes), hand=held)
