"""Stops at random instants, and what the motors still exchange once the account has ended: nothing may be left."""

import random
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Final

from canhaptic.scene.build import Experiment
from tools.truth.scenes import TruthScene

_SHORTEST: Final = 0.1
"""Least share of its run after which a scene is stopped."""
_NONE: Final = 1e-9
"""Energy that counts as none [J]; a torque that lags goes on to fall, within the resolution of the account."""


def with_stop(scene: TruthScene) -> TruthScene:
    """Returns a scene that the operator stops at a random instant, in the middle of a motion of its hand."""
    share = random.Random(f"stop {scene.seed}").uniform(_SHORTEST, 1.0)
    return replace(scene, duration=share * scene.duration, tags=scene.tags | {"stop:random"})


def left_after(experiment: Experiment, account: Mapping[str, Any]) -> list[str]:
    """Returns a claim for each axis whose motor gave or took energy after the last hold of the account."""
    if experiment.far_side is None:
        return []
    resolution = max(port.get("energy_resolution", 0.0) for port in account["ports"].values())
    claims = []
    for axis, drive in zip(experiment.scene.axes, experiment.far_side.drives, strict=True):
        name, energy = axis.parameters.name, -drive.truth().energy.motor
        left = energy - account["truth"][name]["interaction"]
        if abs(left) > resolution + _NONE and axis.parameters.admittance is None:
            claims.append(f"{name}: {left:.3g} J after the account had ended")
    return claims
