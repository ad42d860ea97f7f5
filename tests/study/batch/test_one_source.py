"""The form in arrays does what the scalar classes do, bit for bit, and both written forms do the same."""

import numpy as np
import pytest

from canhaptic.control.passivity import ALGORITHMS
from canhaptic.study.batch.marching import march
from canhaptic.study.batch.nodes import NotBatchableError
from canhaptic.study.figures import METRICS
from tests.study.batch.loops import COUNTED, WORLDS, in_arrays, scalar_case, with_floats

CYCLES = 500
NAMES = [name for name in METRICS if name not in COUNTED]


def same(got: float, expected: float) -> bool:
    return got == expected or (np.isnan(got) and np.isnan(expected))


def differences(case, cycles=CYCLES, engine="numpy"):
    batch = in_arrays(case)
    found, expected = march(batch, 1, cycles, engine, NAMES), with_floats(case, batch, cycles)
    return {name: (found[name][0], expected[name]) for name in NAMES if not same(found[name][0], expected[name])}


@pytest.mark.parametrize("delay", [0, 1])
@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_every_algorithm_is_the_scalar_class_to_the_last_bit(algorithm, delay):
    assert differences(scalar_case("spring_damper_wall", algorithm, delay=delay)) == {}


@pytest.mark.parametrize("world", [world for world in WORLDS if world != "spring_damper_wall"])
def test_every_environment_is_the_scalar_class_to_the_last_bit(world):
    for algorithm in ("direct", "guarded"):
        # the sine of numpy and the one of Python may differ in the last bit
        differing = differences(scalar_case(world, algorithm, delay=1, hand_force=2.0))
        assert all(np.isclose(a, b, rtol=1e-9) for a, b in differing.values())
        assert differing == {} or world == "detents"


@pytest.mark.parametrize("count", [1e-6, 1e-4])
@pytest.mark.parametrize("hand_force", [pytest.param(0.0, marks=pytest.mark.slow), 5.0])
def test_windows_over_the_encoder_are_the_scalar_class_to_the_last_bit(count, hand_force):
    for delay in (0, 1):
        case = scalar_case("spring_damper_wall", "guarded", delay=delay, encoder_count=count, hand_force=hand_force,
                           torque_quantum=0.01)  # fmt: skip
        assert differences(case) == {}


def test_every_choice_of_an_algorithm_is_the_scalar_class_to_the_last_bit():
    for algorithm, chosen in (
        ("guarded", {"alpha": "200 s/m^2", "credit": 1e-3, "hand_speed": 0.5, "lead": 0.2}),
        ("guarded", {"lost_frames": 1, "declared_damping": 0.1}),
        ("internal_dissipation", {"alpha": "200 s/m^2"}),
        ("original", {"alpha": "200 s/m^2", "rearm": "displacement"}),
        ("internal_dissipation", {"velocity": "windowed", "encoder_count": 1e-5}),
        ("passivity_observer", {"damping_limit": 20.0}),
    ):
        assert differences(scalar_case("spring_damper_wall", algorithm, delay=1, **chosen)) == {}, algorithm


def test_a_root_that_is_searched_for_is_refused_by_name():
    with pytest.raises(NotBatchableError, match="FunctionDef"):
        march(in_arrays(scalar_case("hardening_wall", "internal_dissipation")), 1, 10, "numpy", NAMES)


def many(algorithm, scenes=300, **named):
    rng = np.random.default_rng(7)
    numbers = {
        "environment.stiffness": 10.0 ** rng.uniform(1.0, 5.0, scenes),
        "environment.damping": 10.0 ** rng.uniform(-1.0, 2.0, scenes),
        "environment.position": rng.uniform(-0.01, 0.01, scenes),
    }
    return in_arrays(scalar_case("spring_damper_wall", algorithm, **named), numbers), numbers


@pytest.mark.parametrize(
    ("algorithm", "named"),
    [
        ("direct", {}),
        pytest.param("guarded", {}, marks=pytest.mark.slow),
        pytest.param("guarded", {"encoder_count": 1e-5, "delay": 1}, marks=pytest.mark.slow),
        pytest.param("original", {"delay": 1}, marks=pytest.mark.slow),
        pytest.param("internal_dissipation", {"velocity": "windowed", "encoder_count": 1e-5}, marks=pytest.mark.slow),
    ],
)
@pytest.mark.timeout(600)
def test_numba_gives_the_bits_of_numpy(algorithm, named):
    pytest.importorskip("numba")
    case, _ = many(algorithm, **named)
    first, second = (march(case, 300, 200, engine, list(METRICS)) for engine in ("numpy", "numba"))
    for name in METRICS:
        np.testing.assert_array_equal(first[name], second[name], err_msg=name)


def test_a_scene_does_not_depend_on_the_scenes_beside_it(monkeypatch):
    case, numbers = many("guarded", delay=1)
    whole = march(case, 300, 200, "numpy", list(METRICS))
    for chosen in (slice(0, 300, 7), slice(299, None, -1)):
        rows = np.arange(300)[chosen]
        part = in_arrays(
            scalar_case("spring_damper_wall", "guarded", delay=1), {name: v[rows] for name, v in numbers.items()}
        )
        found = march(part, len(rows), 200, "numpy", list(METRICS))
        for name in METRICS:
            np.testing.assert_array_equal(found[name], whole[name][rows], err_msg=name)
    monkeypatch.setattr("canhaptic.study.batch.marching.CHUNK", 64)
    found = march(case, 300, 200, "numpy", list(METRICS))
    for name in METRICS:
        np.testing.assert_array_equal(found[name], whole[name], err_msg=name)


@pytest.mark.parametrize("engine", ["numpy", "numba"])
def test_the_figures_of_a_scene_that_diverges_are_those_until_it_did(engine):
    if engine == "numba":
        pytest.importorskip("numba")
    damping = np.array([1.0, 2000.0, 4000.0, 3.0])  # a sampled damper of more than 2 m / T diverges
    batch = in_arrays(scalar_case("viscous_medium", "direct"), {"environment.damping": damping})
    found = march(batch, 4, 400, engine, list(METRICS))
    assert found["diverged"].tolist() == [0.0, 1.0, 1.0, 0.0]
    for i, d in enumerate(damping.tolist()):
        one = scalar_case("viscous_medium", "direct", environment={"damping": d})
        cycles = int(found["cycles"][i])
        assert (cycles == 400) == (i in (0, 3))
        expected = with_floats(one, in_arrays(one), cycles)
        for name in NAMES:
            assert same(found[name][i], expected[name]), (i, name)
        if cycles < 400:  # and not a cycle earlier
            assert with_floats(one, in_arrays(one), cycles - 1)["travel"] < 2e3 < 2.0 * expected["travel"]
