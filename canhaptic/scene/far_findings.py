"""What `check` says of an axis with a far side: reserve, time until the link closes, drag, and what a touch feels like.

Reserve and times are those of the port itself, which a handle moves at constant speed; no network is simulated.
"""

from typing import Final, NamedTuple

from canhaptic.axis_units import damping_unit, effort_unit, si, stiffness_unit
from canhaptic.far.parameters import SWINGS, Coupling, FarParameters
from canhaptic.far.port import PICO, STARTS
from canhaptic.scene.models import AxisScene, Scene
from canhaptic.scene.parts import build_far_port

_SPEEDS: Final = {"m": (0.1, 0.2, 0.4), "rad": (1.0, 2.0, 4.0)}
"""Speeds of a hand that are tried [m/s or rad/s]."""
_LONGEST: Final = 2.0
"""Time in which a hand is tried [s]."""


class LinkFigure(NamedTuple):
    """One figure of a link, before it is run."""

    what: str
    value: float | None  # None: not known
    unit: str
    text: str  # on what it rests


def round_trip(scene: Scene) -> float:
    """Return the mean simulated time to the far side and back [s]; 0 where no network is declared."""
    network = scene.far_network
    return 0.0 if network is None else 2.0 * (network.delay + network.jitter)


def far_findings(scene: Scene) -> list[LinkFigure]:
    """Return the figures of the link of a scene; none without a section `far`."""
    axis = scene.far_axis
    if scene.far is None or axis is None:
        return []
    own = [_reserve(scene, axis), _closing(scene, axis)]
    if scene.far.world is not None:
        return [_program(scene, scene.far), *own, *_of_world(scene.far.coupling, axis)]
    rows = _of_spring if scene.far.coupling.type == "spring" else _of_model
    return [*own, *rows(scene.far.coupling, round_trip(scene), axis)]


def _program(scene: Scene, far: FarParameters) -> LinkFigure:
    """Return what a world's scene needs besides it."""
    rig, world = ("{}:{}".format(*place) for place in far.places)
    text = f"a program that iterates over canhaptic.World at {world}, and `canhaptic run {scene.source} --pace real` at"
    text += f' {rig}; or World("virtual") alone. A stall of the program that is longer ends the link'
    return LinkFigure("program", far.silence, "s", text)


def _reserve(scene: Scene, axis: AxisScene) -> LinkFigure:
    """Return what the tank must hold for a torque as large as the declared force of the hand."""
    port, unit = build_far_port(scene, axis), effort_unit(axis.parameters.unit)
    if not port.settings.declared.by_hand_force:
        return LinkFigure("reserve", None, "J", "torques are not certified by hand force here")
    limit, held = port.settings.torque_limit, port.held
    text = f"the most that a torque of {si(held, unit, 3)} (hand_force) can give out at rest before it can change;"
    text += f" at the torque limit of {si(limit, unit, 3)} it is {si(port.reserve(limit), 'J', 3)}; level is"
    return LinkFigure("reserve", port.reserve(held), "J", f"{text} {si(port.settings.level, 'J', 3)}")


def _closing(scene: Scene, axis: AxisScene) -> LinkFigure:
    """Return in what time the slowest of some hands closes the link, whose other side does not move."""
    idle, unit = "", f"{axis.parameters.unit}/s"
    for speed in _SPEEDS[axis.parameters.unit]:
        own, both = earned_after(scene, axis, speed)
        if both is not None:
            text = f"a hand moves at {speed:g} {unit} and earns for both sides, the other one at rest; this side alone"
            text += f" has earned its start after {si(own or both, 's', 3)}; a packet later the coupling fades in"
            if scene.far is not None and scene.far.world is not None:
                text = f"a hand moves at {speed:g} {unit}; a packet later what the program asks for fades in"
            return LinkFigure("time to close", both, "s", text + idle)
        idle += f"; at {speed:g} {unit} not within {_LONGEST:g} s"
    ways = "; declare device_damping or device_friction, less hand_push, or more drag"
    return LinkFigure("time to close", None, "s", f"a hand moves steadily, the other side is at rest{idle}{ways}")


