"""The parts of the batch: flows of many plants at once."""

import numpy as np
import pytest

from canhaptic.lab.batch.plants import linear_motion
from canhaptic.lab.batch.varied import simulation_with
from canhaptic.scene.components import ComponentSpec
from canhaptic.scene.far_side import build_plant
from canhaptic.scene.models import AxisSimulation
from canhaptic.sim.drive import SimulatedDriveParameters
from canhaptic.sim.plant.plant import PlantParameters
from canhaptic.sim.plant.user import SinusoidMotion, UserParameters
from tests.plant.read_effect import read_effect


def simulation(effects=(), **user):
    typed = tuple(ComponentSpec(str(e["type"]), read_effect(e)) for e in effects)  # type: ignore[arg-type]
    hand = UserParameters(**user)
    return AxisSimulation(SimulatedDriveParameters(counts_per_unit=1.0), PlantParameters(mass=0.3), hand, typed, 0)


@pytest.mark.slow
@pytest.mark.parametrize(
    "effects", [(), ({"type": "viscous_friction", "damping": 0.7}, {"type": "tremor", "amplitude": 1e-3})]
)
def test_flows_in_arrays_are_those_of_plants_made_one_by_one(effects):
    rng, n = np.random.default_rng(4), 12
    varied = {
        "simulation.plant.mass": rng.uniform(0.01, 3.0, n),
        "simulation.plant.damping": rng.uniform(0.0, 5.0, n),
        "simulation.plant.initial_position": rng.uniform(-0.1, 0.1, n),
        "simulation.user.stiffness": 10.0 ** rng.uniform(0.0, 4.0, n),
        "simulation.user.damping": rng.uniform(0.0, 20.0, n),
        "simulation.user.push": rng.uniform(-3.0, 3.0, n),
        "simulation.user.rest": rng.uniform(-0.1, 0.1, n),
        "simulation.user.motion.frequency": rng.uniform(0.1, 20.0, n),
        "simulation.user.motion.amplitude": rng.uniform(0.0, 0.1, n),
        "simulation.user.motion.phase": rng.uniform(-3.0, 3.0, n),
        "simulation.user.motion.offset": rng.uniform(-0.1, 0.1, n),
    }
    period = np.rint(1e9 / 10.0 ** rng.uniform(1.6, 4.0, n))
    base = simulation(effects, stiffness=1.0, motion=SinusoidMotion(amplitude=0.01, frequency=1.0))
    motion = linear_motion(base, period, varied)
    for i in range(n):
        one = simulation_with(base, {key: float(values[i]) for key, values in varied.items()})
        plant = build_plant(one, int(period[i]))
        flow, start = plant.whole_flow(), plant.scene.initial_state()
        assert motion.starts[i] == pytest.approx(start, abs=1e-15)
        for row in range(len(flow) - 2):
            assert motion.flows[i, row] == pytest.approx(flow[row], rel=1e-11, abs=1e-13 * np.abs(flow[row]).max())


def test_a_flow_does_not_depend_on_the_flows_beside_it():
    mass = np.array([1e-3, 0.3, 5.0])
    user = {"stiffness": 5000.0, "damping": 1.0}
    together = linear_motion(simulation(**user), np.full(3, 1e6), {"simulation.plant.mass": mass})
    alone = linear_motion(simulation(**user), np.full(2, 1e6), {"simulation.plant.mass": mass[1:]})
    np.testing.assert_array_equal(alone.flows, together.flows[1:])
