"""Deviations of a simulated drive that follow from the quirks of its axis.

A simulated drive inherits its axis's quirks, so that a scene for a real drive shows on the virtual bus how that
drive will behave; any key of `simulation.drive` wins.
"""

from collections.abc import Mapping
from typing import Any, Final

from canhaptic.scene.document import MarkedMapping
from canhaptic.units import Unit

_MILLI: Final = 1e-3
_LARGEST_RATIO: Final = 1e9  # anything larger is a fault of the axis, noted there

_TWINS: Final[Mapping[str, Mapping[str, Any]]] = {
    "rated_torque_micro": {"rated_torque_resolution": 1e-6},
    "rated_torque_absent": {"absent": ["0x6076"]},
    "rated_torque_written": {"rated_torque_stated": False},
    "torque_per_cent": {"torque_resolution": 1e-2},
    "torque_per_ten_thousand": {"torque_resolution": 1e-4},
    "max_torque_absent": {"absent": ["0x6072"]},
    "demand_absent": {"absent": ["0x6074"]},
    "slow_enable": {"enable_delay": 3.0},
    "late_following": {"follow_delay": 0.2},
    "acts_at_once": {"acts_at_once": True},
    "acts_a_sync_late": {"syncs_late": 1},
    "abort_disable_voltage": {"refused": {"0x6007": 1}},
    "abort_quick_stop": {"refused": {"0x6007": 1}},
    "manufacturer_event": {"refused": {"0x1400.2": 255}},
    "no_interpolation_period": {"absent": ["0x60C2"]},
    "sdo_size_not_indicated": {"sdo_size_indicated": False},
}
"""Quirk -> keys of `simulation.drive`."""


def _twin_of(axis: Mapping[str, Any]) -> dict[str, Any]:
    """Keys of the simulated drive that follow from an axis, as far as that is right.

    Args:
        axis: Its keys as the scene has them, with those of its profile.
    """
    twin: dict[str, Any] = {}
    names = axis.get("quirks")
    for name in names if isinstance(names, list | tuple) else ():
        for key, value in _TWINS.get(str(name), {}).items():
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


def mirror_quirks(drive: MarkedMapping, axis: MarkedMapping) -> None:
    """Add to the section of a simulated drive the keys that follow from its axis; its own keys win."""
    for key, value in _twin_of(axis).items():
        if key not in drive:
            at = axis.value_at("quirks")
            drive.put(key, value, at, at)


def _joined(before: Any, value: Any) -> Any:
    if isinstance(before, list):
        return [*before, *value]
    return {**before, **value} if isinstance(before, dict) else value
