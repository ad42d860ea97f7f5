"""Plants that the benchmark moves together go where each would go alone."""

import numpy as np
import pytest

from canhaptic.errors import ParameterError
from canhaptic.sim.plant.user import SinusoidMotion, UserParameters
from tests.plant.plant_scenes import MS, make_plant
from tools.bench.plants.linear_batch import LinearBatch


def plants(count: int):
    rng = np.random.default_rng(3)
    return [
        make_plant(
            {"type": "current_loop", "time_constant": float(rng.uniform(5e-5, 1e-3))},
            user=UserParameters(
                stiffness=float(rng.uniform(50, 1000)), damping=float(rng.uniform(0, 10)),
                motion=SinusoidMotion(amplitude=0.03, frequency=float(rng.uniform(0.5, 3))),
            ),
            mass=float(rng.uniform(0.05, 1.0)),
        )
        for _ in range(count)
    ]  # fmt: skip


def test_a_batch_moves_every_plant_as_if_it_were_alone(monkeypatch):
    monkeypatch.setattr("tools.bench.plants.linear_batch._CHUNK", 4)
    alone = plants(10)
    batch = LinearBatch(plants(10))
    torques = np.random.default_rng(4).uniform(-2, 2, (200, 10))
    for plant in alone:
        plant.begin(0)
    for k, row in enumerate(torques):
        positions = batch.advance(row)
        for plant, torque in zip(alone, row.tolist(), strict=True):
            plant.advance_to((k + 1) * MS, torque)
        assert np.allclose(positions, [plant.position for plant in alone], rtol=1e-12, atol=1e-15)


def test_the_work_of_ideal_motors_is_booked():
    single = make_plant()
    batch = LinearBatch([make_plant()])
    single.begin(0)
    for k in range(100):
        single.advance_to((k + 1) * MS, 0.01 * k)
        batch.advance(np.array([0.01 * k]))
    assert batch.motor_work[0] == pytest.approx(single.energy().motor, rel=1e-12)


def test_plants_that_do_not_fit_a_batch_are_refused():
    stop = {"type": "hard_stop", "position": 0.1, "stiffness": 1e6}
    for chosen in ([], [make_plant(), make_plant(user=None)], [make_plant(stop)]):
        with pytest.raises(ParameterError, match="batch"):
            LinearBatch(chosen)
