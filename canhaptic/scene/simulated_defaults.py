"""Deviations of a simulated drive that follow from the quirks of its axis.

A simulated drive inherits its axis's quirks, so that a scene for a real drive shows on the virtual bus how that
drive will behave; any key of `simulation.drive` wins.
"""

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from canhaptic.scene.document import MarkedMapping
from canhaptic.units import Unit

_MILLI: Final = 1e-3
_LARGEST_RATIO: Final = 1e9  # anything larger is a fault of the axis, noted there

_TWINS: Final[Mapping[str, Mapping[str, Any]]] = tomllib.loads(
    Path(__file__).with_name("quirk_twins.toml").read_text(encoding="utf-8")
)
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
