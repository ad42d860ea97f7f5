"""Scene of `canhaptic touch`: one handle under `unprotected` and one under a passivity algorithm, held by one hand.

A handle is an axis, an admittance display, an xy stage, a five-bar, or two admittance displays as a plane. Both handles
belong to one simulated rig with a CAN bus each, or a line for both, and the same SYNC, so that a delay of the computer
affects both alike. The link timeouts are long: nothing real moves, and a busy browser must not end the run.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from typing import Any, Final, NamedTuple, cast

from canhaptic.axis_units import damping_unit, effort_unit, mass_unit, stiffness_unit
from canhaptic.control.admittance.group_environment import GroupEnvironment, PathMass
from canhaptic.control.admittance.velocity_loop import GuardedAdmittanceParameters
from canhaptic.control.environments.detents import Detents
from canhaptic.control.port_hamiltonian.shapes.box import Box
from canhaptic.control.port_hamiltonian.shapes.guided_path import GuidedPath
from canhaptic.control.port_hamiltonian.shapes.sphere import Sphere
from canhaptic.drive.profile.causality import IMPEDANCE
from canhaptic.errors import InputError
from canhaptic.lab.loop.axis_loop import under
from canhaptic.scene.buses import kind_of
from canhaptic.scene.components import ComponentSpec
from canhaptic.scene.far_side import build_mechanism
from canhaptic.scene.method import simulation_of
from canhaptic.scene.models import AxisScene, FurtherBus, MechanismScene, Port, Scene
from canhaptic.sim.plant.mechanism.five_bar_linkage import FiveBarLinkage
from canhaptic.sim.plant.mechanism.task_hand import PlaneMotion, PointerTaskHand, TaskHand
from canhaptic.sim.plant.user import PointerHand, UserParameters
from canhaptic.sim.plant.velocity_drive import AdmittanceSimulation

PLAIN: Final = "unprotected"
GUARDED: Final = "guarded"
HAND: Final = {"stiffness": 300.0, "damping": 3.0}
"""Hand of a scene without one [N/m, N*s/m] or [N*m/rad, N*m*s/rad]."""


@dataclass(frozen=True, slots=True)
class Side:
    """One of the two handles."""

    name: str  # of its algorithm
    axes: tuple[str, ...]  # their names in the rig
    group: str = ""  # of its axes; empty: none
    allowance: float = 0.0  # energy that its algorithm may give out beyond the energy received [J]


class TouchSlider(NamedTuple):
    """A value of the scene that the page can change."""

    title: str
    key: str  # its path in the scene
    value: float
    unit: str
    decades: float  # logarithmic range up and down from the value; 0: linear, from 0 to five times the value


class Readings(NamedTuple):
    """What a page shows of a handle over time."""

    vectors: tuple[str, ...]  # in each direction; the force first
    beside: tuple[tuple[str, ...], ...]  # of them, those of each further panel
    sign: float  # of the force shown, over that of a sample
    labels: Mapping[str, str]  # vector, or the energy -> its name in the legend
    verdict: str  # what is judged
    has_delay: bool  # whether the page can change the delay


_OF_TORQUES: Final = Readings(
    ("force",), (), 1.0, {"force": "on the hand", "energy": "taken in by the wall"}, "passive", has_delay=True
)
_OF_VELOCITIES: Final = Readings(
    ("force", "velocity", "command"), (("command", "velocity"),), -1.0,
    {"force": "of the hand", "velocity": "handle", "energy": "into the display, at the sensor"},
    "passive_at_sensor", has_delay=False,
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class TouchScene:
    """The scene that `touch` runs: both handles on one rig, and what the page shows; places in [m or rad]."""

    scene: Scene  # with the axes of both handles, to be built
    sides: tuple[Side, Side]  # unprotected first
    unit: str  # of the motion of the handles
    shown: tuple[tuple[float, float], ...]  # range of positions on the page in each direction
    start: tuple[float, ...]  # position of the handle
    solid: tuple[tuple[float, float], ...]  # [low, high] along an axis; in a plane the free range of each direction
    sliders: tuple[TouchSlider, ...]  # in addition to rate and delay
    path: tuple[tuple[float, ...], ...] = ()  # corners of one that guides the handle in a plane; empty: none
    discs: tuple[tuple[float, ...], ...] = ()  # in a plane: centre x, y and radius of each [m]
    links: tuple[float, ...] = ()  # of a five-bar: half the distance of the motors, a proximal link [m]; empty: none
    readings: Readings = _OF_TORQUES  # what the page shows of each handle over time
    notches: tuple[float, ...] = ()  # place of a notch of detents, and their pitch; empty: no detents

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
    """Return a scene with a CAN bus for each handle, or a line for both; `parts` replace its groups and mechanisms.

    Its link timeouts are long.
    """
    further, patient = [FurtherBus(name=sides[1].name)], {"heartbeat_timeout": 10.0}
    if kind_of(scene.bus) == "ethercat":
        further, patient = [], {"watchdog": 6.0}
        axes = [replace(_changed(axis, position=place), bus=sides[0].name) for place, axis in enumerate(axes)]
    bus = scene.bus.model_copy(update={**patient, "stop_cycles": max(2000, scene.bus.stop_cycles)})
    log = scene.log.model_copy(update={"energy": None, "bus": None})
    parts = {"groups": (), "mechanisms": (), **parts}
    return replace(
        scene, bus=bus, bus_name=sides[0].name, further_buses=tuple(further), axes=tuple(axes), log=log, **parts
    )


def _changed(axis: AxisScene, **changes: object) -> AxisScene:
    return replace(axis, parameters=axis.parameters.model_copy(update=changes))


Shape = dict[str, Any]
"""What the page shows of a port: fields of `TouchScene`."""
_OVER: Final = 1.05
"""Ratio of declared to true values of a simulated drive for which the scene declares nothing."""


def _side(port: Port) -> Side:
    """Return the description of a handle, named after its algorithm."""
    by, names = port.passivity, [axis.parameters.name for axis in port.axes]
    name = by.name if by.own is None else by.own.__name__
    allowance = float(getattr(by.parameters, "energy_allowance", 0.0))
    if not port.section:
        return Side(name, (name,), allowance=allowance)
    return Side(name, tuple(f"{name} {axis}" for axis in names), name, allowance)


def _held_axis(axis: AxisScene, side: Side, port: str) -> AxisScene:
    """Return an axis of one handle, held by the pointer unless a mechanism is.

    Its check for a frozen force sensor is off, since a simulated sensor without noise is constant while the pointer
    rests.
    """
    display, simulation = axis.parameters.admittance, axis.simulation
    if display is not None:
        display = display.model_copy(update={"force": display.force.model_copy(update={"frozen_after": None})})
    if simulation is not None:
        user, start = _hand_of(axis)
        grip = {"stiffness": user.stiffness, "damping": user.damping} if user.stiffness else HAND
        simulation = replace(simulation, user=PointerHand(**grip, place=start))
    return replace(_named(axis, side, port, admittance=display), group=side.group, simulation=simulation)


def _named(axis: AxisScene, side: Side, port: str, **changes: Any) -> AxisScene:
    """Return an axis of one handle with the name `port` and changed parameters."""
    changes |= {"name": port, "energy_loss_limit": "none"}
    return replace(_changed(axis, **changes), bus=side.name)


def _hand_of(axis: AxisScene) -> tuple[UserParameters, float]:
    """Return the simulated hand of an axis, and the initial position of its handle [m or rad]."""
    simulation = simulation_of(axis)
    return simulation.user or UserParameters(), simulation.plant.initial_position


def _guarded(alone: Scene) -> Scene:
    """Return a scene with one port under its own algorithm, or `guarded` in place of none.

    What admittance displays declare for `guarded` then follows from the simulation.
    """
    [port] = alone.ports
    if port.passivity.name != PLAIN or port.passivity.own is not None:
        return alone
    if port.causality is IMPEDANCE:
        return under(alone, GUARDED).permitted()
    simulations = [simulation_of(axis) for axis in port.axes]
    loops = [cast(AdmittanceSimulation, one.admittance).loop for one in simulations]
    known = GuardedAdmittanceParameters(
        drive_mass=_OVER * max(one.plant.mass for one in simulations),
        loop_gain=_OVER * max(loop.gain for loop in loops),
        integral_gain=_OVER * max(loop.integral_gain for loop in loops),
        energy_allowance=1e-3,
    )
    return alone.with_port(port._replace(passivity=ComponentSpec(GUARDED, known)))


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
    port = scene.port_of(scene.axis(name))
    alone = scene.alone(port)
    is_box = isinstance(port.rendered.parameters, GroupEnvironment)
    shape = (_line if len(port.axes) == 1 else _of_walls if is_box else _plane)(scene, port)
    both = [one.ports[0] for one in (under(alone, PLAIN).permitted(), _guarded(alone))]
    sides = _side(both[0]), _side(both[1])
    pairs = list(zip(both, sides, strict=True))
    axes = [_held_axis(axis, side, at) for one, side in pairs for axis, at in zip(one.axes, side.axes, strict=True)]
    groups = tuple(
        replace(group, name=side.group, axes=side.axes, passivity=one.passivity)
        for one, side in pairs
        for group in alone.groups
    )
    mechanisms = [_held(of, port.axes, side, shape["start"]) for side in sides for of in alone.mechanisms]
    rig = on_two_buses(scene, axes, sides, groups=groups, mechanisms=tuple(mechanisms))
    readings = _OF_TORQUES if port.causality is IMPEDANCE else _OF_VELOCITIES
    return TouchScene(rig, sides, readings=readings, **shape)


# --- along an axis ------------------------------------------------------------------------------------------------


def _line(_: Scene, port: Port) -> Shape:
    """Return what the page shows of one axis."""
    [axis], parts = port.axes, port.rendered.parts or (port.rendered,)
    user, start = _hand_of(axis)
    shown = reach(user.motion, user.rest, start)
    notched: Any = next((part.parameters for part in parts if isinstance(part.parameters, Detents)), None)
    notches = () if notched is None else (notched.position, notched.pitch)
    environment: Any = port.rendered.parameters
    if hasattr(environment, "lower_wall"):
        solid = _beyond(shown, environment.lower_wall, environment.upper_wall)
    elif hasattr(environment, "rests") and port.rendered.parts:
        solid = _beyond(shown, *environment.rests())
    else:
        solid = () if notches else _solid(environment, shown)
    sliders = sliders_of("environment", parts, axis.parameters.unit)
    return {
        "unit": axis.parameters.unit, "shown": (shown,), "start": (start,), "solid": solid, "sliders": sliders,
        "notches": notches,
    }  # fmt: skip


def _solid(environment: Any, shown: tuple[float, float]) -> tuple[tuple[float, float], ...]:
    """Return the regions of the page in which an environment acts [m or rad]; empty if it acts everywhere."""
    low, high = shown
    places = [low + (high - low) / 2000 * k for k in range(2001)]
    runs = [[*run] for felt, run in groupby(places, lambda place: bool(environment.contact(place))) if felt]
    return () if len(runs) == 1 and len(runs[0]) == 2001 else tuple((run[0], run[-1]) for run in runs)


def _beyond(shown: tuple[float, float], low: float, high: float) -> tuple[tuple[float, float], ...]:
    """Return the regions of the page below and above two places [m or rad]."""
    return tuple(region for region in ((shown[0], low), (high, shown[1])) if region[0] < region[1])


# --- in a plane ---------------------------------------------------------------------------------------------------

_MECHANISMS: Final = {"xy_stage": "identity", "five_bar": "five_bar"}
"""Mechanism -> kinematics of a group on it that can be shown."""


def _of_walls(scene: Scene, port: Port) -> Shape:
    """Return what the page shows of two axes that render walls, or a path, for a mass.

    Raises:
        InputError: They are not two, or have other kinematics than `identity`.
    """
    if len(port.axes) != 2 or port.kinematics.name != "identity":
        raise InputError(
            f"{scene.source}: group {port.name!r} has {len(port.axes)} axes and kinematics {port.kinematics.name}; "
            "touch shows one axis, or two axes in a plane; choose such a group, with `kinematics: identity`"
        )
    hands, unit, network = [_hand_of(axis) for axis in port.axes], port.axes[0].parameters.unit, port.rendered
    known: Any = network.parameters
    return {
        "unit": unit,
        "shown": tuple(reach(user.motion, user.rest, start) for user, start in hands),
        "start": tuple(start for _, start in hands),
        "solid": _box(known),
        "sliders": sliders_of(port.section, (network,), unit),
        "path": _corners(known) if isinstance(known, PathMass) else (),
    }


def _plane(scene: Scene, port: Port) -> Shape:
    """Return what the page shows of a mechanism.

    Raises:
        InputError: It renders anything but a box from inside with linear springs, discs and paths, or moves otherwise.
    """
    names = tuple(axis.parameters.name for axis in port.axes)
    of = next((one for one in scene.mechanisms if one.axes == names), None)
    rendered = [part.parameters for part in port.rendered.parts or (port.rendered,)]
    kinds = [type(one) for one in rendered]
    boxes = [one for one in rendered if isinstance(one, Box)]
    is_known = of is not None and _MECHANISMS.get(of.mechanism.name) == port.kinematics.name
    is_drawn = all(box.side == "inside" and not box.hardening for box in boxes) and kinds.count(Box) <= 1
    if of is None or not is_known or not is_drawn or not {*kinds} <= {Box, GuidedPath, Sphere}:
        raise InputError(
            f"{scene.source}: group {port.name!r} renders {port.rendered.name}; touch shows an axis by itself, or on "
            "an xy_stage or a five_bar a box from inside with linear springs, spheres and paths"
        )
    hand, start = of.hand or TaskHand(), build_mechanism(of, scene.bus.sample_time_ns).handle
    links = of.mechanism.parameters
    return {
        "unit": "m",
        "shown": tuple(map(reach, hand.motions, hand.rest, start)),
        "start": start,
        "solid": next((tuple(zip(one.lower, one.upper, strict=True)) for one in boxes), ()),
        "sliders": sliders_of(port.section, port.rendered.parts or (port.rendered,), "m"),
        "path": next((_corners(path) for path in rendered if isinstance(path, GuidedPath)), ()),
        "discs": tuple((*disc.centre, disc.radius) for disc in rendered if isinstance(disc, Sphere)),
        "links": (0.5 * links.base, links.proximal) if isinstance(links, FiveBarLinkage) else (),
    }


def _held(of: MechanismScene, members: Sequence[AxisScene], side: Side, start: tuple[float, ...]) -> MechanismScene:
    """Return the mechanism of one handle, held by the pointer, with its axes in the order of the mechanism."""
    port = dict(zip((axis.parameters.name for axis in members), side.axes, strict=True))
    hand = (of.hand or TaskHand(**HAND)).model_dump(exclude={"motion", "push"})
    held = PointerTaskHand(**{**hand, "rest": start}, motion=PlaneMotion())
    return replace(of, axes=tuple(port[axis] for axis in of.axes), hand=held)
