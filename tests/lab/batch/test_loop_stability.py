"""Eigenvalues of many loops against marching them, and against the plant itself."""

import numpy as np
import pytest

from canhaptic.errors import ParameterError
from canhaptic.lab.batch.marching import Loops, decay_per_hold, loop_matrices
from canhaptic.sim.plant.plant import Plant, PlantParameters
from canhaptic.sim.plant.user import UserParameters
from tests.plant.plant_scenes import MS


@pytest.mark.parametrize("delay", [0, 1])
def test_a_loop_matrix_is_the_plant_with_its_controller(delay):
    loops = Loops(0.25, 0.1 + 3.0, 300.0, 2000.0, 10.0)
    [matrix] = loop_matrices(loops, 1e-3, delay)
    user = UserParameters(stiffness=300, damping=3)
    plant = Plant(PlantParameters(mass=0.25, damping=0.1, initial_position=0.01), user, [], MS)
    plant.begin(0)
    z = np.array([0.01, 0.0, 0.01, 0.0])[: 3 + delay]
    waiting = 0.0
    last = 0.01
    for k in range(50):
        computed = -2000.0 * plant.position - 10.0 * (plant.position - last) / 1e-3
        held, waiting = (waiting, computed) if delay else (computed, 0.0)
        last = plant.position
        plant.advance_to((k + 1) * MS, held)
        z = matrix @ z
        assert z[0] == pytest.approx(plant.position, abs=1e-14)
        assert z[1] == pytest.approx(plant.velocity, abs=1e-12)


def test_an_undamped_wall_is_never_stable_and_damping_has_its_limit():
    damping = np.array([0.0, 1.0, 100.0, 1000.0])
    radii = decay_per_hold(Loops(0.25, 0.0, 0.0, 1000.0, damping), 1e-3, 0)
    assert radii[0] > 1.0 > radii[1]
    assert radii[2] < 1.0 < radii[3]  # beyond about mass / T the backward difference destabilises


def test_a_map_without_sense_is_refused():
    for loops, sample_time, delay in (
        (Loops(0.0, 0.0, 0.0, 1.0, 0.0), 1e-3, 0),
        (Loops(1.0, 0.0, 0.0, 1.0, 0.0), 0.0, 0),
        (Loops(1.0, 0.0, 0.0, 1.0, 0.0), 1e-3, 2),
    ):
        with pytest.raises(ParameterError, match="stability of a loop"):
            decay_per_hold(loops, sample_time, delay)
