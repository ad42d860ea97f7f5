"""The loop of the batch does what the classes of the cycle do, bit for bit, interpreted and compiled."""

import itertools
import random
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from canhaptic.control.passivity import ALGORITHMS
from canhaptic.lab.batch.marching import march
from canhaptic.lab.figures.figures import METRICS
from tests.lab.batch.loops import COUNTED, WORLDS, in_arrays, scalar_case, with_floats

CYCLES = 500
NAMES = [name for name in METRICS if name not in COUNTED]


def same(got: float, expected: float) -> bool:
    return got == expected or (np.isnan(got) and np.isnan(expected))


def differences(case, cycles=CYCLES, engine="python"):
    batch = in_arrays(case)
    found, expected = march(batch, 1, cycles, engine, NAMES), with_floats(case, batch, cycles)
    return {name: (found[name][0], expected[name]) for name in NAMES if not same(found[name][0], expected[name])}


@pytest.mark.slow_but("*-1", "guarded-0")
@pytest.mark.parametrize("delay", [0, 1])
@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_every_algorithm_is_the_scalar_class_to_the_last_bit(algorithm, delay):
    assert differences(scalar_case("spring_damper_wall", algorithm, delay=delay)) == {}


@pytest.mark.slow
@pytest.mark.parametrize("world", [world for world in WORLDS if world != "spring_damper_wall"])
def test_every_environment_is_the_scalar_class_to_the_last_bit(world):
    for algorithm in ("unprotected", "guarded"):
        assert differences(scalar_case(world, algorithm, delay=1, hand_force=2.0)) == {}


@pytest.mark.slow
def test_every_choice_of_an_algorithm_is_the_scalar_class_to_the_last_bit():
    for algorithm, chosen in (
        ("guarded", {"alpha": "200 s/m^2", "energy_allowance": 1e-3, "hand_speed": 0.5}),
        ("guarded", {"max_consecutive_losses": 1, "declared_damping": 0.1}),
        ("internal_dissipation", {"alpha": "200 s/m^2"}),
        ("a_priori_dissipation", {"alpha": "200 s/m^2", "rearm": "displacement"}),
        ("internal_dissipation", {"velocity": "windowed", "encoder_count": 1e-5}),
        ("guarded", {"max_consecutive_losses": 2, "encoder_count": 1e-5, "hand_force": 3.0}),
        ("passivity_observer", {"damping_limit": 20.0}),
        ("guarded", {"encoder_count": 1e-6, "torque_quantum": 0.01}),
        ("guarded", {"encoder_count": 1e-4, "hand_force": 5.0, "torque_quantum": 0.01}),
    ):
        assert differences(scalar_case("spring_damper_wall", algorithm, delay=1, **chosen)) == {}, algorithm


def many(algorithm, scenes=300, **named):
    rng = np.random.default_rng(7)
    numbers = {
        "environment.stiffness": 10.0 ** rng.uniform(1.0, 5.0, scenes),
        "environment.damping": 10.0 ** rng.uniform(-1.0, 2.0, scenes),
        "environment.position": rng.uniform(-0.01, 0.01, scenes),
    }
    return in_arrays(scalar_case("spring_damper_wall", algorithm, **named), numbers), numbers


def drawn(algorithm, world, seed, cycles=200):
    """A loop whose numbers are drawn at random, some of them at the edge of what a scene may ask."""
    rng = random.Random(f"{algorithm} {world} {seed}")
    values = {
        name: value * 10.0 ** rng.uniform(-1.5, 1.5) if isinstance(value, float) and value > 0.0 else value
        for name, value in WORLDS[world].items()
        if name not in ("lower", "upper", "position")
    }
    if "damping" in values:
        values["damping"] = rng.choice([values["damping"], 0.0, 1e-30, 1e6])
    named: dict[str, Any] = {
        "delay": rng.choice([0, 1]), "encoder_count": rng.choice([0.0, 1e-6, 1e-4]),
        "rate": rng.choice([100.0, 1e3, 8e3]), "torque_quantum": rng.choice([0.0, 0.01]),
    }  # fmt: skip
    if algorithm == "guarded":
        named |= {"hand_force": rng.choice([0.0, 5.0]), "alpha": rng.choice([0.0, "200 s/m^2"])}
        named |= {"max_consecutive_losses": rng.choice([0, 2]), "hand_speed": rng.choice([None, 0.5])}
    elif named["encoder_count"] and rng.random() < 0.5:
        named["velocity"] = "windowed"
    return in_arrays(scalar_case(world, algorithm, environment=values, **named))


