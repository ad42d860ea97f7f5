"""The keys of a scene that may differ inside one batch, and the scene with other values at them."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Final, TypeVar

from canhaptic.drive.axis_parameters import BusParameters
from canhaptic.errors import ParameterError
from canhaptic.scene.components import ComponentSpec
from canhaptic.scene.models import AxisScene, AxisSimulation, Scene
from canhaptic.units import Parameters

_P = TypeVar("_P", bound=Parameters)

_LOOP: Final = ("moving_mass", "device_damping", "device_damping_bound")
_MOTION: Final = ("amplitude", "frequency", "phase", "offset")

BATCH_KEYS: Final[dict[str, tuple[str, ...]]] = {
    "environment": (
        "stiffness", "damping", "position", "lower", "upper", "hardening", "peak", "pitch", "friction",
        "relaxation_time",
    ),
    "passivity": (*_LOOP, "hand_force", "hand_speed", "energy_allowance", "alpha", "damping_limit"),
    "simulation.plant": ("mass", "damping", "initial_position", "initial_velocity"),
    "simulation.user": ("stiffness", "damping", "push", "rest", *(f"motion.{name}" for name in _MOTION)),
    "bus": ("rate",),
    "loop": ("delay",),
    "axes.0": ("counts_per_unit", "rated_torque", "torque_limit"),
}  # fmt: skip
"""Section -> keys; `environment.stiffness`, `bus.rate`, ... `loop.delay` is 0 or 1 and replaces `bus.rpdo`."""


def scene_with(scene: Scene, values: Mapping[str, float]) -> Scene:
    """Return a scene of one axis with other values, each validated by the model that owns it.

    Args:
        scene: Scene with one simulated axis.
        values: Key of `BATCH_KEYS` -> value in SI.

    Raises:
        ParameterError: A key that cannot vary, or a value out of its range.
    """
    axis, bus = scene.axes[0], scene.bus
    for key, value in values.items():
        section, name = split_key(key)
        if section == "bus":
            bus = BusParameters(**{**bus.model_dump(), name: value})
        elif section == "loop":
            bus = BusParameters(**{**bus.model_dump(), "rpdo": "synchronous" if value else "event"})
        else:
            axis = _axis_with(axis, section, name, value)
    derived = {"sample_time": bus.sample_time, "delay": bus.delay, **_of_axis(axis)}
    axis = replace(axis, loop=_with(axis.loop, **derived))
    return replace(scene, bus=bus, axes=(axis, *scene.axes[1:]))


def split_key(key: str) -> tuple[str, str]:
    """Return (section, name) of a key that may vary.

    Raises:
        ParameterError: It may not.
    """
    for section, names in BATCH_KEYS.items():
        name = key.removeprefix(f"{section}.")
        if name != key and name in names:
            return section, name
    known = ", ".join(f"{section}.{{{', '.join(names)}}}" for section, names in BATCH_KEYS.items())
    raise ParameterError(
        f"varied: got key {key!r}, expected one of {known}; run scenes that differ in other keys one by one"
    )


def _axis_with(axis: AxisScene, section: str, name: str, value: float) -> AxisScene:
    if section == "environment":
        return replace(axis, environment=_typed_with(axis.environment, name, value))
    if section == "passivity":
        if name in _LOOP:
            return replace(axis, loop=_with(axis.loop, **{name: value}))
        return replace(axis, passivity=_typed_with(axis.passivity, name, value))
    if section == "axes.0":
        return replace(axis, parameters=_with(axis.parameters, **{name: value}))
    simulation = axis.simulation
    if simulation is None:
        raise ParameterError(f"varied: got {section}.{name} for an axis that is not simulated; add `simulation`")
    return replace(axis, simulation=_simulation_with(simulation, section, name, value))


def simulation_with(simulation: AxisSimulation, values: Mapping[str, float]) -> AxisSimulation:
    """Return a simulation with other values at keys under `simulation.`."""
    for key, value in values.items():
        simulation = _simulation_with(simulation, *split_key(key), value)
    return simulation


def _simulation_with(simulation: AxisSimulation, section: str, name: str, value: float) -> AxisSimulation:
    if section == "simulation.plant":
        return replace(simulation, plant=_with(simulation.plant, **{name: value}))
    user, motion = simulation.user, name.removeprefix("motion.")
    if user is None:
        raise ParameterError(f"varied: got {section}.{name}, but the scene has no hand; add simulation.user")
    if motion == name:
        return replace(simulation, user=_with(user, **{name: value}))
    if user.motion is None:
        raise ParameterError(f"varied: got {section}.{name}, but the user has no motion; add simulation.user.motion")
    return replace(simulation, user=_with(user, motion=_with(user.motion, **{motion: value})))


def _of_axis(axis: AxisScene) -> dict[str, Any]:
    rated = axis.parameters.rated_torque
    return {
        "encoder_count": 1.0 / axis.parameters.counts_per_unit,
        "torque_limit": axis.parameters.torque_limit,
        **({} if rated is None else {"torque_quantum": rated / 1000.0}),
    }


def _typed_with(typed: ComponentSpec, name: str, value: float) -> ComponentSpec:
    if name not in type(typed.parameters).model_fields:
        raise ParameterError(f"varied: got {name}, which {typed.name} does not have; leave it out")
    return ComponentSpec(typed.name, _with(typed.parameters, **{name: value}))


def _with(model: _P, **values: Any) -> _P:
    """Return a model with other values, validated."""
    changed = {name: getattr(model, name) for name in type(model).model_fields}
    return type(model)(**{**changed, **values})
