"""Undeclared properties of the loop, derived for a simulation: timing of the holds, damping and friction of the device.

Timing follows from bus and motor, and is never better than the bit rate of the bus allows: an event RPDO acts when it
has arrived, even where the simulated bus does not model transmission time. The upper bounds of damping and dry
friction, which the hand-force certificate needs, follow from the simulated plant.

With real drives nothing is derived: `canhaptic commission` measures these values, the scene declares them, and no real
drive runs before.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Final

from canhaptic.canopen.eds import read_dictionary
from canhaptic.canopen.objects import SYNC_FRAME_COB_ID
from canhaptic.control.passivity import LoopProperties
from canhaptic.drive.axis_parameters import BusParameters
from canhaptic.drive.can.bus_budget import torque_latency, worst_frame
from canhaptic.drive.can.pdo_map import choose_map
from canhaptic.errors import CanHapticError
from canhaptic.scene.components import ComponentSpec
from canhaptic.scene.models import DISPLAY_LOOP_KEYS, AxisScene, Scene

if TYPE_CHECKING:
    from canhaptic.sim.bus.faulty_bus import BusEffects


def rests_on_hand_force(passivity: ComponentSpec) -> bool:
    """Whether an algorithm certifies torques for a hand of bounded force."""
    return getattr(passivity.parameters, "hand_force", None) is not None


GUESSES: Final = {"sync_jitter": 0.05, "torque_window": 100e-6, "current_lag": 500e-6}
"""Values assumed for an undeclared real drive (RPDO transmission is added); no real drive runs on them."""
_NEVER_ZERO: Final = ("torque_window", "current_lag")
"""Keys for which 0 does not count as declared on a real drive: no frame shows how late a torque acts."""
_MOST_JITTER: Final = 0.5
"""Lateness, as a fraction of the sample time, from which a SYNC counts as skipped."""


def undeclared(loop: LoopProperties, *, is_real: bool = False) -> list[str]:
    """Return the undeclared timing keys of an axis; with a real drive also lags that are declared as 0."""
    never_zero = _NEVER_ZERO if is_real else ()
    return [key for key in GUESSES if getattr(loop, key) is None or (key in never_zero and not getattr(loop, key))]


def with_loops(scene: Scene) -> Scene:
    """Return the scene with the undeclared loop properties of its axes; those of real drives are guesses."""
    effects = {name: scene.effects_on(name) for name, _ in scene.buses}
    jitters = {name: _jitter(effects[name], bus) for name, bus in scene.buses}
    windows = {name: _window(effects[name], bus, scene.axes_on(name)) for name, bus in scene.buses}
    axes, needed = [], list[str]()
    for axis in scene.axes:
        passivity, window = scene.passivity_of(axis), windows.get(axis.bus, 0.0)  # an unknown bus was noted before
        needed += [f"{axis.parameters.name}.passivity.{key}" for key in _needed(passivity, axis.loop)]
        found = {**GUESSES, "torque_window": GUESSES["torque_window"] + window}
        bounds: dict[str, float] = {}
        if scene.simulation is not None:
            from canhaptic.scene.far_side import device_bounds, lag_of

            if scene.simulated:
                jitter = jitters.get(axis.bus, 0.0)
                found = {"sync_jitter": jitter, "torque_window": window, "current_lag": lag_of(axis)}
            bounds = device_bounds(axis, scene.mechanisms) if rests_on_hand_force(passivity) else {}
        missing = {key: found[key] for key in undeclared(axis.loop, is_real=not scene.simulated)}
        missing |= {key: bound for key, bound in bounds.items() if getattr(axis.loop, key) is None}
        axes.append(replace(axis, loop=axis.loop.model_copy(update=missing)) if missing else axis)
    return replace(scene, axes=tuple(axes), undeclared=tuple(needed))


def _needed(passivity: ComponentSpec, loop: LoopProperties) -> list[str]:
    """Return the undeclared keys of `passivity` on which the guarantee of a real axis rests.

    They include the bound of dry friction, for which there is no guess.
    """
    known = passivity.parameters
    rests_on = GUESSES if hasattr(known, "hand_force") else DISPLAY_LOOP_KEYS if hasattr(known, "loop_gain") else ()
    is_open = loop.device_friction_bound is None and rests_on_hand_force(passivity)
    timing = [key for key in undeclared(loop, is_real=True) if key in rests_on]
    return timing + (["device_friction_bound"] if is_open else [])


def _late(effects: "BusEffects", cob_id: int | None) -> float:
    """Return the largest delay of a frame to the drive relative to another [s]; `cob_id` None: any frame."""
    if not effects.suffers("to_drive") or (cob_id and effects.ids is not None and cob_id not in effects.ids):
        return 0.0
    late = effects.jitter + (effects.delay if effects.during else 0.0)
    return late + (effects.reorder_delay if effects.reorder else 0.0)


def _jitter(effects: "BusEffects | None", bus: BusParameters) -> float:
    """Return the largest deviation of a hold from the sample time due to a late SYNC, as a fraction of it."""
    if effects is None:
        return 0.0
    late = _late(effects, SYNC_FRAME_COB_ID)
    if effects.wire_time:
        late += worst_frame() / bus.bitrate  # one that had just begun
    return min(_MOST_JITTER, late / bus.sample_time)


def _window(effects: "BusEffects | None", bus: BusParameters, axes: Sequence[AxisScene]) -> float:
    """Return the latest time after its SYNC at which a torque acts [s]."""
    if bus.rpdo == "synchronous":
        return 0.0
    window = 0.0
    if effects is not None:
        window = 2.0 * effects.delay + 2.0 * _late(effects, None)
        window += effects.jitter if effects.suffers("to_master") else 0.0
    given = [axis.parameters for axis in axes]
    try:
        maps = [choose_map(read_dictionary(axis.eds, axis.node_id), axis) for axis in given]
    except (CanHapticError, OSError):
        return window  # noted with the dictionary
    return window + torque_latency(bus, maps)
