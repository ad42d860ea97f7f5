"""Keys of a scene that may vary inside one batch, and copies of a scene with other values at these keys."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Final

from canhaptic.drive.axis_parameters import CanBusParameters
from canhaptic.errors import ParameterError
from canhaptic.scene.components import ComponentSpec
from canhaptic.scene.models import AxisScene, AxisSimulation, Scene
from canhaptic.units import Parameters

_LOOP: Final = ("moving_mass", "device_damping", "device_damping_bound")

BATCH_KEYS: Final[dict[str, tuple[str, ...]]] = {
    "environment": (
        "stiffness", "damping", "position", "lower", "upper", "hardening", "peak", "pitch", "friction",
        "relaxation_time",
    ),
    "passivity": (*_LOOP, "hand_force", "hand_speed", "energy_allowance", "alpha", "damping_limit"),
    "simulation.plant": ("mass", "damping", "initial_position", "initial_velocity"),
    "simulation.user": ("stiffness", "damping", "push", "rest", "motion.amplitude", "motion.frequency", "motion.phase",
        "motion.offset"),
    "bus": ("rate",),
    "loop": ("delay",),
    "axes.0": ("counts_per_unit", "rated_torque", "torque_limit"),
}  # fmt: skip
"""Section -> names of its keys, such as `environment.stiffness`; `loop.delay` is 0 or 1 and replaces `bus.rpdo`."""


def scene_with(scene: Scene, values: Mapping[str, float]) -> Scene:
    """Return a scene of one axis with other values, each validated by its parameter model.

    Args:
        scene: Scene with one simulated axis.
        values: Key of `BATCH_KEYS` -> value in SI.

    Raises:
        ParameterError: A key cannot vary, or a value is out of its range.
    """
    axis, bus = scene.axes[0], scene.bus
    for key, value in values.items():
        section, name = split_key(key)
        if section == "bus":
            bus = type(bus)(**{**bus.model_dump(), name: value})
        elif section == "loop":
            bus = CanBusParameters(**{**bus.model_dump(), "rpdo": "synchronous" if value else "event"})
        elif section == "passivity" and name in _LOOP:
            axis = _changed(axis, ("loop", name), value, key)
        elif section == "axes.0":
            axis = _changed(axis, ("parameters", name), value, key)
        else:
            axis = _changed(axis, key.split("."), value, key)
    derived = {"sample_time": bus.sample_time, "delay": bus.delay, **_of_axis(axis)}
    axis = replace(axis, loop=_with(axis.loop, **derived))
    return replace(scene, bus=bus, axes=(axis, *scene.axes[1:]))


def split_key(key: str) -> tuple[str, str]:
    """Return (section, name) of a key that may vary inside a batch.

    Raises:
        ParameterError: The key cannot vary inside a batch.
    """
    for section, names in BATCH_KEYS.items():
        name = key.removeprefix(f"{section}.")
        if name != key and name in names:
            return section, name
    known = ", ".join(f"{section}.{{{', '.join(names)}}}" for section, names in BATCH_KEYS.items())
    raise ParameterError(
        f"varied: got key {key!r}, expected one of {known}; run scenes that differ in other keys one by one"
    )


def simulation_with(simulation: AxisSimulation, values: Mapping[str, float]) -> AxisSimulation:
    """Return a simulation with other values at keys under `simulation.`."""
    for key, value in values.items():
        simulation = _changed(simulation, key.split(".")[1:], value, key)
    return simulation


_ABSENT: Final = {
    "simulation": " for an axis that is not simulated; add `simulation`",
    "user": ", but the scene has no hand; add simulation.user",
    "motion": ", but the user has no motion; add simulation.user.motion",
}


def _changed(part: Any, path: Sequence[str], value: Any, key: str) -> Any:
    """Return a part of a scene with another value at a path, validated by its parameter model."""
    name, *rest = path
    if isinstance(part, ComponentSpec):
        if name not in type(part.parameters).model_fields:
            raise ParameterError(f"varied: got {name}, which {part.name} does not have; leave it out")
        return ComponentSpec(part.name, _with(part.parameters, **{name: value}))
    if rest:
        inner = getattr(part, name)
        if inner is None:
            raise ParameterError(f"varied: got {key}{_ABSENT[name]}")
        value = _changed(inner, rest, value, key)
    return _with(part, **{name: value}) if isinstance(part, Parameters) else replace(part, **{name: value})


def _of_axis(axis: AxisScene) -> dict[str, Any]:
    rated = axis.parameters.rated_torque
    return {
        "encoder_count": 1.0 / axis.parameters.counts_per_unit,
        "torque_limit": axis.parameters.torque_limit,
        **({} if rated is None else {"torque_quantum": rated / 1000.0}),
    }


def _with(model: Parameters, **values: Any) -> Any:
    """Return a model with other values, validated."""
    return type(model)(**{**{name: getattr(model, name) for name in type(model).model_fields}, **values})
