"""Effects around the exact core: their measured order is the declared one, their balance closes at any step."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from canhaptic.sim.plant.splitting import fixed_point
from tests.plant.plant_scenes import DAMPING, MASS, hand, largest_flow, make_plant, residual, run
from tests.plant.read_effect import read_effect

TORQUES = [1.5 + 0.5 * math.sin(0.1 * k) for k in range(40)]
COGGING = {"type": "cogging", "amplitude": 0.5, "pitch": 4e-3, "phase": 0.3}
RIPPLE = {"type": "torque_ripple", "amplitude": 0.3, "pitch": 4e-3, "phase": 0.3}
DRY = {"kinetic": 0.3, "static": 0.5, "stribeck_velocity": 0.05}
STRIBECK = {"type": "stribeck_friction", **DRY}
LUGRE = {"type": "lugre_friction", **DRY, "bristle_stiffness": 1e4, "bristle_damping": 20.0, "viscous": 0.4}


def cogging(y: Any, torque: float) -> tuple[float, float]:
    return -0.5 * math.sin(2 * math.pi * y[0] / 4e-3 + 0.3), 0.0


def ripple(y: Any, torque: float) -> tuple[float, float]:
    return 0.3 * torque * math.sin(2 * math.pi * y[0] / 4e-3 + 0.3), 0.0


def stribeck(y: Any, torque: float) -> tuple[float, float]:
    return -(0.3 + 0.2 * math.exp(-((y[1] / 0.05) ** 2))), 0.0  # the test only slides forward


def lugre(y: Any, torque: float) -> tuple[float, float]:
    level = 0.3 + 0.2 * math.exp(-((y[1] / 0.05) ** 2))
    rate = y[1] - 1e4 * abs(y[1]) / level * y[2]
    return -(1e4 * y[2] + 20.0 * rate + 0.4 * y[1]), rate


Force = Callable[[Any, float], tuple[float, float]]


def reference_end(force: Force) -> float:
    def rates(t: float, y: Any, torque: float) -> list[float]:
        extra, bristle = force(y, torque)
        return [y[1], (torque + hand(t, y[0], y[1]) - DAMPING * y[1] + extra) / MASS, bristle]

    state = np.array([0.0, 0.02, 0.0])
    for k, torque in enumerate(TORQUES):
        result = solve_ivp(
            rates, (k * 1e-3, (k + 1) * 1e-3), state, "LSODA", rtol=1e-12, atol=1e-15, args=(torque,), max_step=1e-4
        )
        state = result.y[:, -1]
    return float(state[0])


@pytest.mark.slow_but("effect2-*")
@pytest.mark.parametrize(
    ("effect", "force"), [(COGGING, cogging), (RIPPLE, ripple), (STRIBECK, stribeck), (LUGRE, lugre)]
)
def test_the_fitted_order_is_the_declared_order(effect, force):
    expected = reference_end(force)
    substeps = np.array([1, 2, 4, 8, 16])
    errors, order = [], read_effect(effect).order
    for count in substeps:
        plant = make_plant(effect, accuracy={"substeps": int(count)}, initial_velocity=0.02)
        errors.append(abs(run(plant, TORQUES)[-1] - expected))
        assert residual(plant) <= 1e-12 * largest_flow(plant)
    fitted = -np.polyfit(np.log(substeps), np.log(errors), 1)[0]
    assert order is not None
    assert abs(fitted - order) < 0.25, (fitted, errors)
    assert errors[0] < 0.02 * abs(expected)


def test_a_detent_and_stiction_together_hold_the_body_exactly():
    plant = make_plant(
        {**COGGING, "amplitude": 0.2}, {"type": "coulomb_friction", "kinetic": 0.3, "static": 0.5}, user=None
    )
    assert set(run(plant, [0.25] * 2000)) == {0.0}


def test_lugre_bristles_are_stable_at_one_step_a_period_for_any_stiffness():
    for stiffness in (1e4, 1e6, 1e8):
        plant = make_plant({**LUGRE, "bristle_stiffness": stiffness}, user=None)
        positions = run(plant, [0.1] * 300)
        assert (
            np.abs(positions).max() <= 20 * 0.1 / stiffness
        )  # LuGre drifts while it shakes; explicit Euler leaves every bound
        assert residual(plant) <= 1e-12 * largest_flow(plant)


@pytest.mark.slow
def test_lugre_before_sliding_is_a_spring_and_sliding_settles_at_its_steady_friction():
    plant = make_plant({**LUGRE, "stribeck_velocity": 1.0}, user=None, damping=0.0)
    positions = run(plant, [0.2 * min(1.0, k / 3000) for k in range(4000)])
    # Slow loading from rest: F = static (1 - exp(-stiffness q / static)), LuGre's spring of the first loading.
    assert positions[-1] == pytest.approx(-0.5 / 1e4 * math.log(1 - 0.2 / 0.5), rel=0.02)
    plant = make_plant({**LUGRE, "stribeck_velocity": 1e-3}, user=None, damping=0.0)
    run(plant, [0.7] * 8000)
    assert 0.4 * plant.velocity == pytest.approx(0.7 - 0.3, rel=1e-3)


class _Residual:
    def __init__(self, residual):
        self.residual = residual


@pytest.mark.parametrize("slope", [-0.3, -1.0, -50.0, -1e6])
def test_the_scalar_solver_finds_the_root_of_any_falling_residual(slope):
    root, _, found = fixed_point(_Residual(lambda x: slope * (x - 0.37) + 0.1 * math.tanh(-x + 0.37)), 0.0, -1.0)
    assert found
    assert root == pytest.approx(0.37, rel=1e-12)


def test_the_scalar_solver_returns_the_place_of_a_jump():
    root, _, found = fixed_point(_Residual(lambda x: (0.2 if x < 0.37 else -0.2) - 1e-3 * x), 0.0, -1.0)
    assert not found
    assert root == pytest.approx(0.37, rel=1e-9)


@pytest.mark.slow
def test_a_ripple_of_a_torque_that_lags_is_of_second_order_in_the_substep():
    effects = (
        {"type": "torque_ripple", "amplitude": 0.2, "pitch": 2e-3},
        {"type": "current_loop", "time_constant": 4e-4},
    )
    torques = [3.0 * (-1) ** (k // 5) for k in range(100)]
    exact = run(make_plant(*effects, accuracy={"substeps": 64}), torques)
    coarse, fine = (np.abs(run(make_plant(*effects, accuracy={"substeps": n}), torques) - exact).max() for n in (1, 4))
    assert fine < coarse / 10.0  # with any other mean torque of a substep 4 to 8
