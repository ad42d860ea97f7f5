"""Plants with events in the loop of a batch: as the classes run them one by one; compiled and interpreted alike."""

from dataclasses import replace

import numpy as np
import pytest

from canhaptic.errors import EventLimitError
from canhaptic.lab.batch.cases import batch_case
from canhaptic.lab.batch.marching import march, run_batch
from canhaptic.lab.batch.plants import EventModes
from canhaptic.lab.batch.scalar import run_scalar
from canhaptic.lab.batch.varied import scene_with
from canhaptic.lab.figures.figures import METRICS
from canhaptic.scene.far_side import build_plant
from canhaptic.scene.load import load_scene
from canhaptic.sim.plant.stepper import EVENTS

CYCLES = 450
MOVING = ("environment.position=0.005", "simulation.user.motion.frequency=3")
STOP = "{type: hard_stop, side: upper, position: 0.02, stiffness: 1e5, damping: 50}"
FRICTION = "{type: coulomb_friction, kinetic: 0.3, static: 0.4}"
SHAFT = "{type: shaft_compliance, stiffness: 1e4, damping: 1, load_mass: 0.1}"
GRASPS = (
    "{type: grasp_change, time: 0.2, stiffness: 600, damping: 5}, "
    "{type: grasp_change, time: 0.3003, stiffness: 90, damping: 1}"
)
HOT = "{type: thermal_derating, torque_limit: 4, copper_loss: 10, thermal_resistance: 2, time_constant: 1}"
PLANTS = {
    "stop and friction": f"{STOP}, {FRICTION}",
    "backlash": f"{SHAFT}, {{type: backlash, gap: 1e-4}}",
    "current loop": "{type: current_loop, time_constant: 300 us}",
    "current loop and friction": f"{{type: current_loop, time_constant: 300 us}}, {FRICTION}",
    "two grasps and a stop": f"{GRASPS}, {STOP}",
    "Stribeck and stop": f"{{type: stribeck_friction, kinetic: 0.3, static: 0.5, stribeck_velocity: 0.01}}, {STOP}",
    "LuGre": "{type: lugre_friction, kinetic: 0.3, static: 0.5, stribeck_velocity: 0.01, bristle_stiffness: 1e4, "
    "bristle_damping: 10, viscous: 0.1}",
    "cogging, ripple, lag": "{type: cogging, amplitude: 0.3, pitch: 0.01}, "
    "{type: torque_ripple, amplitude: 0.02, pitch: 0.003}, {type: current_loop, time_constant: 300 us}",
    "encoder": "{type: encoder_noise, deviation: 1e-5}, {type: encoder_quantisation, count: 2e-5}",
    "torque": f"{{type: torque_saturation, limit: 3}}, {HOT}, {{type: torque_quantisation, quantum: 0.01}}",
    "hot and saturated": f"{HOT}, {{type: torque_saturation, limit: 3}}, {FRICTION}",
}
LAST_BIT = ("encoder", "LuGre", "Stribeck and stop", "cogging, ripple, lag")
"""Plants with functions of the C library, whose last bit may differ: the figures are then near."""


def demo(effects, *overrides, algorithm="guarded"):
    chosen = () if algorithm == "guarded" else (f"passivity={{algorithm: {algorithm}}}",)
    return load_scene("configs/demo.yaml", [f"simulation.effects=[{effects}]", *MOVING, *chosen, *overrides])


@pytest.mark.slow
@pytest.mark.parametrize("plant", PLANTS)
def test_a_batch_gives_the_figures_of_one_scene_at_a_time(plant):
    for algorithm in ("guarded", "unprotected"):
        scene = demo(PLANTS[plant], algorithm=algorithm)
        varied = {"environment.stiffness": np.array([100.0, 800.0]), "simulation.plant.mass": np.array([0.25, 0.3])}
        found = run_batch(scene, varied, CYCLES, engine="python")
        for i in range(2):
            one = run_scalar(scene_with(scene, {key: float(values[i]) for key, values in varied.items()}), CYCLES)
            for name in METRICS:
                assert found[name][i] == pytest.approx(one[name], rel=1e-6, abs=1e-9, nan_ok=True), (i, name)
            assert one["contact"] > 0.1


