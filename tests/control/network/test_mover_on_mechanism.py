"""A wall that moves, felt through a mechanism: what was certified of its mover is what is booked, in any pose."""

import math
import random

import numpy as np
import pytest

from canhaptic.control.mechanisms.five_bar import FiveBar
from canhaptic.control.multi_axis import build_group_controller
from canhaptic.control.passivity import LoopProperties
from canhaptic.control.passivity.guarded import GuardedParameters
from canhaptic.control.port_hamiltonian.shapes.moving_wall import MovingWall

T, MASS = 1e-3, 0.05


def moved(seed, delay, max_consecutive_losses):
    """Returns (least sum of h_i [J], largest torque [N*m]) of a five-bar whose motors are bare masses, unheld."""
    rng = random.Random(seed)
    kinematics = FiveBar(base=0.1, proximal=(0.15, 0.15), distal=(0.2, 0.2), least_sine=0.15)
    at, speed = np.array([2.0, 1.14]), np.array([rng.uniform(-5.0, 5.0), rng.uniform(-5.0, 5.0)])
    angle = rng.uniform(0.0, 2.0 * math.pi)
    normal = math.cos(angle), math.sin(angle)
    wall = MovingWall(
        normal=normal,
        offset=float(np.dot(normal, kinematics.pose(at.tolist()).position)) - rng.choice((0.0, 0.005, 0.01)),
        stiffness=10.0 ** rng.uniform(2, 4), damping=rng.choice((0.0, 5.0)), amplitude=0.02,
        frequency=rng.uniform(1.0, 10.0),
    )  # fmt: skip
    loop = LoopProperties(sample_time=T, delay=delay, moving_mass=MASS, device_damping_bound=0.0)
    own = GuardedParameters(hand_force=0.0, max_consecutive_losses=max_consecutive_losses)
    controller = build_group_controller(wall, kinematics, "guarded", own, [loop, loop])
    held, pending, booked, least, strongest = np.zeros(2), [np.zeros(2)] * delay, 0.0, 0.0, 0.0
    for _ in range(400):
        balance = controller.step(at.tolist(), tuple(held.tolist()))
        booked += balance.account.h_i
        least = min(least, booked)
        pending.append(np.array(balance.torques))
        held = pending.pop(0)
        strongest = max(strongest, float(abs(held).max()))
        at, speed = at + T * speed + 0.5 * T * T / MASS * held, speed + T / MASS * held
        if kinematics.pose(at.tolist()).limit:
            break
    return least, strongest


@pytest.mark.slow_for("2-1", "1-0", "0-0", "1-1", "2-0")
@pytest.mark.parametrize("max_consecutive_losses", [0, 1])
@pytest.mark.parametrize("delay", [0, 1, 2])
def test_nothing_comes_out_beyond_what_the_mover_gives_though_the_pose_changes(delay, max_consecutive_losses):
    """Booked at the pose of the end of the hold, and certified at one before, 1.1 and 4.7 uJ came out (seed 42)."""
    runs = [moved(seed, delay, max_consecutive_losses) for seed in (*range(9), 42)]
    assert min(least for least, _ in runs) >= -1e-9
    assert sum(strongest > 0.1 for _, strongest in runs) >= 3
