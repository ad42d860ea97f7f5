"""The continuous axis by DOP853 on textbook equations, next to the reference of `compare`."""

import numpy as np
import pytest

from canhaptic.lab.batch.scalar import continuous_reference
from canhaptic.lab.loop.axis_loop import environment_of
from canhaptic.lab.reference import continuous_motion
from canhaptic.scene.load import load_scene
from canhaptic.scene.method import simulation_of
from tests.lab.accuracy.accuracy_scenes import FOLDER

ENVIRONMENTS = {
    "spring_damper_wall": "{type: spring_damper_wall, stiffness: 100, damping: 10, position: -0.05}",
    "damper_wall": "{type: damper_wall, damping: 10, position: -0.05}",
    "two_sided_wall": "{type: two_sided_wall, stiffness: 200, damping: 3, lower: -0.02, upper: 0.01}",
    "viscous_medium": "{type: viscous_medium, damping: 4}",
    "viscoelastic_medium": "{type: viscoelastic_medium, stiffness: 200, relaxation_time: 0.1, damping: 1}",
    "coulomb_surface": "{type: coulomb_surface, friction: 1, stiffness: 500, damping: 1}",
    "free_space": "{type: free_space}",
    "detents": "{type: detents, pitch: 0.02, peak: 1}",
}


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(ENVIRONMENTS))
def test_the_continuous_axis_agrees_with_the_reference_of_compare(name):
    motion = "simulation.user.motion={amplitude: 0.15, frequency: 2}"
    changes = [f"environment={ENVIRONMENTS[name]}", "passivity={algorithm: unprotected}", motion]
    scene = load_scene(FOLDER / "paper_wall.yaml", changes)
    axis, steps, step_ns = scene.axes[0], 400, 1_000_000
    found = continuous_motion(scene, step_ns, steps)
    other = continuous_reference(environment_of(axis), simulation_of(axis), step_ns, steps + 1)
    travel = float(np.ptp(other.position))
    assert np.abs(found.position - other.position).max() < 1e-8 * travel
    mean = np.diff(found.impulse) / (step_ns * 1e-9)
    apart = np.abs(mean - other.torque[1:])  # theirs is a mean of readings: wrong by a jump where contact begins
    assert np.quantile(apart, 0.95) <= 2e-3 * np.abs(other.torque).max()
    assert apart.max() <= 0.1 * np.abs(other.torque).max()


def test_detents_act_also_on_an_axis_that_starts_in_the_middle_of_one():
    environment = "environment={type: detents, pitch: 0.02, peak: 5}"
    scene = load_scene(FOLDER / "paper_wall.yaml", [environment, "passivity={algorithm: unprotected}"])
    found = continuous_motion(scene, 1_000_000, 100)
    assert np.abs(found.position).max() < 0.005  # held in the first one
    assert np.abs(found.impulse).max() > 1e-3
