"""`accuracy: {auto: X}`: chosen at build time, the same every time, kept in the log; and the price of a run."""

import json
from pathlib import Path

import h5py
import pytest

from canhaptic.cycle import run
from canhaptic.errors import InputError, SceneError
from canhaptic.lab.judge.reference_model import difference
from canhaptic.lab.judge.solvers import reference
from canhaptic.lab.reference import textbook_model
from canhaptic.lab.studies.accuracy.loop_sensitivity import holds_of
from canhaptic.lab.studies.accuracy.plant_solvers import ladder
from canhaptic.lab.studies.accuracy.study import with_chosen_accuracy
from canhaptic.scene.build import build
from canhaptic.scene.far_side import build_plant
from canhaptic.scene.load import load_scene
from canhaptic.scene.method import PlantPrice, estimated_error, method_line, plant_prices, simulation_of, torque_history
from canhaptic.sim.plant.direct_rig import observed
from tests.scene.scene_text import scene_file

COGGING = "simulation.effects=[{type: cogging, amplitude: 0.2, pitch: 5 mm}]"
FRICTION = "simulation.effects=[{type: coulomb_friction, kinetic: 0.3, static: 0.5}]"
QUICK_HAND = "simulation.user.motion={amplitude: 20 mm, frequency: 4 Hz}"  # sticks twice in a period
SHORT = "duration=0.08"


def scene_with(folder: Path, *overrides: str):
    return load_scene(scene_file(folder), [SHORT, *overrides])


def test_a_scene_without_auto_is_left_as_it_is(tmp_path: Path) -> None:
    scene = scene_with(tmp_path, COGGING)
    assert with_chosen_accuracy(scene) is scene
    assert "accuracy" not in scene.resolved()


@pytest.mark.slow
def test_the_choice_keeps_its_tolerance_and_is_the_cheapest_that_does(tmp_path: Path) -> None:
    plain = scene_with(tmp_path, COGGING)
    simulation, period = simulation_of(plain.axes[0]), plain.bus.sample_time_ns
    torques = torque_history(plain.axes[0], plain, holds_of(plain))
    exact = reference(textbook_model(simulation), torques, period)
    tried = []
    for accuracy in ladder(simulation, period):
        axis = load_scene(scene_file(tmp_path), [SHORT, COGGING, f"accuracy={{substeps: {accuracy.substeps}}}"]).axes[0]
        plant = build_plant(simulation_of(axis), period)
        tried.append((difference(observed(plant, torques), exact, 0.25, 1e-3).position, plant.products))
    for tolerance in (1e-6, 1e-7, 1e-9):
        scene = with_chosen_accuracy(scene_with(tmp_path, COGGING, f"accuracy={{auto: {tolerance}}}"))
        chosen = scene.accuracy_choices["handle"]
        assert chosen["position_error"] <= tolerance
        assert chosen["products_per_period"] * chosen["holds"] == min(p for e, p in tried if e <= tolerance)


@pytest.mark.slow
def test_the_choice_is_in_the_configuration_and_in_the_log_and_does_not_change_the_hash(tmp_path: Path) -> None:
    scene = scene_with(tmp_path, COGGING, "accuracy={auto: 10 nm}")
    log = tmp_path / "run.h5"
    with build(scene, energy_log=log) as experiment:
        assert experiment.scene.config_hash() == scene.config_hash()
        chosen = experiment.scene.axes[0].simulation.accuracy
        assert experiment.plants[0].accuracy == chosen
        assert chosen.substeps > 1
        run(experiment.cycle, 5)
    with h5py.File(log) as file:
        kept = json.loads(file.attrs["config_resolved"])
    assert kept["accuracy"]["auto"] == 1e-8
    assert kept["accuracy"]["chosen"]["handle"]["position_error"] <= 1e-8
    assert kept["axes"]["handle"]["simulation"]["accuracy"]["substeps"] == chosen.substeps


@pytest.mark.slow
def test_the_same_scene_is_chosen_alike_every_time(tmp_path: Path) -> None:
    first, second = (
        with_chosen_accuracy(scene_with(tmp_path, FRICTION, "accuracy={auto: 1 um}", "duration=0.04")) for _ in range(2)
    )
    assert first.resolved() == second.resolved()
    assert first.axes[0].simulation.accuracy.event_bits < 24


