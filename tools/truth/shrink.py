"""Makes a scene with a false claim smaller, as long as a claim of the same kind stays false; writes it as a file."""

import copy
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import yaml

from tools.truth.judge import Outcome, judged
from tools.truth.scenes import TruthScene

_MAY_GO: Final = (
    ("simulation", "bus"), ("bus", "bitrate"), ("axes", "torque_rate_limit"), ("axes", "power_limit"),
    ("axes", "read_back"), ("axes", "quirks"), ("axes", "direction"), ("axes", "demand_reported"),
    ("simulation", "drive", "encoder"), ("simulation", "drive", "torque_limit"), ("simulation", "drive", "torque_lag"),
    ("environment", "damping"), ("passivity", "device_damping"), ("simulation", "user", "damping"),
)  # fmt: skip


def kinds(outcome: Outcome) -> set[str]:
    """Returns what is false of a run, without its numbers."""
    return {claim.split(": ", 1)[1].split(",")[0].rstrip("-.0123456789e J") for claim in outcome.false_claims}


def shrunk(scene: TruthScene, outcome: Outcome) -> tuple[TruthScene, Outcome]:
    """Returns the smallest scene found that keeps one of the false claims, and its outcome."""
    wanted = {kind.split(" ", 1)[0] for kind in kinds(outcome)}
    is_smaller = True
    while is_smaller:
        is_smaller = False
        for values in _smaller(scene.values):
            candidate = replace(scene, values=values)
            tried, found = judged(candidate)
            if found.declared and found.status != "refused" and wanted & {k.split(" ", 1)[0] for k in kinds(found)}:
                scene, outcome, is_smaller = tried, found, True
                break
    return scene, outcome


def _smaller(values: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Yields copies with one thing less."""
    for place in range(len(values["simulation"].get("effects", ()))):
        fewer = copy.deepcopy(values)
        del fewer["simulation"]["effects"][place]
        yield fewer
    for place in range(len(values["environment"]) if isinstance(values.get("environment"), list) else 0):
        fewer = copy.deepcopy(values)
        del fewer["environment"][place]
        yield fewer
    for path in _MAY_GO:
        fewer = copy.deepcopy(values)
        owner: Any = fewer
        for key in path[:-1]:
            owner = owner.get(key, {}) if isinstance(owner, dict) else {}
            owner = owner[0] if isinstance(owner, list) and len(owner) == 1 else owner
        if isinstance(owner, dict) and path[-1] in owner:
            del owner[path[-1]]
            yield fewer


def write_scene(scene: TruthScene, outcome: Outcome, folder: Path) -> Path:
    """Writes a scene as a file that `canhaptic run` takes; returns its path."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"truth_{scene.seed}.yaml"
    head = "".join(f"# {line}\n" for line in (*outcome.false_claims, f"canhaptic run {path.name} --pace free"))
    path.write_text(head + yaml.safe_dump(_plain(scene.values), sort_keys=False), encoding="utf-8")
    return path


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(key): _plain(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(inner) for inner in value]
    return value.item() if hasattr(value, "item") else value
