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


def left_after(experiment: Experiment, account: Mapping[str, Any]) -> dict[str, float]:
    """Returns what went into each motor after the last hold of the account [J]; of a display, what came by its sensor.

    Negative is energy that a person was given, which no account holds.
    """
    far_side, truth = experiment.far_side, account["truth"]
    drives = () if far_side is None else far_side.drives
    names = [axis.parameters.name for axis in experiment.scene.axes]
    return {
        name: -drive.truth().energy.motor - truth[name]["interaction"]
        for name, drive in zip(names, drives, strict=False)
    }


def claims_after(experiment: Experiment, account: Mapping[str, Any], left: Mapping[str, float]) -> list[str]:
    """Returns a claim for each axis of a run that the operator stopped whose motor went on to exchange energy.

    The hand may go on to push a display that stands still: what it puts in is no claim, what it gets is one.
    """
    resolution = max(port.get("energy_resolution", 0.0) for port in account["ports"].values()) + _NONE
    displays = {axis.parameters.name for axis in experiment.scene.axes if axis.parameters.admittance is not None}
    return [
        f"{name}: {energy:.3g} J after the account had ended"
        for name, energy in left.items()
        if energy < -resolution or (energy > resolution and name not in displays)
    ]


def promises_broken_after(experiment: Experiment, account: Mapping[str, Any]) -> list[str]:
    """Returns a claim for each port that is called passive and had given energy out when its motors were off."""
    drives = () if experiment.far_side is None else experiment.far_side.drives
    axes = dict(zip((axis.parameters.name for axis in experiment.scene.axes), drives, strict=False))
    claims = []
    for name, port in account["ports"].items():
        energies = [axes[of].truth().energy for of in port.get("axes", [name]) if of in axes]
        at_motor = port.get("supplied", 0.0) - sum(energy.motor for energy in energies)
        sums = {"passive": at_motor, "passive_at_handle": at_motor + sum(energy.dissipated for energy in energies)}
        floor = -port.get("energy_resolution", 0.0) - port.get("energy_allowance", 0.0) - _NONE
        claims += [
            f"{name}: {word} yes, {energy:.3g} J when its motors were off"
            for word, energy in sums.items()
            if port.get(word) == "yes" and energy < floor and energies
        ]
    return claims
