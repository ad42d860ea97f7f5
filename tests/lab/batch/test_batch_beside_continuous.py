"""Continuous runs in arrays are those of DOP853 and of the exact machine of the simulation, for every scene."""

from typing import Any

import numpy as np
import pytest

from canhaptic.control.environments import ENVIRONMENTS
from canhaptic.lab.batch.cases import continuous_modes, why_not_continuous
from canhaptic.lab.batch.continuous_run import ReferenceState, begin_reference, follow_hold
from canhaptic.lab.batch.marching import march, reference_memory_of, run_batch
from canhaptic.lab.batch.scalar import continuous_reference, render
from canhaptic.lab.figures.figures import ALL, CONTINUOUS, METRICS, figures
from canhaptic.lab.judge.reference_model import Model
from canhaptic.lab.loop.axis_loop import environment_of, loop_case
from canhaptic.lab.reference import continuous_run
from canhaptic.registry import load
from canhaptic.scene import method
from canhaptic.sim.plant.plant import PlantParameters
from canhaptic.sim.plant.user import SinusoidMotion, UserParameters
from tests.lab.batch.loops import PLANT, in_arrays, scalar_case
from tests.lab.batch.test_scenes import demo
from tools.bench.standard_cases import loop_in_arrays, simulation_of, standard_case

USER = UserParameters(stiffness=300.0, damping=3.0, motion=SinusoidMotion(amplitude=0.03, frequency=1.0))
BASES: dict[str, dict[str, Any]] = {
    "spring_damper_wall": {"stiffness": 1.0, "damping": 1.0, "side": "above"},
    "two_sided_wall": {"stiffness": 1.0, "damping": 1.0, "lower": -1.0, "upper": 1.0},
    "damper_wall": {"damping": 1.0},
    "viscous_medium": {"damping": 1.0},
    "free_space": {},
}


def drawn(world: str, scenes: int, seed: int) -> tuple[dict[str, Any], dict[str, Any]]:
    """Returns numbers of the environment and of plant, hand and bus, of scenes at random."""
    rng = np.random.default_rng(seed)
    plant = {
        "simulation.plant.mass": rng.uniform(0.05, 2.0, scenes),
        "simulation.plant.damping": rng.uniform(0.0, 2.0, scenes),
        "simulation.plant.initial_position": rng.uniform(-0.03, 0.03, scenes),
        "simulation.plant.initial_velocity": rng.uniform(-0.5, 0.5, scenes),
        "simulation.user.stiffness": 10.0 ** rng.uniform(1.0, 3.5, scenes),
        "simulation.user.damping": rng.uniform(0.0, 8.0, scenes),
        "simulation.user.push": rng.uniform(-3.0, 3.0, scenes),
        "simulation.user.motion.frequency": rng.uniform(0.5, 6.0, scenes),
        "bus.rate": rng.choice([100.0, 1000.0, 4000.0], scenes),
    }
    places = {
        "position": rng.uniform(-0.02, 0.02, scenes),
        "lower": rng.uniform(-0.02, 0.0, scenes),
        "upper": rng.uniform(0.0, 0.02, scenes),
        "stiffness": 10.0 ** rng.uniform(1.0, 5.0, scenes),
        "damping": rng.uniform(0.5, 30.0, scenes),
    }
    model = load(ENVIRONMENTS, world, "environment").model_fields
    return {f"environment.{name}": values for name, values in places.items() if name in model}, plant


def followed(batch, scenes: int, cycles: int) -> tuple[Any, Any, Any]:
    """Returns positions and mean torques at every SYNC but the first, (cycles - 1, scenes), and variations."""
    modes = continuous_modes(batch, scenes, cycles, with_force=True, with_travel=True)
    position, torque, variation = np.empty((cycles - 1, scenes)), np.empty((cycles - 1, scenes)), np.empty(scenes)
    for i in range(scenes):
        reference, memory = ReferenceState(), reference_memory_of(modes, i)
        begin_reference(modes.settings[i], reference, memory)
        for k in range(cycles - 1):
            torque[k, i] = follow_hold(modes.settings[i], reference, memory)
            position[k, i] = memory.state[0]
        variation[i] = reference.variation
    return position, torque, variation


def of_one(numbers: dict[str, Any], prefix: str, row: int) -> dict[str, float]:
    return {k.removeprefix(prefix): float(v[row]) for k, v in numbers.items() if k.startswith(prefix)}


