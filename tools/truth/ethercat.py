"""Random scenes on EtherCAT: those of the other random tests, with drifting clocks and frames that are late or lost."""

from dataclasses import replace
from typing import Any, Final

import numpy as np

from tools.on_ethercat import on_both, on_ethercat
from tools.truth.judge import Outcome, judged
from tools.truth.scenes import TruthScene, random_scene

_EACH: Final = 0.35
"""Share of the scenes that have a kind of fault."""
_APART: Final = 1_000_003  # seeds from one try to the next
_NOT_THERE: Final = frozenset(("group:xy_box", "group:five_bar", "rpdo:event", "false:hold"))
"""Tags of scenes that are drawn again: motors of one mechanism, and drives that act on arrival."""


def ethercat_scene(seed: int) -> TruthScene:
    """Returns the scene of a seed, with the faults of its line; half of the groups have an axis on a CAN bus."""
    scene = random_scene(seed)
    while scene.tags & _NOT_THERE or "mechanisms" in scene.values["simulation"]:
        scene = random_scene(scene.seed + _APART)
    chance = np.random.default_rng([seed, 61])
    tags = {tag for tag in scene.tags if not tag.startswith("timing:")}
    effects: dict[str, Any] = {"drift": float(chance.uniform(-1e-4, 1e-4))}
    for key in ("late", "lost", "answer_lost", "low_counter"):
        if chance.random() < _EACH:
            effects[key] = float(10.0 ** chance.uniform(-3.0, -1.7))
            tags.add(f"frames:{key}")
    is_split = len(scene.values["axes"]) > 1 and seed % 2 == 1
    tags |= {"bus:both"} if is_split else set()
    values = (on_both if is_split else on_ethercat)(scene.values, effects)
    return replace(scene, seed=seed, values=values, tags=frozenset(tags))


def outcome_of(seed: int) -> Outcome:
    """Returns what the run of a seed came to."""
    return judged(ethercat_scene(seed))[1]
