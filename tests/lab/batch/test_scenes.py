"""Batches of scene files: keys, refusals, and the same figures as one scene at a time."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from canhaptic.control.passivity import ALGORITHMS
from canhaptic.errors import CanHapticError, ParameterError
from canhaptic.lab.batch.cases import NotBatchableError, why_not_batchable
from canhaptic.lab.batch.marching import Loops, decay_per_hold, run_batch, spectral_radius
from canhaptic.lab.batch.scalar import run_scalar
from canhaptic.lab.batch.varied import scene_with
from canhaptic.lab.figures.figures import ALL, CONTINUOUS, METRICS
from canhaptic.lab.loop.axis_loop import with_algorithm
from canhaptic.scene.components import ComponentSpec
from canhaptic.scene.load import load_scene
from canhaptic.scene.models import Scene
from tests.plant.read_effect import read_effect

DEMO = Path(__file__).resolve().parents[3] / "configs" / "demo.yaml"
CYCLES = 700


def demo(algorithm: str = "unprotected", *overrides: str) -> Scene:
    scene = load_scene(DEMO, ["passivity.device_damping=0.1", "simulation.user.motion.frequency=1.5", *overrides])
    return scene.with_port(with_algorithm(scene.ports[0], algorithm))


def with_effect(scene: Scene, **values: object) -> Scene:
    axis = scene.axes[0]
    assert axis.simulation is not None
    effect = ComponentSpec(str(values["type"]), read_effect(values))  # type: ignore[arg-type]
    return replace(scene, axes=(replace(axis, simulation=replace(axis.simulation, effects=(effect,))),))


def many(scenes: int) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(11)
    return {
        "environment.stiffness": 10.0 ** rng.uniform(2.0, 3.5, scenes),
        "environment.damping": rng.uniform(0.0, 20.0, scenes),
        "bus.rate": rng.choice([500.0, 777.0, 1000.0], scenes),
        "loop.delay": rng.integers(0, 2, scenes).astype(float),
        "simulation.plant.mass": rng.uniform(0.2, 0.5, scenes),
        "simulation.user.stiffness": rng.uniform(50.0, 300.0, scenes),
        "simulation.user.motion.frequency": rng.uniform(1.0, 2.0, scenes),
        "axes.0.counts_per_unit": 10.0 ** rng.uniform(4.5, 7.0, scenes),
    }


# `a_priori_dissipation` fails by limit cycles (Fig. 5), in which a last bit of the plant decides about a start
@pytest.mark.slow
@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_a_batch_gives_the_figures_of_one_scene_at_a_time(algorithm):
    scene, varied = demo(algorithm), many(5)
    names = [*(ALL if algorithm in ("guarded", "unprotected") else METRICS)]  # with the figures of the continuous run
    found = run_batch(scene, varied, CYCLES, "python", names)
    for i in range(5):
        one = run_scalar(scene_with(scene, {key: float(values[i]) for key, values in varied.items()}), CYCLES, names)
        for name in names:
            least = 1e-10 if name in CONTINUOUS else 1e-12
            assert found[name][i] == pytest.approx(one[name], rel=1e-6, abs=least, nan_ok=True), (i, name)


@pytest.mark.slow
def test_a_wall_that_is_leaned_on_renders_its_stiffness():
    scene = demo("guarded", "simulation.user={stiffness: 0, damping: 30, push: -5}")
    found = run_batch(
        scene, {"environment.stiffness": np.array([200.0, 400.0])}, 1200, metrics=["stiffness_rendered.value"]
    )
    np.testing.assert_allclose(found["stiffness_rendered.value"], [200.0, 400.0], rtol=0.1)


def test_plants_that_do_not_fit_are_named():
    scene = with_effect(demo(), type="tremor", amplitude=1e-3)
    axis = scene.axes[0]
    assert axis.simulation is not None
    alone = replace(scene, axes=(replace(axis, simulation=replace(axis.simulation, user=None)),))
    assert "effect tremor cannot be simulated by itself" in why_not_batchable(alone)
    with pytest.raises(NotBatchableError, match="one by one with run_scalar"):
        run_batch(alone, {}, 10)


@pytest.mark.slow
def test_linear_effects_fit():
    for effect in ({"type": "viscous_friction", "damping": 0.5}, {"type": "tremor", "amplitude": 1e-3},
                   {"type": "shaft_compliance", "stiffness": 2000.0, "damping": 1.0, "load_mass": 0.1}):  # fmt: skip
        scene = with_effect(demo(), **effect)
        assert why_not_batchable(scene) == "", effect
        varied = {"simulation.plant.mass": np.array([0.2, 0.3]), "bus.rate": np.array([1000.0, 800.0])}
        found = run_batch(scene, varied, CYCLES, engine="python", metrics=["interaction", "torque_peak"])
        for i in range(2):
            one = run_scalar(scene_with(scene, {key: float(values[i]) for key, values in varied.items()}), CYCLES)
            for name, values in found.items():
                assert values[i] == pytest.approx(one[name], rel=1e-6), (effect, name)


def test_what_does_not_fit_for_other_reasons_is_named():
    scene = demo()
    assert why_not_batchable(scene) == ""
    assert "2 axes" in why_not_batchable(replace(scene, axes=scene.axes * 2))
    assert "not simulated" in why_not_batchable(replace(scene, axes=(replace(scene.axes[0], simulation=None),)))
    wall = "environment={type: hardening_wall, stiffness: 100, hardening: 1e5}"
    assert why_not_batchable(demo("internal_dissipation", wall)) == ""


@pytest.mark.parametrize(
    ("varied", "part"),
    [
        ({"environment.colour": [1.0]}, "environment.colour"),
        ({"simulation.drive.x": [1.0]}, "simulation.drive.x"),
        ({"environment.hardening": [1.0]}, "spring_damper_wall does not have"),
        ({"environment.stiffness": [1.0, -5.0]}, "stiffness"),
        ({"environment.stiffness": [1.0, float("nan")]}, "not finite"),
        ({"environment.stiffness": [1.0], "environment.damping": [1.0, 2.0]}, "shapes"),
        ({"environment.stiffness": []}, "shapes"),
        ({"simulation.plant.mass": [0.0, 1.0]}, "mass"),
    ],
)
def test_bad_values_are_refused(varied, part):
    with pytest.raises(CanHapticError, match=part):
        run_batch(demo(), {key: np.array(values) for key, values in varied.items()}, 10)


def test_bad_arguments_are_refused():
    with pytest.raises(ParameterError, match="nonsense"):
        run_batch(demo(), {}, 10, metrics=["nonsense"])
    with pytest.raises(ParameterError, match="1 cycles"):
        run_batch(demo(), {}, 1)
    with pytest.raises(ParameterError, match="fortran"):
        run_batch(demo(), {}, 10, engine="fortran")  # type: ignore[arg-type]


def test_the_radius_is_that_of_the_loop_that_is_run():
    """Growth per cycle of a loop in contact all the time, measured on the marched travel."""
    ideal = {"axes.0.counts_per_unit": 1e12, "axes.0.rated_torque": 1e-6, "axes.0.torque_limit": 1e6}
    scene = scene_with(demo("unprotected", "environment={type: viscous_medium, damping: 1}"), ideal)
    damping = np.array([50.0, 480.0, 620.0])
    radius = spectral_radius(scene, {"environment.damping": damping, "loop.delay": np.array([1.0, 0.0, 0.0])})
    for d, delay, found in zip(damping, (1, 0, 0), radius, strict=True):
        loop = Loops(0.25, 5.1, 60.0, 0.0, d)  # bearings and hand
        assert found == pytest.approx(decay_per_hold(loop, 1e-3, delay)[0], rel=1e-9)
    marched = run_batch(scene, {"environment.damping": damping[1:], "loop.delay": np.zeros(2)}, 400, metrics=["travel"])
    assert (radius[1:] > 1.0).tolist() == [False, True]
    assert (marched["travel"] > 1.0).tolist() == [False, True]


def test_a_loop_without_a_radius_is_refused():
    with pytest.raises(ParameterError, match="no linear stiffness"):
        spectral_radius(demo("unprotected", "environment={type: detents, peak: 1 N, pitch: 1 cm}"), {})
