"""Drive profiles: defaults for a drive model, which an axis selects by `drive: NAME`.

A profile is a YAML file with keys of an axis, in `configs/drives/` or, given as a path that ends in .yaml, next to the
scene. The axis's own keys win, key by key. A profile has no keys of the rig (name, node ID, dictionary, scale,
limits). A simulated drive gets the quirks of the profile too (`far_side`).
"""

from os.path import isfile
from pathlib import Path
from typing import Any, Final

from canhaptic.drive.axis_parameters import AxisParameters
from canhaptic.errors import SceneError
from canhaptic.files import read_regular, shipped
from canhaptic.scene.document import Diagnostics, MarkedMapping, SourceLocation, parse_yaml
from canhaptic.units import shown

_LARGEST: Final = 1_000_000  # [B]
_PROFILES: Final = shipped("configs") / "drives"
_OF_THE_RIG: Final = {
    *("name", "node_id", "eds", "unit", "counts_per_unit", "direction", "transmission", "rated_torque"),
    *("torque_limit", "torque_verified", "position_reference"),
}
_PROFILE_KEYS: Final = tuple(sorted(AxisParameters.model_fields.keys() - _OF_THE_RIG))
"""Keys that a profile may have."""


def _profile_names() -> list[str]:
    return sorted(path.stem for path in _PROFILES.glob("*.yaml"))


def with_profile(section: MarkedMapping, faults: Diagnostics) -> MarkedMapping:
    """Return the section of an axis completed from its profile, without the key `drive`."""
    name, at, own = section.get("drive"), section.value_at("drive"), section.without("drive")
    path = _path(name, at) if isinstance(name, str) else None
    if path is None:
        names = ", ".join(_profile_names())
        text = f"got {shown(name)}, expected one of: {names}; or the path of a drive profile of your own (.yaml)"
        faults.add(at, text)
        return own
    return own.over(_read(path, faults))


def profile_values(name: str) -> dict[str, Any]:
    """Return the keys of a profile that comes with the package.

    Raises:
        SceneError: There is none of this name, or it cannot be read.
    """
    faults = Diagnostics()
    if name not in _profile_names():
        raise SceneError([f"{name}: no such drive profile, expected one of: {', '.join(_profile_names())}"])
    profile = _read(_PROFILES / f"{name}.yaml", faults)
    faults.raise_if_any()
    return dict(profile)


def profile_of_vendor(vendor_id: int | None) -> str | None:
    """Return the name of the profile with this vendor ID (0x1018:01); None if there is none."""
    if not vendor_id:
        return None
    return next((name for name in _profile_names() if profile_values(name).get("vendor_id") == vendor_id), None)


def _path(name: str, at: SourceLocation) -> Path | None:
    if not name.endswith((".yaml", ".yml")):
        return _PROFILES / f"{name}.yaml" if name in _profile_names() else None
    path = at.folder / name
    return path if isfile(path) else None  # None for what no path can be, too


def _read(path: Path, faults: Diagnostics) -> MarkedMapping:
    """Return the keys of a profile; unknown ones are noted as faults and left out."""
    try:
        text = read_regular(path, _LARGEST).decode("utf-8")
    except (OSError, UnicodeDecodeError) as error:
        whole = SourceLocation(str(path), 0, 0, ())
        faults.add(whole, f"cannot be read ({error}); give a profile in YAML, as UTF-8")
        return MarkedMapping(whole)
    top = SourceLocation(str(path), 1, 1, ())
    value = parse_yaml(text, str(path), faults)
    profile = MarkedMapping(top) if value is None else faults.mapping(value, top, "keys of an axis")
    if profile is None:
        return MarkedMapping(top)
    faults.unknown_keys(profile, _PROFILE_KEYS)
    return profile.only(_PROFILE_KEYS)