@pytest.mark.slow  # compiles a loop for each cell
@pytest.mark.timeout(300)
@pytest.mark.campaign_but("*-spring_damper_wall", "unprotected-*", "guarded-detents")
@pytest.mark.parametrize("world", WORLDS)
@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_numba_gives_the_bits_of_python(algorithm, world):
    """Over 100 loops at random, some of which diverge; sine and exponential to their last bit."""
    pytest.importorskip("numba")
    names, near = list(METRICS), 1e-9 if world in ("detents", "viscoelastic_medium") else 0.0
    diverged = 0.0
    for seed in range(100):
        case = drawn(algorithm, world, seed)
        first, second = (march(case, 1, 200, engine, names) for engine in ("python", "numba"))
        for name in METRICS:
            np.testing.assert_allclose(second[name], first[name], rtol=near, atol=0.0, err_msg=f"{seed} {name}")
        diverged += first["diverged"][0]
    assert diverged < 100.0


@pytest.mark.slow  # compiles the loop of another algorithm
def test_what_is_no_number_ends_a_compiled_loop_as_it_ends_an_interpreted_one():
    pytest.importorskip("numba")
    case, _ = many("unprotected", 4)
    for stiffness, start in itertools.product((1e300, 1e3), (np.nan, np.inf, -np.inf, -1e-310, 5e-324, -0.0, -1e200)):
        starts = case.linear.starts.copy()
        starts[:, 0] = start
        numbers = {**case.numbers, "environment.stiffness": np.full(4, stiffness)}
        spoilt = replace(case, numbers=numbers, linear=case.linear._replace(starts=starts))
        first, second = (march(spoilt, 4, 20, engine, list(METRICS)) for engine in ("python", "numba"))
        for name in METRICS:
            np.testing.assert_array_equal(first[name], second[name], err_msg=f"{stiffness} {start} {name}")
        if not abs(start) < 1.0:
            assert first["diverged"].all()
            assert (first["cycles"] <= 1.0).all()


@pytest.mark.slow
def test_a_scene_does_not_depend_on_the_scenes_beside_it(monkeypatch):
    case, numbers = many("guarded", 40, delay=1)
    whole = march(case, 40, 200, "python", list(METRICS))
    for chosen in (slice(0, 40, 7), slice(39, None, -3)):
        rows = np.arange(40)[chosen]
        part = in_arrays(
            scalar_case("spring_damper_wall", "guarded", delay=1), {name: v[rows] for name, v in numbers.items()}
        )
        found = march(part, len(rows), 200, "python", list(METRICS))
        for name in METRICS:
            np.testing.assert_array_equal(found[name], whole[name][rows], err_msg=name)
    monkeypatch.setattr("canhaptic.lab.batch.marching._MOST", 16)
    found = march(case, 40, 200, "python", list(METRICS))
    for name in METRICS:
        np.testing.assert_array_equal(found[name], whole[name], err_msg=name)


@pytest.mark.parametrize("engine", ["python", pytest.param("numba", marks=pytest.mark.slow)])
def test_the_figures_of_a_scene_that_diverges_are_those_until_it_did(engine):
    if engine == "numba":
        pytest.importorskip("numba")
    damping = np.array([1.0, 2000.0, 4000.0, 3.0])  # a sampled damper of more than 2 m / T diverges
    batch = in_arrays(scalar_case("viscous_medium", "unprotected"), {"environment.damping": damping})
    found = march(batch, 4, 400, engine, list(METRICS))
    assert found["diverged"].tolist() == [0.0, 1.0, 1.0, 0.0]
    for i, d in enumerate(damping.tolist()):
        one = scalar_case("viscous_medium", "unprotected", environment={"damping": d})
        cycles = int(found["cycles"][i])
        assert (cycles == 400) == (i in (0, 3))
        expected = with_floats(one, in_arrays(one), cycles)
        for name in NAMES:
            assert same(found[name][i], expected[name]), (i, name)
        if cycles < 400:  # and not a cycle earlier
            assert with_floats(one, in_arrays(one), cycles - 1)["travel"] < 2e3 < 2.0 * expected["travel"]