@pytest.mark.slow
def test_a_tolerance_beyond_the_ladder_is_refused_with_what_can_be_reached(tmp_path: Path) -> None:
    scene = scene_with(tmp_path, COGGING, "accuracy={auto: 1e-15}")
    with pytest.raises(InputError, match=r"axis handle with tolerance 1e-15: the finest setting errs by"):
        build(scene)


@pytest.mark.parametrize(
    ("accuracy", "expected"),
    [
        ("{auto: 0}", "accuracy.auto: got 0, expected 0 < auto"),
        ("{auto: 1 N}", "accuracy.auto: got '1 N', unit 'N' does not fit"),
        ("{auto: 1 um, substeps: 2}", "accuracy.substeps: unknown key"),
    ],
)
def test_a_bad_tolerance_is_refused(tmp_path: Path, accuracy: str, expected: str) -> None:
    with pytest.raises(SceneError) as caught:
        scene_with(tmp_path, f"accuracy={accuracy}")
    assert expected in str(caught.value)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("effects", "accuracy"),
    [
        (COGGING, "{substeps: 1}"),
        (COGGING, "{substeps: 4}"),
        (FRICTION, "{event_bits: 6}"),
        (FRICTION, "{event_bits: 14}"),
    ],
)
def test_the_estimated_error_is_that_of_the_reference_within_a_factor_of_four(tmp_path, effects, accuracy) -> None:
    scene = load_scene(scene_file(tmp_path), [effects, f"accuracy={accuracy}", QUICK_HAND])
    simulation, period = simulation_of(scene.axes[0]), scene.bus.sample_time_ns
    torques = torque_history(scene.axes[0], scene, 400)
    exact = reference(textbook_model(simulation), torques, period)
    true = difference(observed(build_plant(simulation, period), torques), exact, 0.25, 1e-3).position
    estimated = estimated_error(simulation, torques, period)
    assert estimated is not None
    assert not estimated.doubt
    assert true / 4.0 < estimated.size < true * 4.0


COARSE = ("bus.rate=40 Hz", "simulation.effects=[{type: cogging, amplitude: 1.5 N, pitch: 5 mm}]", QUICK_HAND)


@pytest.mark.slow
def test_an_estimate_that_cannot_be_trusted_says_so_and_what_to_do(tmp_path: Path) -> None:
    """Cogging with several detents a hold: one substep is off by a seventh of the travel, 16 by 0.1 %."""
    for substeps, trusted in ((1, False), (16, True)):
        scene = load_scene(scene_file(tmp_path), [*COARSE, f"accuracy={{substeps: {substeps}}}"])
        simulation, period = simulation_of(scene.axes[0]), scene.bus.sample_time_ns
        torques = torque_history(scene.axes[0], scene, 20)
        exact = reference(textbook_model(simulation), torques, period)
        true = difference(observed(build_plant(simulation, period), torques), exact, 0.25, 25e-3).position
        estimated = estimated_error(simulation, torques, period)
        assert estimated is not None
        assert (not estimated.doubt) is trusted
        if trusted:
            assert true < 4.0 * estimated.size < 16.0 * true
        else:
            assert true > 0.1 * estimated.travel
            assert "raise accuracy.substeps" in estimated.doubt
        line = method_line(scene, [], 60, [PlantPrice("m", 1.0, estimated, 60)])
        assert ("ERROR NOT KNOWN" in line) is not trusted


@pytest.mark.slow
def test_the_line_of_a_run_has_its_price_and_its_error(tmp_path: Path) -> None:
    for effects, words in (("simulation.effects=[]", "exact to rounding"), (COGGING, "estimated error ")):
        scene = scene_with(tmp_path, effects)
        with build(scene) as experiment:
            run(experiment.cycle, 60)
            prices = plant_prices(scene, experiment.plants, 60)
            text = method_line(scene, experiment.plants, 60, prices)
        assert words in text
        assert "us per period" in text
        assert prices[0].microseconds > 0.0
    assert plant_prices(scene, [], 0) == []
