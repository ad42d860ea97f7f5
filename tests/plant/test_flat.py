"""A plant without events is written out in floats; the products of NumPy, which larger plants use, are the judge."""

import math

import numpy as np
import pytest

from canhaptic.sim.plant import plant as plant_module
from canhaptic.sim.plant.flat import FlatAutomaton
from canhaptic.sim.plant.user import SinusoidMotion, UserParameters
from tests.plant.plant_scenes import MS, USER_S, make_plant, run

SHAFT = {"type": "shaft_compliance", "stiffness": 1e4, "load_mass": 0.1, "damping": 1.0}
CURRENT = {"type": "current_loop", "time_constant": 5e-4}
PUSHING = UserParameters(
    stiffness=1e5, damping=5, push=0.4, rest=0.02, motion=SinusoidMotion(amplitude=0.01, frequency=3.0)
)
TORQUES = [2.0 * math.sin(0.37 * k) - 0.5 for k in range(1100)]
SCENES = [
    (None, ()), (UserParameters(stiffness=300, rest=0.01), ()), (USER_S, ()), (PUSHING, ()), (PUSHING, (CURRENT,)),
    (None, (SHAFT,)), (UserParameters(damping=2), (SHAFT, CURRENT)),
]  # fmt: skip


@pytest.mark.parametrize(("user", "effects"), SCENES)
def test_motion_and_energies_are_those_of_the_matrix_products(user, effects, monkeypatch):
    flat = make_plant(*effects, user=user, initial_velocity=0.3)
    monkeypatch.setattr(plant_module, "can_be_flat", lambda scene: False)
    arrays = make_plant(*effects, user=user, initial_velocity=0.3)
    assert (type(flat._machine) is FlatAutomaton, type(arrays._machine) is FlatAutomaton) == (True, False)
    positions, expected = run(flat, TORQUES), run(arrays, TORQUES)
    np.testing.assert_allclose(positions, expected, rtol=0.0, atol=2e-14 * np.abs(expected).max())
    np.testing.assert_allclose(flat.state, arrays.state, rtol=1e-10)
    most = max(map(abs, arrays.energy()))
    np.testing.assert_allclose(flat.energy(), arrays.energy(), rtol=0.0, atol=2e-13 * most)
    assert flat.products == arrays.products == len(TORQUES)


@pytest.mark.parametrize("user", [None, PUSHING])
def test_the_account_has_the_same_bits_whoever_reads_it_and_when(user):
    ends = []
    for every in (1, 7, 300, 5000):
        plant = make_plant(user=user)
        plant.begin(0)
        for k, torque in enumerate(TORQUES):
            plant.advance_to((k + 1) * MS, torque)
            if k % every == 0:
                plant.energy()
        ends.append((plant.energy(), plant.state.tolist()))
    assert ends[1:] == ends[:-1]


def test_a_stop_inside_a_sample_time_books_what_came_before():
    halting, straight = make_plant(), make_plant()
    for plant in (halting, straight):
        plant.begin(0)
    for k, torque in enumerate(TORQUES[:20]):
        halting.advance_to(k * MS + MS // 4, torque)
        for plant in (halting, straight):
            plant.advance_to((k + 1) * MS, torque)
    assert halting.position == pytest.approx(straight.position, rel=1e-12)
    assert list(halting.energy()) == pytest.approx(list(straight.energy()), rel=1e-11)
    assert halting.state[-2] == straight.state[-2] == TORQUES[19]