def earned_after(scene: Scene, axis: AxisScene, speed: float) -> tuple[float | None, float | None]:
    """Return when a hand at constant speed has earned the start of this side, and of both [s]; None: not soon.

    Args:
        scene: Scene with a section `far`.
        axis: Axis that it couples.
        speed: Speed of the hand [m/s or rad/s].
    """
    port, time, count = build_far_port(scene, axis), axis.loop.sample_time, axis.loop.encoder_count
    state, settings, queue, own = port.state, port.settings, [0.0] * (1 + axis.loop.delay), None
    state.linked, state.wanted = True, 0.0 if settings.by_world else settings.level / PICO
    for hold in range(round(_LONGEST / time)):
        position = speed * time * hold
        balance = port.step(count * round(position / count) if count else position, queue[0])
        queue = [*queue[1:], max(-settings.torque_limit, min(settings.torque_limit, balance.torque))]
        if own is None and port.is_ready:
            own = hold * time
        if own is not None and (settings.by_world or state.sent * PICO >= STARTS * settings.level):
            return own, hold * time
    return own, None


def _of_spring(coupling: Coupling, trip: float, axis: AxisScene) -> list[LinkFigure]:
    """Return drag and touch of a spring to the position of the other rig."""
    stiffness, motion = coupling.stiffness, axis.parameters.unit
    speed, unit = _SPEEDS[motion][0], stiffness_unit(motion)
    text = "stiffness x round trip, for each ms of it, as no far_network is declared"
    if trip:
        text = f"stiffness x round trip of {si(trip, 's', 3)}, once linked: {stiffness * trip * speed:.3g}"
        text += f" {effort_unit(motion)} at {speed:g} {motion}/s"
    text += f"; a round trip above {si(SWINGS * coupling.damping / stiffness, 's', 3)} swings"
    felt = f"k k_e / (k + k_e) at rest, the same coupling on both sides: {si(0.5 * stiffness, unit, 3)} where k_e = k"
    drag = LinkFigure("drag in free motion", stiffness * (trip or 1e-3), damping_unit(motion), text)
    return [drag, *_touches(stiffness, unit, f"{felt}; a round trip later", "the same, and as late")]


def _of_model(coupling: Coupling, trip: float, axis: AxisScene) -> list[LinkFigure]:
    """Return drag and touch of a wall that the other rig finds."""
    motion, late = axis.parameters.unit, f" of {si(trip, 's', 3)}" if trip else ""
    first = f"a round trip{late} later; the wall starts at the hand and moves to its place as the tank pays or as the"
    drag = LinkFigure("drag in free motion", 0.0, damping_unit(motion), "but for `drag` while a side lacks energy")
    then = "at once, as far as the tank pays it"
    return [drag, *_touches(coupling.stiffness, stiffness_unit(motion), f"{first} hand leaves", then)]


def _of_world(coupling: Coupling, axis: AxisScene) -> list[LinkFigure]:
    """Return drag and touch of what a program asks for."""
    motion = axis.parameters.unit
    first = "a turn of the program later; the wall starts at the hand and grows as the tank pays"
    drag = LinkFigure("drag in free motion", 0.0, damping_unit(motion), "but for `drag` while the tank lacks energy")
    then = "at once, as far as the tank pays it and the program leaves the wall where it is"
    return [drag, *_touches(coupling.stiffness, stiffness_unit(motion), first, then)]


def _touches(stiffness: float, unit: str, first: str, then: str) -> list[LinkFigure]:
    of = (("felt at the first touch, at most", first), ("felt from the second touch on, at most", then))
    return [LinkFigure(what, stiffness, unit, text) for what, text in of]