@pytest.mark.slow
def test_a_loop_has_the_events_of_the_plant(monkeypatch):
    made, motor = [], EventModes.motor

    def watched(modes):
        made.append(motor(modes))
        return made[-1]

    monkeypatch.setattr(EventModes, "motor", watched)
    for name in ("stop and friction", "backlash", "two grasps and a stop", "Stribeck and stop"):
        scene = demo(PLANTS[name], algorithm="unprotected")
        march(batch_case(scene, {}), 1, CYCLES, "python", ["torque_peak"])
        plant = build_plant(scene.axes[0].simulation, scene.bus.sample_time_ns)
        monkeypatch.setattr("canhaptic.lab.loop.axis_loop.build_plant", lambda *_, plant=plant: plant)
        run_scalar(scene, CYCLES)
        assert made[-1].plants[0].counts[EVENTS] == plant.events > 3, name


@pytest.mark.parametrize("engine", ["python", pytest.param("numba", marks=pytest.mark.slow)])
def test_a_plant_with_too_many_events_fails_as_it_does_one_by_one(engine):
    if engine == "numba":
        pytest.importorskip("numba")
    scene = demo("{type: hard_stop, side: upper, position: 0.02, stiffness: 1e9}", "accuracy={max_events: 1}")
    stiffness = np.array([100.0, 300.0])
    stopped: dict[int, str] = {}
    found = run_batch(scene, {"environment.stiffness": stiffness}, CYCLES, engine, stopped=stopped)
    assert sorted(stopped) == [0, 1]
    assert np.isnan(found["interaction"]).all()
    for row, value in enumerate(stiffness.tolist()):
        with pytest.raises(EventLimitError) as caught:
            run_scalar(scene_with(scene, {"environment.stiffness": value}), CYCLES)
        assert stopped[row] == str(caught.value).splitlines()[0]


def both(scene, varied, cycles=CYCLES):
    """The figures by Python and by numba."""
    return (run_batch(scene, varied, cycles, engine) for engine in ("python", "numba"))


@pytest.mark.slow
@pytest.mark.timeout(300)
@pytest.mark.campaign_but("Stribeck and stop")
@pytest.mark.parametrize("plant", PLANTS)
def test_numba_gives_the_bits_of_python_for_every_plant(plant):
    pytest.importorskip("numba")
    rng = np.random.default_rng(3)
    for algorithm in ("guarded", "unprotected", "passivity_observer, damping_limit: 20 N*s/m"):
        varied = {
            "environment.stiffness": 10.0 ** rng.uniform(1.0, 4.0, 30),
            "environment.damping": 10.0 ** rng.uniform(-1.0, 2.0, 30),
            "simulation.plant.mass": np.repeat(rng.uniform(0.2, 1.0, 6), 5),
            "simulation.user.push": np.repeat(rng.uniform(-1.0, 1.0, 6), 5),
        }
        first, second = both(demo(PLANTS[plant], algorithm=algorithm), varied)
        near = 1e-6 if plant in LAST_BIT else 0.0
        for name in METRICS:
            np.testing.assert_allclose(first[name], second[name], rtol=near, err_msg=f"{algorithm} {name}")


def test_noise_follows_the_seed_of_each_scene():
    scene = demo(PLANTS["encoder"], algorithm="unprotected")
    varied = {"environment.stiffness": np.full(3, 500.0)}
    found = run_batch(scene, varied, CYCLES, "python", ["force_ripple"], seeds=np.array([5.0, 6.0, 5.0]))
    first, second, third = found["force_ripple"].tolist()
    assert first == third != second
    axis = scene.axes[0]
    seeded = replace(scene, axes=(replace(axis, simulation=replace(axis.simulation, seed=6)),))
    assert second == pytest.approx(
        run_scalar(scene_with(seeded, {"environment.stiffness": 500.0}), CYCLES, ["force_ripple"])["force_ripple"],
        rel=1e-9,
    )
