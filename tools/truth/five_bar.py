"""A five-bar linkage in place of the stage of a random scene."""

import math
from typing import Any

import numpy as np

from canhaptic.control.mechanisms.five_bar import FiveBar
from canhaptic.control.mechanisms.kinematics import Limit

_LEAST_SINE = 0.15
_NEAR = 1.5
"""Times the least sine, below which a pose counts as near a singular one."""


def make_five_bar(generator: np.random.Generator, values: dict[str, Any]) -> None:
    """Makes a stage a five-bar linkage that touches a disc."""
    for axis in values["axes"]:
        limits = {"torque_limit": min(2.0, axis["torque_limit"] / 5.0), "counts_per_unit": 131_072 / (2.0 * math.pi)}
        axis.update(unit="rad", rated_torque=2.0, **limits)
        axis.pop("power_limit", None)
        if "torque_rate_limit" in axis:
            axis["torque_rate_limit"] *= 0.1
    lengths = {"base": 0.1, "proximal": 0.15, "distal": 0.2}
    inertia, damping = float(generator.uniform(1e-3, 3e-3)), float(generator.uniform(2e-4, 5e-3))
    motion = {
        name: {"amplitude": float(generator.uniform(0.02, 0.04)), "frequency": float(generator.uniform(0.6, 2.0)),
               "phase": 1.57 * place}
        for place, name in enumerate("xy")
    }  # fmt: skip
    hand = {"stiffness": float(generator.uniform(100.0, 300.0)), "damping": float(generator.uniform(2.0, 6.0))}
    mechanism = {
        "type": "five_bar", "axes": ["x", "y"], **lengths, "motor_inertia": inertia, "distal_mass": 0.04,
        "handle_mass": 0.08, "damping": damping, "initial_angles": [math.radians(115.0), math.radians(65.0)],
        "elbow_stop": {"least": 0.02, "most": 0.39, "stiffness": 2e4},
        "hand": {**hand, "rest": [0.0, 0.24], "motion": motion},
    }  # fmt: skip
    values["simulation"]["mechanisms"] = [mechanism]
    [group] = values["groups"]
    network = group["network"]
    group["kinematics"] = {
        "type": "five_bar", "base": 0.1, "proximal": [0.15, 0.15], "distal": [0.2, 0.2], "least_sine": _LEAST_SINE
    }  # fmt: skip
    group["network"] = {
        "type": "sphere", "centre": [0.0, 0.24], "radius": 0.03, "stiffness": network["stiffness"],
        "damping": network["damping"],
    }  # fmt: skip
    section = {"moving_mass": 0.9 * inertia, "device_damping_bound": 1.5 * damping + 1e-3}
    group["passivity"].update(section)
    if "device_damping" in group["passivity"]:
        group["passivity"]["device_damping"] = 0.8 * damping
    if "hand_force" in group["passivity"]:
        group["passivity"]["hand_force"] = 0.1


def turn_five_bar(generator: np.random.Generator, values: dict[str, Any], tags: set[str]) -> None:
    """Starts a five-bar in any pose, of any sides of its elbows, a third of them near a singular one; with its hand.

    The disc is near the handle, in any direction.
    """
    [mechanism], [group] = values["simulation"]["mechanisms"], values["groups"]
    kinematics = {key: value for key, value in group["kinematics"].items() if key != "type"}
    linkage, is_near = FiveBar(**kinematics), generator.random() < 1.0 / 3.0
    nearer = FiveBar(**{**kinematics, "least_sine": _NEAR * _LEAST_SINE})
    while True:
        angles = [float(angle) for angle in generator.uniform(-math.pi, math.pi, 2)]
        if linkage.pose(angles).limit == Limit.NONE and bool(nearer.pose(angles).limit) == is_near:
            break
    handle, turn = linkage.pose(angles).position, generator.uniform(-math.pi, math.pi)
    centre = [float(handle[0] + 0.04 * math.cos(turn)), float(handle[1] + 0.04 * math.sin(turn))]
    mechanism["initial_angles"] = angles
    mechanism["hand"]["rest"] = group["network"]["centre"] = centre
    tags.add("pose:near_singular" if is_near else "pose:any")
