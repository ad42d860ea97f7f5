"""Timing of the holds of a simulated scene, from bus and motor where the scene does not declare it.

Derived values are what the simulation can do, and never better than the bus allows: an event RPDO acts when it has
arrived, which the bit rate of the bus bounds, whether the simulated bus models transmission time or not. With real
drives nothing is derived: timing is measured (`canhaptic commission`) and declared, and until then no real drive runs.

Upper bounds of a simulated device's damping and dry friction, from its plant where the scene declares none.

The hand-force certificate counts on them. With real drives nothing is derived: there they are measured
(`canhaptic commission`) and declared, and without them no real drive runs (`guesses`, and the algorithm itself).
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Final

from canhaptic.canopen.eds import read_dictionary
from canhaptic.canopen.objects import SYNC_FRAME_COB_ID
from canhaptic.control.passivity.controller import LoopProperties
from canhaptic.drive.can.bus_budget import torque_latency, worst_frame
from canhaptic.drive.can.pdo_map import choose_map
from canhaptic.errors import CanHapticError
from canhaptic.scene.models import DISPLAY_LOOP_KEYS, AxisScene, NamedBus, Scene


def rests_on_hand_force(scene: Scene, axis: AxisScene) -> bool:
    """Whether the torques of an axis are certified for a hand of bounded force."""
    return getattr(scene.passivity_of(axis).parameters, "hand_force", None) is not None


def with_device_bounds(scene: Scene) -> Scene:
    """Return the scene with the bounds of simulated devices; declared bounds are kept."""
    if scene.simulation is None:
        return scene
    from canhaptic.scene.far_side import device_bounds

    axes = []
    for axis in scene.axes:
        found = device_bounds(scene, axis) if rests_on_hand_force(scene, axis) else {}
        axes.append(_with_loop(axis, {key: of for key, of in found.items() if getattr(axis.loop, key) is None}))
    return replace(scene, axes=tuple(axes))


def _with_loop(axis: AxisScene, missing: Mapping[str, float]) -> AxisScene:
    return replace(axis, loop=axis.loop.model_copy(update=dict(missing))) if missing else axis


GUESSES: Final = {"sync_jitter": 0.05, "torque_window": 100e-6, "current_lag": 500e-6}
"""Taken for real drives until it is declared, with the time that event RPDOs take; no real drive runs on them."""
_NEVER_ZERO: Final = ("torque_window", "current_lag")
"""Keys for which 0 does not count as declared on a real drive: no frame shows how late a torque acts."""
_MOST_JITTER: Final = 0.5
"""Part of a sample time: a SYNC later than that is a SYNC skipped."""


def undeclared(loop: LoopProperties, *, is_real: bool = False) -> list[str]:
    """Undeclared timing keys of an axis; with a real drive also those that are 0 where none is."""
    never_zero = _NEVER_ZERO if is_real else ()
    return [key for key in GUESSES if getattr(loop, key) is None or (key in never_zero and not getattr(loop, key))]


def with_timing(scene: Scene) -> Scene:
    """Return the scene with the timing of its axes, guessed for real drives; declared keys are kept."""
    needed = tuple(f"{axis.parameters.name}.passivity.{key}" for axis in scene.axes for key in _needed(scene, axis))
    scene = replace(scene, undeclared=needed)
    windows = {bus.name: _window(scene, bus) for bus in scene.buses}
    if any(axis.bus not in windows for axis in scene.axes):  # noted where buses are checked
        return scene
    if not scene.simulated:
        known = [{**GUESSES, "torque_window": GUESSES["torque_window"] + windows[axis.bus]} for axis in scene.axes]
    else:
        from canhaptic.scene.far_side import lag_of

        jitters = {bus.name: _jitter(scene, bus) for bus in scene.buses}
        known = [
            {"sync_jitter": jitters[axis.bus], "torque_window": windows[axis.bus], "current_lag": lag_of(axis)}
            for axis in scene.axes
        ]
    missing = [undeclared(axis.loop, is_real=not scene.simulated) for axis in scene.axes]
    found = zip(scene.axes, known, missing, strict=True)
    return replace(scene, axes=tuple(_with_loop(axis, {key: of[key] for key in keys}) for axis, of, keys in found))


def _needed(scene: Scene, axis: AxisScene) -> list[str]:
    """Keys of `passivity` on which the promise of a real axis rests, and that are not declared.

    The bound of dry friction is one: nothing can be guessed of it.
    """
    known = scene.passivity_of(axis).parameters
    rests_on = GUESSES if hasattr(known, "hand_force") else DISPLAY_LOOP_KEYS if hasattr(known, "loop_gain") else ()
    is_open = axis.loop.device_friction_bound is None and rests_on_hand_force(scene, axis)
    timing = [key for key in undeclared(axis.loop, is_real=True) if key in rests_on]
    return timing + (["device_friction_bound"] if is_open else [])


def _effects(scene: Scene, bus: NamedBus) -> Mapping[str, float]:
    """Bus effects that a scene names; empty where the bus is ideal."""
    effects = scene.bus_effects
    if effects is None or (effects.buses is not None and bus.name not in effects.buses):
        return {}
    return {name: getattr(effects, name) for name in effects.named}


def _late(scene: Scene, effects: Mapping[str, float], cob_id: int | None) -> float:
    """Largest delay of a frame to the drive relative to another [s]; `cob_id` None: any of them."""
    whole = scene.bus_effects
    if whole is None or not whole.suffers("to_drive") or (cob_id and whole.ids is not None and cob_id not in whole.ids):
        return 0.0
    late: float = effects.get("jitter", 0.0) + (effects.get("delay", 0.0) if whole.during else 0.0)
    return late + (whole.reorder_delay if "reorder" in effects else 0.0)


def _jitter(scene: Scene, bus: NamedBus) -> float:
    """Largest deviation of a hold from the sample time, as a part of it: the SYNC comes late, or not."""
    effects = _effects(scene, bus)
    late = _late(scene, effects, SYNC_FRAME_COB_ID)
    if "wire_time" in effects:
        late += worst_frame() / bus.parameters.bitrate  # one that had just begun
    return min(_MOST_JITTER, late / bus.parameters.sample_time)


def _window(scene: Scene, bus: NamedBus) -> float:
    """Latest time after its SYNC at which a torque acts [s]."""
    if bus.parameters.rpdo == "synchronous":
        return 0.0
    effects, whole = _effects(scene, bus), scene.bus_effects
    window: float = 2.0 * effects.get("delay", 0.0) + 2.0 * _late(scene, effects, None)
    if whole is not None and "jitter" in effects and whole.suffers("to_master"):
        window += whole.jitter
    try:
        maps = [
            choose_map(read_dictionary(axis.parameters.eds, axis.parameters.node_id), axis.parameters)
            for axis in scene.axes_on(bus.name)
        ]
    except (CanHapticError, OSError):
        return window  # noted with the dictionary
    return window + torque_latency(bus.parameters, maps)
