"""Names of the first release, replaced by the present ones with a warning; forms of earlier configurations.

Scenes, overrides, keys of a sweep and the scenes that logs keep may still have them, for one release.
"""

import warnings
from collections.abc import Collection, Iterator, Mapping
from copy import deepcopy
from multiprocessing import parent_process
from typing import Any, Final, Literal, get_args

from canhaptic.errors import OldNameWarning
from canhaptic.scene.diagnostics import Diagnostics
from canhaptic.scene.document import MarkedList, MarkedMapping

OLD_KEYS: Final = {
    "lead": "prediction_holds",
    "credit": "energy_allowance",
    "lost_frames": "max_consecutive_losses",
}
"""Key of `passivity` -> what it is called now."""
OLD_ALGORITHMS: Final = {"direct": "unprotected", "original": "a_priori_dissipation"}
"""Algorithm of one axis -> what it is called now."""
Release = Literal["0.1", "0.2"]
RELEASES: Final[tuple[Release, ...]] = get_args(Release)
"""Earlier releases whose logs are still compared with their scenes."""
_SECTION: Final = "passivity"
_SELECTOR: Final = "algorithm"


def algorithm_now(name: str, where: str) -> str:
    """Present name of an algorithm; warns about an old one.

    Args:
        name: Name as given.
        where: Place where it was given, for the warning.
    """
    if name in OLD_ALGORITHMS:
        _warn(where, f"algorithm {name!r}", OLD_ALGORITHMS[name])
    return OLD_ALGORITHMS.get(name, name)


def path_now(path: tuple[str, ...], where: str) -> tuple[str, ...]:
    """Path of a key in present names; warns about an old one."""
    if _SECTION not in path[:-1] or path[-1] not in OLD_KEYS:
        return path
    _warn(where, repr(path[-1]), OLD_KEYS[path[-1]])
    return (*path[:-1], OLD_KEYS[path[-1]])


def rename_old(scene: MarkedMapping, faults: Diagnostics) -> None:
    """Replace old keys and algorithms of a scene in place; an old key with its new one is a fault."""
    for section, is_of_axis in _sections(scene):
        outdated = OLD_KEYS.keys() & section.keys()
        taken = ""
        if outdated and section.get(_SELECTOR) == "guarded":
            taken = _declared_as_then(section, is_of_axis)
        for old in outdated:
            new, at = OLD_KEYS[old], section.keys_at[old]
            if new in section:
                faults.add(at, f"is now called {new!r}, which is given too; leave out {old!r}")
            else:
                _warn(f"{at.where}: {'.'.join(at.path)}", repr(old), new, taken)
                section.put(new, section[old], at, section.values_at[old])
            del section[old]
        name = section.get(_SELECTOR)
        if is_of_axis and isinstance(name, str):
            at = section.values_at[_SELECTOR]
            section[_SELECTOR] = algorithm_now(name, f"{at.where}: {'.'.join(at.path)}")


def _declared_as_then(section: MarkedMapping, is_of_axis: bool) -> str:
    """Declare the implicit assumptions of the first release where they are undeclared; return them in words."""
    then = {"device_damping_bound": 0.0, **({"hand_push": section.get("hand_force", 0.0)} if is_of_axis else {})}
    missing = {key: value for key, value in then.items() if key not in section and value is not None}
    for key, value in missing.items():
        section.put(key, value, section.mark, section.mark)
    return "".join(f"; {key} is needed now, and taken as {value}" for key, value in missing.items())


def _sections(scene: MarkedMapping) -> Iterator[tuple[MarkedMapping, bool]]:
    """Yields every section `passivity`, and whether its algorithm is one of an axis."""
    owners: list[tuple[object, bool]] = [(scene, True)]
    for key in ("axes", "groups"):
        entries = scene.get(key)
        owners += [(entry, key == "axes") for entry in entries] if isinstance(entries, MarkedList) else []
    for owner, is_of_axis in owners:
        section = owner.get(_SECTION) if isinstance(owner, MarkedMapping) else None
        if isinstance(section, MarkedMapping):
            yield section, is_of_axis


def in_form_of(release: Release, resolved: Mapping[str, Any], later: Collection[str]) -> dict[str, Any]:
    """Returns a configuration in effect as the logs of an earlier release have hashed it.

    Args:
        release: Release that wrote the log.
        resolved: Configuration in effect today.
        later: Keys of the loop that came after the first release.
    """
    old = deepcopy(dict(resolved))
    if old["simulation"] is not None:
        old["simulation"]["compiled"] = False
    for group in old.get("groups", {}).values():
        if not any("admittance" in old["axes"][axis] for axis in group["axes"]):
            group[_SECTION]["compiled"] = False
    return old if release == "0.2" else _in_old_names(old, later)


def _in_old_names(old: dict[str, Any], later: Collection[str]) -> dict[str, Any]:
    """Gives a configuration in effect the names and the keys of the first release, in place."""
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


def _warn(where: str, old: str, new: str, more: str = "") -> None:
    if parent_process() is None:  # what a worker of a sweep reads, its parent has read and warned of
        text = f"{where}: {old} is now called {new!r}; the old name works in this release and not in the next{more}"
        warnings.warn(text, OldNameWarning, stacklevel=2)
