"""Whole runs, interpreted and compiled, against holds called one by one."""

import sys

import numpy as np
import pytest

from canhaptic.errors import ParameterError
from canhaptic.sim.plant.plant import Plant, PlantParameters
from tests.plant.plant_scenes import MS, make_plant, run
from tools.bench.plant_truth import chaotic
from tools.bench.plants.random_scenes import random_scene

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
    with pytest.raises(ParameterError, match="inside a sample time"):
        plant.run(TORQUES)


def compiled(*effects):
    pytest.importorskip("numba", reason="the extra `fast` is not installed")
    interpreted = make_plant(*effects)
    plant = Plant(
        interpreted.parameters, interpreted.user, interpreted.effects, MS, 1, interpreted.accuracy, compiled=True
    )
    return interpreted, plant


@pytest.mark.slow  # 6 s of a processor, most of it compilation
def test_compiled_holds_agree_with_interpreted_ones():
    """Without events to 1e-12; a rounding may move an event by one tick, 6e-11 s, whose effect is below 1e-11 m.

    One test for all scenes, so that one process compiles. Backlash is chaotic: it is compared before it has forgotten.
    """
    for effects in SCENES:
        holds = 60 if BACKLASH in effects else len(TORQUES)
        interpreted, plant = compiled(*effects)
        expected, got = interpreted.run(TORQUES[:holds]), plant.run(TORQUES[:holds])
        tolerance = 1e-11 if interpreted.events else 1e-12 * np.abs(expected).max()
        assert np.abs(got - expected).max() <= tolerance, names(effects)
        assert plant.energy() == pytest.approx(interpreted.energy(), rel=1e-9, abs=1e-11), names(effects)
        assert plant.events == pytest.approx(interpreted.events, rel=0.01), names(effects)
        plant.reset()
        again = run(plant, TORQUES[:holds].tolist())[1:]
        assert again.tobytes() == got.tobytes(), names(effects)


def test_compiled_without_numba_names_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "numba", None)
    for module in ("canhaptic.sim.plant.njit_stepper", "canhaptic.kernels.compiler"):
        monkeypatch.delitem(sys.modules, module, raising=False)
    with pytest.raises(ParameterError, match=r"\[fast\]"):
        Plant(PlantParameters(mass=0.25), None, [], MS, compiled=True)


@pytest.mark.slow
def test_random_plants_interpreted_and_compiled_meet_the_same_events_and_differ_by_rounding():
    """What docs/words.md says; a scene that differs by more differs from itself with other ticks too."""
    pytest.importorskip("numba")
    for seed in range(40):
        scene = random_scene(seed)
        one, other = scene.build(), Plant(scene.plant, scene.user, scene.effects, scene.period_ns, 1, compiled=True)
        positions, compiled = one.run(np.array(scene.torques)), other.run(np.array(scene.torques))
        assert one.events == other.events
        assert np.abs(positions - compiled).max() <= 1e-9 * np.ptp(positions) or chaotic(scene)
