"""Description of the two sides for the page of `canhaptic touch`, and common parts of all kinds of sides."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, NamedTuple

from canhaptic.axis_units import damping_unit, mass_unit, stiffness_unit
from canhaptic.scene.further_bus import FurtherBus
from canhaptic.scene.models import AxisScene, GroupScene, MechanismScene, Scene
from canhaptic.sim.plant.pointer_hand import PointerHand
from canhaptic.sim.plant.user import UserParameters
from canhaptic.units import Parameters

PLAIN: Final = "unprotected"
GUARDED: Final = "guarded"
_PATIENCE: Final = 10.0  # [s] until a silent peer counts as lost
_LOST_CYCLES: Final = 2000
HAND: Final = {"stiffness": 300.0, "damping": 3.0}
"""Hand of a scene without one [N/m, N*s/m] or [N*m/rad, N*m*s/rad]."""
_ROOM: Final = 0.1
"""Half of the displayed range of a scene whose hand does not move [m or rad]."""


@dataclass(frozen=True, slots=True)
class Side:
    """One handle.

    Attributes:
        name: Name of the side, which is that of its algorithm.
        axes: Names of its axes in the rig.
        group: Name of the group that renders on them; empty where each renders by itself.
        allowance: Energy that its algorithm may give out before any came in [J].
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
    decades: float  # to either side; 0: from 0 to five times the value


@dataclass(frozen=True, slots=True)
class TouchScene:
    """A scene with two sides.

    Attributes:
        scene: Scene with both sides, to be built.
        sides: The two sides, unprotected first.
        unit: Unit of the handle's motion.
        shown: Range of positions on the page in each direction [m or rad].
        start: Position of the handle at the start [m or rad].
        solid: Solid region: [low, high] along an axis, or the outside of a box, by direction [m or rad].
        sliders: Values that the page can change besides the rate.
        path: Corners of a path that the handle is led along, in a plane [m or rad]; empty: none.
        is_display: Whether the sides are admittance displays: force in, velocity out.
    """

    scene: Scene
    sides: tuple[Side, Side]
    unit: str
    shown: tuple[tuple[float, float], ...]
    start: tuple[float, ...]
    solid: tuple[tuple[float, float], ...]
    sliders: tuple[TouchSlider, ...]
    path: tuple[tuple[float, ...], ...] = ()
    is_display: bool = False

    @property
    def is_plane(self) -> bool:
        """Whether the handle moves in a plane."""
        return len(self.shown) == 2

    @property
    def directions(self) -> tuple[str, ...]:
        """Names of the directions in which it moves."""
        return ("x", "y") if self.is_plane else ("x",)


def sliders_of(section: str, values: Parameters, names: Sequence[str], unit: str) -> tuple[TouchSlider, ...]:
    """Sliders for those of the given parameters that a section has.

    Args:
        section: Path of the section in the scene.
        values: Its parameters.
        names: Names of the parameters.
        unit: "m" or "rad".
    """
    kinds = {
        "stiffness": (stiffness_unit(unit), 2.0),
        "damping": (damping_unit(unit), 0.0),
        "mass": (mass_unit(unit), 1.0),
        "cup": (mass_unit(unit), 1.0),
    }
    return tuple(
        TouchSlider(name, f"{section}.{name}", float(getattr(values, name)), *kinds[name])
        for name in names
        if name in type(values).model_fields
    )


def pointer_hand(user: UserParameters, start: float) -> PointerHand:
    """Return the hand of a scene with the pointer as its place."""
    grip = {"stiffness": user.stiffness, "damping": user.damping} if user.stiffness else HAND
    return PointerHand(**grip, place=start)


def reach(motion: Any, rest: float, start: float) -> tuple[float, float]:
    """Range on the page in a direction [m or rad]: half as much again as the hand of the scene would move."""
    middle = rest + (motion.offset if motion else 0.0)
    half = 1.5 * motion.amplitude if motion else _ROOM
    return min(middle - half, start), max(middle + half, start)


def on_two_buses(
    scene: Scene,
    axes: Sequence[AxisScene],
    sides: tuple[Side, Side],
    groups: tuple[GroupScene, ...] = (),
    mechanisms: tuple[MechanismScene, ...] = (),
) -> Scene:
    """Return a scene with a bus for each side, whose drives and master wait long for a silent peer."""
    bus = scene.bus.model_copy(
        update={"heartbeat_timeout": _PATIENCE, "stop_cycles": max(_LOST_CYCLES, scene.bus.stop_cycles)}
    )
    log = scene.log.model_copy(update={"energy": None, "bus": None})
    return replace(
        scene, bus=bus, bus_name=sides[0].name, further_buses=(FurtherBus(name=sides[1].name),), axes=tuple(axes),
        groups=groups, mechanisms=mechanisms, log=log,
    )  # fmt: skip
