"""What changes in the run of a random scene: the grasp of its hand, a winding that gets hot, a wall that moves.

And hands that are recorded, with strokes between uneven times.

Drawn from a generator of its own, so that a seed keeps what the other modules draw for it.
"""

import math
import os
import tempfile
from pathlib import Path
from typing import Any, Final

import numpy as np

from tools.truth.five_bar import turn_five_bar

_SHARE: Final = 0.12
"""Share of the scenes in which something changes."""
_TURNED: Final = 0.6
"""Share of the five-bars that start in any pose."""


def add_changes(seed: int, values: dict[str, Any], tags: set[str], share: float = _SHARE) -> None:
    """Adds to a scene what changes in its run; changes values and tags.

    Args:
        seed: Of the scene.
        values: Changed.
        tags: Changed.
        share: Share of the scenes in which something changes.
    """
    chance = np.random.default_rng([seed, 24])
    if "group:five_bar" in tags and chance.random() < _TURNED:
        turn_five_bar(chance, values, tags)
    if chance.random() >= share:
        return
    if "groups" in values:
        if tags & {"group:xy_box", "group:stage_sphere", "group:stage_plane"}:
            _move_the_wall(chance, values["groups"][0], tags)
        return
    if values["simulation"]["user"].get("stiffness"):
        _change_the_grasp(chance, values, tags)
    if chance.random() < 0.5:
        _get_hot(chance, values, tags)


def _change_the_grasp(chance: np.random.Generator, values: dict[str, Any], tags: set[str]) -> None:
    """Lets the hand grasp up to five times anew, harder or looser, or let go."""
    times = sorted(float(chance.uniform(0.05, 0.95)) * values["duration"] for _ in range(int(chance.integers(1, 6))))
    for time in times:
        stiffness = 0.0 if chance.random() < 0.15 else _decades(chance, 30.0, 1500.0)
        grasp = {"time": time, "stiffness": stiffness, "damping": float(chance.uniform(0.0, 6.0))}
        values["simulation"]["effects"].append({"type": "grasp_change", **grasp})
    tags |= {"effect:grasp_change", "changes:grasp"}


def _get_hot(chance: np.random.Generator, values: dict[str, Any], tags: set[str]) -> None:
    """Lets the winding get so hot within the run that it gives less torque, perhaps none, and cools again."""
    effects = values["simulation"]["effects"]
    if any(effect["type"] == "thermal_derating" for effect in effects):
        return
    limit = _decades(chance, 1.0, 10.0)
    heat = _decades(chance, 100.0, 3000.0) / limit**2  # K per torque squared: from 80 K on it gives less
    effects.append(
        {"type": "thermal_derating", "torque_limit": limit, "copper_loss": 1.0, "thermal_resistance": heat,
         "time_constant": _decades(chance, 0.02, 1.0)}
    )  # fmt: skip
    tags |= {"effect:thermal_derating", "changes:winding"}


def _move_the_wall(chance: np.random.Generator, group: dict[str, Any], tags: set[str]) -> None:
    """Takes a wall that moves, from slowly to as fast as a few metres a second."""
    kept, turn = {key: group["network"][key] for key in ("stiffness", "damping")}, chance.uniform(-math.pi, math.pi)
    group["network"] = {
        "type": "moving_wall", "normal": [math.cos(turn), math.sin(turn)], "offset": float(chance.uniform(-0.02, 0.0)),
        "amplitude": _decades(chance, 1e-3, 3e-2), "frequency": _decades(chance, 0.3, 20.0), **kept,
    }  # fmt: skip
    tags -= {tag for tag in tags if tag.startswith("group:")}
    tags |= {"group:stage_moving_wall", "changes:wall"}


_RECORDED: Final = 0.08
"""Share of the hands that move in a sinusoid which are recorded instead."""


def record_the_hand(seed: int, values: dict[str, Any], tags: set[str]) -> None:
    """Takes a recorded hand in place of one that moves in a sinusoid; changes values and tags."""
    chance = np.random.default_rng([seed, 25])
    user = {} if "groups" in values else values["simulation"]["user"]
    if "motion" not in user or chance.random() >= _RECORDED:
        return
    count, reach = int(chance.integers(2, 400)), 1.5 * user["motion"]["amplitude"]
    times = np.sort(chance.uniform(0.0, values["duration"], count))
    places = chance.uniform(-reach, reach, count) if count < 40 else np.cumsum(chance.normal(0.0, 0.1 * reach, count))
    folder = Path(tempfile.gettempdir()) / f"canhaptic-hands-{os.getuid()}"  # one for all seeds and processes
    folder.mkdir(exist_ok=True)
    path = folder / f"{seed}.csv"
    rows = [f"{time!r},{place!r}" for time, place in zip(times.tolist(), places.tolist(), strict=True)]
    draft = path.with_suffix(f".{os.getpid()}")
    draft.write_text("\n".join(["time [s],position", *rows]), encoding="utf-8")
    draft.replace(path)
    user["motion"] = {"type": "recorded", "file": str(path)}
    tags -= {tag for tag in tags if tag.startswith("hand:")}
    tags.add("hand:recorded")


def _decades(chance: np.random.Generator, low: float, high: float) -> float:
    return float(f"{10.0 ** chance.uniform(math.log10(low), math.log10(high)):.4g}")
