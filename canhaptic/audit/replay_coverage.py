"""What a recording covers of its scene, so that a replay of nothing does not pass for a test.

A key leaves a trace if the master sends another frame when the key has another value. Each number that the scene
gives to environments, algorithms and torque limits is changed alone, and the recording is replayed with it.
"""

import math
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final, TypedDict

from canhaptic.errors import InputError
from canhaptic.replay import ReplayResult, replay_bus_log
from canhaptic.scene.document import Diagnostics, MarkedMapping, parse_yaml
from canhaptic.scene.load import scene_from_text
from canhaptic.scene.models import Scene
from canhaptic.scene.overrides import apply_overrides

_JUDGED: Final = {"environment", "passivity", "admittance", "torque_limit"}
"""Keys of a scene that a recording can test: they, and all below them."""
_NUMBER: Final = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)(.*)", re.DOTALL)
_OTHER_VALUES: Final = (1.25, 0.8)  # times the value; the second where the scene refuses the first


class Covered(TypedDict):
    """What a recording covers."""

    commands: dict[str, int]  # axis -> RPDOs with a torque other than zero (of a display: with a motion)
    contacts: dict[str, int]  # port -> holds in contact
    branches: dict[str, dict[str, int]]  # port -> holds booked by each branch
    certificates: dict[str, list[str]]  # port -> certificates that bounded a torque
    stop: str  # name of the way in which the run ended
    untested: list[str]  # ports whose environment and algorithm no frame shows
    untraced: list[str]  # keys that could have another value without another frame
    not_tried: list[str]  # keys for which the scene takes no other value


def covered(result: ReplayResult, scene: Scene, *, keys: bool = True, dry_run: bool = False) -> Covered:
    """Return what a replayed recording covers of its scene.

    Args:
        result: Result of the replay.
        scene: Its scene.
        keys: Whether each key is tried, at the cost of one replay for each that leaves no trace.
        dry_run: Whether the recorded run was a dry run.
    """
    ports = {port.name: result["account"]["ports"][port.name] for port in scene.ports}
    sent = result["commands"]
    found: Covered = {
        "commands": sent,
        "contacts": {name: port["contact"]["holds"] for name, port in ports.items()},
        "branches": {name: {kind: n for kind, n in port["branches"].items() if n} for name, port in ports.items()},
        "certificates": {name: list(port["certificates"]) for name, port in ports.items()},
        "stop": result["stop"],
        "untested": [name for name, port in ports.items() if not any(sent[axis] for axis in port.get("axes", [name]))],
        "untraced": [],
        "not_tried": [],
    }
    if keys and result["status"] == "identical":
        _try_keys(Path(result["recording"]), result["start"] == "sync", scene, found, dry_run=dry_run)
    return found


def _try_keys(bus_log: Path, from_sync: bool, scene: Scene, found: Covered, *, dry_run: bool) -> None:
    for path, value in _judged_keys(scene):
        for other in _others(value):
            try:
                changed = scene_from_text(
                    scene.text, scene.source, [*scene.overrides, f"{path}={other}"], allow_code=bool(scene.own_code)
                )
                replayed = replay_bus_log(bus_log, changed, from_sync=from_sync, dry_run=dry_run)
            except InputError:
                continue
            if replayed["status"] == "identical":
                found["untraced"].append(path)
            break
        else:
            found["not_tried"].append(path)


def _judged_keys(scene: Scene) -> Iterator[tuple[str, str]]:
    """Yield the path and value of each number that the scene states for what a recording can test."""
    faults = Diagnostics()
    document = parse_yaml(scene.text, scene.source, faults)
    if isinstance(document, MarkedMapping):
        apply_overrides(document, scene.overrides, faults)
        yield from _numbers(document, (), judged=False)


def _numbers(value: Any, path: Sequence[str], *, judged: bool) -> Iterator[tuple[str, str]]:
    if isinstance(value, dict):
        for key, below in value.items():
            part = f'"{key}"' if "." in str(key) else str(key)
            yield from _numbers(below, (*path, part), judged=judged or key in _JUDGED)
    elif isinstance(value, list):
        for place, below in enumerate(value):
            yield from _numbers(below, (*path, str(place)), judged=judged)
    elif judged and not isinstance(value, bool) and _NUMBER.fullmatch(str(value)):
        yield ".".join(path), str(value)


def _others(value: str) -> Iterator[str]:
    """Yield other values of a number with or without a unit, as YAML."""
    match = _NUMBER.fullmatch(value)
    assert match is not None, "only numbers are judged"  # noqa: S101
    number = float(match[1])
    for factor in _OTHER_VALUES:
        other = number * factor if number else factor
        whole = other if not number.is_integer() or "." in match[1] or "e" in match[1].lower() else math.ceil(other)
        if whole != number:
            yield f'"{whole!r}{match[2]}"' if match[2].strip() else repr(whole)


def scene_next_to(bus_log: Path) -> Path:
    """Return the scene of a recording: of the same name, else the only YAML file of its folder or of the one above.

    Raises:
        InputError: There is none, or there are several.
    """
    same = bus_log.with_suffix("").with_suffix(".yaml") if bus_log.suffix == ".gz" else bus_log.with_suffix(".yaml")
    if same.exists():
        return same
    folder = bus_log.absolute().parent
    for place in (folder, folder.parent):
        scenes = sorted(place.glob("*.yaml"))
        if len(scenes) == 1:
            return scenes[0]
        if scenes:
            names = ", ".join(scene.name for scene in scenes[:5])
            raise InputError(f"{bus_log}: got the scenes {names} in {place}; name one with --config, or {same.name}")
    raise InputError(f"{bus_log}: found no scene next to it; name it with --config, or save it as {same.name}")
