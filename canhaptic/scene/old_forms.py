"""Configurations in the form of earlier releases, so that their logs can be compared with a scene by hash.

`tools/convert_scene.py` converts a scene of an earlier release to the names and keys of this one.
"""

from collections.abc import Collection, Iterable, Mapping
from copy import deepcopy
from typing import Any, Final, Literal, get_args

OLD_KEYS: Final = {"lead": "prediction_holds", "credit": "energy_allowance", "lost_frames": "max_consecutive_losses"}
"""Key of `passivity` in release 0.1 -> its name in release 0.2."""
OLD_ALGORITHMS: Final = {"direct": "unprotected", "original": "a_priori_dissipation"}
"""Algorithm of an axis in release 0.1 -> its name now."""
GONE_KEYS: Final = ("compiled", "prediction_holds", "may_cut")
"""Keys of `passivity` and `simulation` that were removed."""
_Plain = dict[str, Any]
"""A section of the configuration in effect, as JSON values."""
Release = Literal["0.1", "0.2"]
RELEASES: Final[tuple[Release, ...]] = get_args(Release)
"""Earlier releases whose logs can be compared with their scenes."""
_GONE: Final[dict[str, dict[str, _Plain]]] = {
    "axes": {"guarded": {"prediction_holds": 0.75}},
    "groups": {"": {"compiled": False}, "guarded": {"prediction_holds": 0.5, "may_cut": False}},
}
"""Owner -> algorithm ("" for all) -> removed key of `passivity` -> its default in release 0.2."""
_SECTION: Final = "passivity"
_SELECTOR: Final = "algorithm"


def overrides_now(overrides: Iterable[str]) -> list[str]:
    """Return overrides of an earlier release with today's names and without removed keys."""
    found = []
    for text in overrides:
        path, equals, value = text.partition("=")
        *owner, key = path.strip().split(".")
        if owner[-1:] == [_SECTION]:
            key = OLD_KEYS.get(key, key)
            value = OLD_ALGORITHMS.get(value.strip(), value) if key == _SELECTOR else value
        if not (owner[-1:] in ([_SECTION], ["simulation"]) and key in GONE_KEYS):
            found.append(f"{'.'.join((*owner, key))}{equals}{value}")
    return found


def in_form_of(
    release: Release, resolved: Mapping[str, Any], later: Collection[str], logged: Mapping[str, Any]
) -> _Plain:
    """Return a configuration in the form that an earlier release hashed for its logs.

    Args:
        release: Release that wrote the log.
        resolved: Configuration in effect, in today's form.
        later: Loop keys added after release 0.1.
        logged: Configuration in the log, for the values of removed keys; empty: their defaults.
    """
    old = deepcopy(dict(resolved))
    if old["simulation"] is not None:
        old["simulation"]["compiled"] = (logged.get("simulation") or {}).get("compiled", False)
    displays = {name for name, axis in old["axes"].items() if "admittance" in axis}
    for kind, gone in _GONE.items():
        for name, owner in old.get(kind, {}).items():
            if not displays.intersection(owner.get("axes", (name,))):
                then = logged.get(kind, {}).get(name, {}).get(_SECTION, {})
                _put_gone(owner[_SECTION], gone, {OLD_KEYS.get(key, key): value for key, value in then.items()})
    return old if release == "0.2" else _in_old_names(old, later)


def _put_gone(section: _Plain, gone: Mapping[str, Mapping[str, Any]], then: Mapping[str, Any]) -> None:
    """Add the keys to a section `passivity` that its algorithm had then, in place."""
    for algorithm in ("", section[_SELECTOR]):
        section |= {key: then.get(key, default) for key, default in gone.get(algorithm, {}).items()}


def _in_old_names(old: _Plain, later: Collection[str]) -> _Plain:
    """Change a configuration to the names and keys of release 0.1, in place."""
    keys, algorithms = ({new: name for name, new in table.items()} for table in (OLD_KEYS, OLD_ALGORITHMS))
    for owner in (*old["axes"].values(), *old.get("groups", {}).values()):
        section = {keys.get(key, key): value for key, value in owner[_SECTION].items()}
        section[_SELECTOR] = algorithms.get(section[_SELECTOR], section[_SELECTOR])
        if section.get("hand_push") == section.get("hand_force"):
            section.pop("hand_push", None)
        owner[_SECTION] = section
    for axis in old["axes"].values():
        axis["loop"] = {key: value for key, value in axis["loop"].items() if key not in later}
        axis["loop"]["device_damping_bound"] = axis["loop"]["device_damping_bound"] or None
    return old
