"""The simulation of an axis as a scene file has it, and deviations of its drive that follow from the axis's quirks.

A simulated drive inherits its axis's quirks, so that a scene for a real drive shows on the virtual bus how that
drive will behave; any key of `simulation.drive` wins.
"""

from collections.abc import Mapping
from typing import Any, Final

from canhaptic.drive.profile.quirks import TWINS
from canhaptic.scene.document import Diagnostics, MarkedMapping
from canhaptic.scene.models import SCALING_KEYS, SIMULATION_PARTS
from canhaptic.units import Unit

_MILLI: Final = 1e-3
_LARGEST_RATIO: Final = 1e9  # anything larger is a fault of the axis, noted there


def _twin_of(axis: Mapping[str, Any]) -> dict[str, Any]:
    """Keys of the simulated drive that follow from an axis, as far as that is right.

    Args:
        axis: Its keys as the scene has them, with its profile's.
    """
    twin: dict[str, Any] = {}
    names = axis.get("quirks")
    for name in names if isinstance(names, list | tuple) else ():
        for key, value in TWINS.get(str(name), {}).items():
            twin[key] = _joined(twin.get(key), value)
    if axis.get("demand_reported") == "after":
        twin["torque_read_back"] = "after_update"
    if isinstance(axis.get("brake"), Mapping):
        twin["brake"] = axis["brake"]
    ratio = _ratio(axis.get("transmission"))
    if ratio is not None:  # 0x6076 counts the motor's torque
        twin["rated_torque_resolution"] = ratio * twin.get("rated_torque_resolution", _MILLI)
    return twin


def _ratio(written: object) -> float | None:
    """Return a transmission; None where there is none, or a wrong one, which is a fault of the axis."""
    try:
        ratio = Unit("1/m", "1").read(written)
    except ValueError:
        return None
    return ratio if isinstance(ratio, int | float) and 0.0 < ratio < _LARGEST_RATIO else None


def _joined(before: Any, value: Any) -> Any:
    if isinstance(before, list):
        return [*before, *value]
    return {**before, **value} if isinstance(before, dict) else value


def put_far_side(
    axis: MarkedMapping, name: str, simulation: MarkedMapping, moves_mechanism: bool, faults: Diagnostics
) -> None:
    """Set the simulation behind the drive of an axis, or its drive alone where that moves a mechanism."""
    parts, own = simulation.only(SIMULATION_PARTS), _own_parts(name, simulation, faults)
    for key, value in own.items():
        below = parts.get(key)
        if isinstance(value, MarkedMapping) and isinstance(below, MarkedMapping):
            value = value.over(below)
        parts.put(key, value, own.keys_at[key], own.values_at[key])
    drive = _drive(parts, axis["parameters"], faults)
    if moves_mechanism:
        axis.set("simulated_drive", drive)
        for key in own.keys() & {"plant", "user", "effects"}:
            text = f"{name!r} moves a mechanism, which has masses and hand of its own; leave it out"
            faults.add(own.keys_at[key], text)
        return
    for key in ("user", "effects", "admittance"):
        if parts.get(key) is None:
            parts = parts.without(key)
    if parts.get("plant") is None:
        parts.set("plant", MarkedMapping(parts.value_at("plant")))
    parts.set("drive", drive)
    axis.set("simulation", parts.only(SIMULATION_PARTS))


def _own_parts(name: str, simulation: MarkedMapping, faults: Diagnostics) -> MarkedMapping:
    """Return the entry of `simulation.axes` of an axis; an empty one where it has none."""
    axes, own = simulation.get("axes"), None
    if isinstance(axes, MarkedMapping):
        own = faults.section(axes, name, ", ".join(SIMULATION_PARTS))
    return MarkedMapping(simulation.mark) if own is None else own


def _drive(parts: MarkedMapping, axis: MarkedMapping, faults: Diagnostics) -> MarkedMapping:
    """Return the simulated drive's parameters; its scaling is the axis's unless it has its own."""
    written = faults.section(parts, "drive", "its parameters")
    drive = MarkedMapping(parts.value_at("drive")) if written is None else written.copy()
    for key in SCALING_KEYS:
        if key not in drive and axis.get(key) is not None:
            drive.put(key, axis[key], axis.keys_at[key], axis.values_at[key])
    for key, value in _twin_of(axis).items():
        if key not in drive:
            drive.put(key, value, axis.value_at("quirks"), axis.value_at("quirks"))
    _mirror_display(drive, axis)
    return drive


def _mirror_display(drive: MarkedMapping, axis: MarkedMapping) -> None:
    """Give the simulated drive of an admittance display the scales of its axis, unless it has its own."""
    display = axis.get("admittance")
    own = drive.get("display", MarkedMapping(drive.mark))
    if not isinstance(display, MarkedMapping) or not isinstance(own, MarkedMapping):
        return
    force = display.get("force")
    if not isinstance(force, MarkedMapping) or "per_count" not in force:
        return
    at = axis.value_at("admittance")
    scales, named = own.copy(), {f"force_{key}": force.get(key) for key in ("object", "node", "per_count")}
    named["force_offset_counts"] = force.get("offset_counts", 0.0)
    named["velocity_counts"] = display.get("velocity_counts")
    for key, value in named.items():
        if value is not None and key not in scales:
            scales.put(key, value, at, at)
    drive.put("display", scales, at, at)
