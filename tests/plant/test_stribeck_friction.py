"""Stribeck friction: it breaks away where it must, and its error falls with the declared order through every event."""

import math
from functools import cache

import numpy as np
import pytest

from canhaptic.lab.judge.reference_model import Model
from canhaptic.lab.judge.solvers import reference
from canhaptic.sim.plant.plant import Plant
from canhaptic.sim.plant.user import SinusoidMotion, UserParameters
from tests.plant.plant_scenes import MS, largest_flow, make_plant, residual, run
from tests.plant.read_effect import read_effect

STATIC = 1.0
STRIBECK = {"type": "stribeck_friction", "kinetic": 0.5, "static": STATIC, "stribeck_velocity": 0.02}
DRAG = UserParameters(stiffness=200, damping=1, motion=SinusoidMotion(amplitude=0.02, frequency=1))
TORQUES = [0.3 * math.sin(0.3 * k) for k in range(150)]


def slider(substeps: int = 1) -> Plant:
    return make_plant(STRIBECK, user=DRAG, period=10 * MS, accuracy={"substeps": substeps})


@cache
def exact() -> np.ndarray:
    plant = slider()
    return reference(Model(plant.parameters, plant.user, plant.effects), TORQUES, plant.sample_time_ns).position


@pytest.mark.slow
def test_stick_slip_converges_with_the_declared_order():
    """Seven events in 1.5 s of sticking and slipping: 92 um at one substep of 10 ms, 4 nm at 128."""
    counts = [1, 2, 4, 8, 16, 32, 64, 128]
    errors = []
    for substeps in counts:
        plant = slider(substeps)
        errors.append(float(np.abs(run(plant, TORQUES)[1:] - exact()).max()))
        assert plant.events == 7
        assert residual(plant) <= 1e-12 * largest_flow(plant)
    fitted = -np.polyfit(np.log(counts[1:]), np.log(errors[1:]), 1)[0]
    assert abs(fitted - (read_effect(STRIBECK).order or 0)) < 0.1, errors
    assert errors[0] < 1e-4
    assert errors[-1] < 5e-9


@pytest.mark.parametrize("substeps", [1, 16])
def test_it_breaks_away_at_the_static_level_and_no_later(substeps):
    """Torque that rises 10 N/s from 0: the first motion is at 0.1 s, within one hold of 1 ms."""
    plant = make_plant(STRIBECK, user=None, accuracy={"substeps": substeps})
    positions = run(plant, [0.01 * k for k in range(130)])
    moving = np.flatnonzero(np.diff(positions))
    assert moving[0] == 101


def test_a_torque_that_settles_between_two_events_of_a_hold_is_no_division_by_zero():
    effects = [
        {"type": "hard_stop", "position": 0.0, "stiffness": 100.0},
        {"type": "coulomb_friction", "kinetic": 1.0, "static": 1.0},
        {"type": "current_loop", "time_constant": 1e-6},
        {"type": "cogging", "amplitude": 1.0, "pitch": 0.007},
        {"type": "shaft_compliance", "stiffness": 1000.0, "load_mass": 1.0},
        {"type": "backlash", "gap": 1e-6},
    ]
    plant = make_plant(*effects, user=None, period=20 * MS)
    run(plant, [1.5])
    assert residual(plant) <= 1e-12 * largest_flow(plant)
