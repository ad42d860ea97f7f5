"""Upper bounds of a simulated device's damping and dry friction, from its plant where the scene declares none.

The hand-force certificate counts on them. With real drives nothing is derived: there they are measured
(`canhaptic commission`) and declared, and without them no real drive runs (`guesses`, and the algorithm itself).
"""

from dataclasses import replace
from typing import Any, Final

from canhaptic.scene.models import AxisScene, MechanismScene, Scene

BOUNDS: Final = ("device_damping_bound", "device_friction_bound")


def rests_on_hand_force(scene: Scene, axis: AxisScene) -> bool:
    """Whether the torques of an axis are certified for a hand of bounded force."""
    return getattr(scene.passivity_of(axis).parameters, "hand_force", None) is not None


def with_device_bounds(scene: Scene) -> Scene:
    """Return the scene with the bounds of simulated devices; one that it declares is kept."""
    axes = []
    for axis in scene.axes:
        found = _bounds(scene, axis) if rests_on_hand_force(scene, axis) else {}
        missing = {key: value for key, value in found.items() if getattr(axis.loop, key) is None}
        axes.append(replace(axis, loop=axis.loop.model_copy(update=missing)) if missing else axis)
    return replace(scene, axes=tuple(axes))


def _bounds(scene: Scene, axis: AxisScene) -> dict[str, float]:
    """Upper bounds of an axis's simulated device; none for a real one, or one in another process."""
    if axis.simulation is not None:
        effects = [effect.parameters for effect in axis.simulation.effects]
        damping = axis.simulation.plant.damping + sum(_damping(effect) for effect in effects)
        return dict(zip(BOUNDS, (damping, sum(_friction(effect) for effect in effects)), strict=True))
    for of in scene.mechanisms:
        if axis.parameters.name in of.axes:
            return _bounds_of_mechanism(of, of.axes.index(axis.parameters.name))
    return {}


def _damping(effect: Any) -> float:
    """Return the largest damping of an effect on the body at the encoder; a stop's and a shaft's are not the device's.

    The bristles of LuGre friction damp as well until they slide.
    """
    kind = getattr(effect, "type", "")  # own code has none
    if kind == "viscous_friction":
        return float(effect.damping)
    return float(effect.viscous + effect.bristle_damping) if kind == "lugre_friction" else 0.0


def _friction(effect: Any) -> float:
    """Return the largest force of an effect at any speed: dry friction, cogging."""
    if getattr(effect, "type", "") == "cogging":
        return float(effect.amplitude)
    return float(max(getattr(effect, "static", 0.0), getattr(effect, "kinetic", 0.0)))


def _bounds_of_mechanism(of: MechanismScene, place: int) -> dict[str, float]:
    """The same for one motor of a mechanism: its bearing, or its guide."""
    given: Any = of.mechanism.parameters
    guide = f"_{'xy'[place]}" if of.mechanism.name == "xy_stage" else ""
    friction = getattr(given, f"friction{guide}", None)
    static = 0.0 if friction is None else float(max(friction.static, friction.kinetic))
    return dict(zip(BOUNDS, (float(getattr(given, f"damping{guide}", 0.0)), static), strict=True))
