"""What `check` says of an axis with a far side: reserve, time until the link closes, drag, and what a touch feels like.

Reserve and times are those of the port itself, which a handle moves at constant speed; no network is simulated.
"""

from math import isfinite
from typing import Final, NamedTuple

from canhaptic.axis_units import damping_unit, effort_unit, si, stiffness_unit
from canhaptic.far.parameters import SWINGS
from canhaptic.far.port import PICO, READY
from canhaptic.scene.models import FAR, AxisScene, Scene
from canhaptic.scene.parts import build_far_port

_SPEEDS: Final = (0.1, 0.2, 0.4)
"""Speeds of a hand that are tried, on a rotary axis ten times as much [m/s]."""
_PER_RADIAN: Final = 10.0
_LONGEST: Final = 2.0
"""Time in which a hand is tried [s]."""
_MILLI: Final = 1e-3


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
    axis = next((axis for axis in scene.axes if axis.guard == FAR), None)
    if scene.far is None or axis is None:
        return []
    coupling = scene.far.coupling
    touches = _of_spring if coupling.type == "spring" else _of_model
    rows = touches(coupling.stiffness, coupling.damping, round_trip(scene), axis)
    return [_reserve(scene, axis), _closing(scene, axis), *rows]


def _reserve(scene: Scene, axis: AxisScene) -> LinkFigure:
    """Return what the tank must hold for the torque that the declared hand holds at rest."""
    port, unit = build_far_port(scene, axis), effort_unit(axis.parameters.unit)
    if not port.settings.declared.by_hand_force:
        return LinkFigure("reserve", None, "J", "torques are not certified by hand force here")
    limit, level = port.settings.torque_limit, port.settings.level
    held = min(limit, port.hand_force or 0.0)
    text = f"the most that {si(held, unit, 3)}, held at rest against hand_force, can give out before it can change;"
    text += f" level is {si(level, 'J', 3)}"
    if isfinite(limit):
        text += f"; at the torque limit of {si(limit, unit, 3)} it is {si(port.reserve(limit), 'J', 3)}"
    return LinkFigure("reserve", port.reserve(held), "J", text)


def _closing(scene: Scene, axis: AxisScene) -> LinkFigure:
    """Return in what time the slowest of some hands closes the link, of whose other side nobody moves."""
    idle, unit = "", f"{axis.parameters.unit}/s"
    for speed in _SPEEDS:
        speed *= _PER_RADIAN if axis.parameters.unit == "rad" else 1.0
        own, both = earned_after(scene, axis, speed)
        if both is not None and own is not None:
            text = f"a hand moves at {speed:g} {unit} and earns for both sides, the other one at rest; this side"
            text += f" alone has earned its start after {si(own, 's', 3)}; then the coupling fades in"
            return LinkFigure("time to close", both, "s", text + idle)
        idle += f"; at {speed:g} {unit} not within {_LONGEST:g} s"
    text = "a hand moves steadily and the other side is at rest"
    ways = "; declare device_damping or device_friction, less hand_push, or more drag"
    return LinkFigure("time to close", None, "s", text + idle + ways)


def earned_after(scene: Scene, axis: AxisScene, speed: float) -> tuple[float | None, float | None]:
    """Return when a hand at constant speed has earned the start of this side, and of both [s]; None: not soon.

    Args:
        scene: Scene with a section `far`.
        axis: Axis that it couples.
        speed: Speed of the hand [m/s or rad/s].
    """
    port, time, count = build_far_port(scene, axis), axis.loop.sample_time, axis.loop.encoder_count
    state, settings, queue = port.state, port.settings, [0.0] * (1 + axis.loop.delay)
    state.linked, state.wanted = True, settings.level / PICO
    own = None
    for hold in range(round(_LONGEST / time)):
        position = speed * time * hold
        balance = port.step(count * round(position / count) if count else position, queue[0])
        queue = [*queue[1:], max(-settings.torque_limit, min(settings.torque_limit, balance.torque))]
        if own is None and port.is_ready:
            own = hold * time
        if own is not None and state.sent * PICO >= READY * settings.level:
            return own, hold * time
    return own, None


def _of_spring(stiffness: float, damping: float, trip: float, axis: AxisScene) -> list[LinkFigure]:
    """Return drag and touch of a spring to the position of the other rig."""
    motion, speed = axis.parameters.unit, _SPEEDS[0] * (_PER_RADIAN if axis.parameters.unit == "rad" else 1.0)
    most = f"a round trip above {si(SWINGS * damping / stiffness, 's', 3)} swings ({SWINGS:g} x damping / stiffness)"
    if trip:
        text = f"stiffness x round trip of {si(trip, 's', 3)}, once linked:"
        text += f" {stiffness * trip * speed:.3g} {effort_unit(motion)} at {speed:g} {motion}/s; {most}"
    else:
        text = f"stiffness x round trip, for each ms of it, as no far_network is declared; {most}"
    unit = stiffness_unit(motion)
    felt = f"k k_e / (k + k_e) at rest, the same coupling on both sides: {si(0.5 * stiffness, unit, 3)} where k_e = k"
    return [
        LinkFigure("drag in free motion", stiffness * (trip or _MILLI), damping_unit(motion), text),
        LinkFigure("felt at the first touch, at most", stiffness, unit, f"{felt}; a round trip later"),
        LinkFigure("felt at the second touch, at most", stiffness, unit, "the same, and as late"),
    ]


def _of_model(stiffness: float, damping: float, trip: float, axis: AxisScene) -> list[LinkFigure]:
    """Return drag and touch of a wall that the other rig finds."""
    motion, unit = axis.parameters.unit, stiffness_unit(axis.parameters.unit)
    late = f" of {si(trip, 's', 3)}" if trip else ""
    first = f"a round trip{late} later; the wall starts at the hand and moves to its place as the tank pays or the hand"
    first += " leaves"
    return [
        LinkFigure("drag in free motion", 0.0, damping_unit(motion), "but for `drag` while a side lacks energy"),
        LinkFigure("felt at the first touch, at most", stiffness, unit, first),
        LinkFigure("felt from the second touch on, at most", stiffness, unit, "at once, as far as the tank pays it"),
    ]
