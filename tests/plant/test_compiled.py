"""Whole runs against holds called one by one."""

import numpy as np
import pytest

from canhaptic.errors import ParameterError
from tests.plant.plant_scenes import MS, make_plant, run

STOP = {"type": "hard_stop", "position": 0.01, "stiffness": 1e6}
DAMPED_STOP = {**STOP, "damping": 30}
COULOMB = {"type": "coulomb_friction", "kinetic": 0.3, "static": 0.5}
SHAFT = {"type": "shaft_compliance", "stiffness": 1e5, "load_mass": 0.1, "damping": 0.5}
BACKLASH = {"type": "backlash", "gap": 1e-3}
CURRENT = {"type": "current_loop", "time_constant": 5e-5}
SATURATION = {"type": "torque_saturation", "limit": 1.0}
COGGING = {"type": "cogging", "amplitude": 0.1, "pitch": 0.01}
GRASP = {"type": "grasp_change", "time": 0.0503, "stiffness": 50, "damping": 1}
SCENES = [
    [], [CURRENT], [SATURATION], [COULOMB], [STOP], [DAMPED_STOP], [COULOMB, DAMPED_STOP, CURRENT], [SHAFT, BACKLASH],
    [COGGING], [GRASP],
]  # fmt: skip
TORQUES = np.random.default_rng(5).uniform(-2.0, 2.0, 1300)


def names(effects):
    return "+".join(effect["type"] for effect in effects) or "bare"


@pytest.mark.slow_but("hard_stop0")
@pytest.mark.parametrize("effects", SCENES, ids=names)
def test_a_whole_run_is_the_same_floats_as_its_holds(effects):
    whole, single = make_plant(*effects), make_plant(*effects)
    first, rest = whole.run(TORQUES[:700]), whole.run(TORQUES[700:])
    expected = run(single, TORQUES.tolist())[1:]
    assert np.concatenate([first, rest]).tobytes() == expected.tobytes()
    assert whole.energy() == single.energy()
    assert (whole.events, whole.products) == (single.events, single.products)
    whole.advance_to(1301 * MS, 1.0)
    single.advance_to(1301 * MS, 1.0)
    assert whole.position == single.position


def test_a_run_from_inside_a_sample_time_is_refused():
    plant = make_plant()
    plant.begin(0)
    plant.advance_to(MS // 2, 0.0)
    with pytest.raises(ParameterError, match="into a sample time"):
        plant.run(TORQUES)