def check(world: str, scenes: int, cycles: int, seed: int) -> int:
    """Holds scenes at random to two references; returns how many of them are not sensitive.

    Between hard walls a rounding grows from bounce to bounce: where the two references differ from each other, no more
    than three times that is asked for.
    """
    numbers, varied = drawn(world, scenes, seed)
    kind: Any = load(ENVIRONMENTS, world, "environment")
    case = standard_case(kind(**BASES[world]), "unprotected", 1000.0, USER, plant=PLANT)
    batch = loop_in_arrays(case, PLANT, USER, numbers, varied)
    position, torque, variation = followed(batch, scenes, cycles)
    calm = 0
    for i in range(scenes):
        environment = kind(**{**BASES[world], **of_one(numbers, "environment.", i)})
        plant = PlantParameters(**of_one(varied, "simulation.plant.", i))
        hand = of_one(varied, "simulation.user.", i)
        motion = SinusoidMotion(amplitude=0.03, frequency=hand.pop("motion.frequency"))
        user, period = UserParameters(**hand, motion=motion), round(1e9 / float(varied["bus.rate"][i]))
        machine = continuous_reference(environment, simulation_of(plant, user), period, cycles)
        times = (np.arange(cycles) * period * 1e-9).tolist()
        solved = continuous_run(environment, Model(plant, user, []), times, 1e-10).position
        spread, least = np.abs(solved - machine.position).max(), 1e-8 * machine.travel
        for expected in (solved, machine.position):
            assert np.abs(position[:, i] - expected[1:]).max() <= max(least, 3.0 * spread), i
        if spread <= least:
            calm += 1
            largest = max(1e-9, np.abs(machine.torque).max())
            assert np.abs(torque[:, i] - machine.torque[1:]).max() <= 1e-5 * largest, i
            assert variation[i] == pytest.approx(machine.variation, rel=1e-5), i
    return calm


@pytest.mark.slow
@pytest.mark.parametrize("world", BASES)
def test_continuous_runs_in_arrays_are_those_of_dop853_and_of_the_exact_machine(world):
    assert check(world, 12, 500, 3) >= 10


def test_a_graze_inside_of_one_hold_is_met():
    """Thrown at a wall so that it touches and leaves between two SYNCs, where both ends lie outside."""
    wall: Any = load(ENVIRONMENTS, "spring_damper_wall", "environment")(stiffness=1e5, damping=0.0)
    plant = PlantParameters(mass=0.1, damping=0.0, initial_position=5e-3, initial_velocity=-1.0)
    user = UserParameters(push=1e-9)
    batch = loop_in_arrays(standard_case(wall, "unprotected", 50.0, user, plant=plant), plant, user, {})
    position, _, _ = followed(batch, 1, 3)
    # in contact for half a period of the spring, then back with the speed it came with
    left = 5e-3 + np.pi * np.sqrt(0.1 / 1e5)
    np.testing.assert_allclose(position[:, 0], [0.02 - left, 0.04 - left], rtol=1e-7)


LEANING = ("simulation.user={stiffness: 0, damping: 30, push: -5}", "environment.stiffness=500")
"""A hand that brings the axis to rest on the wall, so that stiffness and limit cycle are measured too."""


@pytest.mark.slow
@pytest.mark.parametrize("hand", [(), LEANING], ids=["moving", "leaning"])
@pytest.mark.parametrize("algorithm", ["unprotected", "guarded", "internal_dissipation"])
def test_every_figure_of_a_batch_is_that_of_the_comparison(algorithm, hand):
    scene, cycles = demo(algorithm, *hand), 2000 if hand else 700
    axis = scene.axes[0]
    environment = environment_of(axis)
    reference = continuous_reference(environment, method.simulation_of(axis), scene.bus.sample_time_ns, cycles)
    expected = figures(environment, render(loop_case(axis, scene), cycles), reference, scene.bus.sample_time)
    found = {name: float(v[0]) for name, v in run_batch(scene, {}, cycles, "python", list(ALL)).items()}
    names = ["exact", "device_damping", "hand_force", "hand_speed", "none"]
    assert names[int(found.pop("certificate"))] == expected["certificate"]
    assert (found.pop("diverged"), expected["diverged"]) == (0.0, None)
    for name, value in found.items():
        one, near = expected[name], 1e-5 if name in CONTINUOUS else 1e-6
        assert value == pytest.approx(np.nan if one is None else one, rel=near, abs=1e-12, nan_ok=True), name


@pytest.mark.slow
def test_a_continuous_run_does_not_depend_on_those_beside_it():
    numbers, varied = drawn("two_sided_wall", 60, 9)
    kind: Any = load(ENVIRONMENTS, "two_sided_wall", "environment")
    case = standard_case(kind(**BASES["two_sided_wall"]), "unprotected", 1000.0, USER, plant=PLANT)
    found = []
    for rows in (np.arange(60), np.arange(0, 60, 7)):
        some = ({key: values[rows] for key, values in part.items()} for part in (numbers, varied))
        batch = loop_in_arrays(case, PLANT, USER, *some)
        found.append(followed(batch, len(rows), 30)[0])
    np.testing.assert_array_equal(found[0][:, ::7], found[1])


def test_without_a_closed_form_there_is_no_figure_and_the_others_stay():
    case = in_arrays(scalar_case("detents", "unprotected"))
    assert "closed form" in why_not_continuous(case)
    found = march(case, 1, 50, "python", ["position_error.rms", "limit_cycle", "interaction"])
    assert np.isnan(found["position_error.rms"]).all()
    assert np.isnan(found["limit_cycle"]).all()
    assert np.isfinite(found["interaction"]).all()
    assert set(METRICS).isdisjoint(CONTINUOUS)


def test_scenes_too_fast_for_a_reference_have_none_and_the_others_keep_theirs():
    case = in_arrays(scalar_case("spring_damper_wall", "unprotected"), {"environment.damping": np.array([5.0, 1e7])})
    found = march(case, 2, 50, "python", ["position_error.max"])["position_error.max"]
    assert np.isfinite(found).tolist() == [True, False]
