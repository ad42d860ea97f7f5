"""Substeps that a scene does not give follow from its effects; what a command shows of such a plant has its error."""

import json
from pathlib import Path

import numpy as np
import pytest

from canhaptic.cli.main import main
from canhaptic.scene.far_side import build_plant
from canhaptic.scene.load import load_scene
from canhaptic.scene.method import estimated_error, plant_errors, simulation_of, torque_history
from canhaptic.sim.plant import substeps_for
from canhaptic.sim.plant.direct_rig import observed
from tests.scene.scene_text import scene_file

COGGING = "{type: cogging, amplitude: 0.5, pitch: 0.005}"
LUGRE = "{type: lugre_friction, kinetic: 0.5, static: 0.7, stribeck_velocity: 0.01, bristle_stiffness: 1e5}"


def substeps(path: Path, effect: str, *words: str) -> int:
    scene = load_scene(path, [f"simulation.effects=[{effect}]", *words])
    return simulation_of(scene.axes[0]).accuracy.substeps


def test_the_rule_gives_a_quarter_of_a_radian_to_a_substep_and_leaves_what_is_given(tmp_path: Path) -> None:
    path = scene_file(tmp_path)
    assert substeps_for([], 1.0) == 1
    assert substeps_for([10.0, 1000.0], 1e-3) == 4
    assert substeps_for([1e9], 1e-3) == 16
    assert substeps(path, "{type: viscous_friction, damping: 1}") == 1
    assert substeps(path, LUGRE) == 4  # sqrt(1e5 / 0.25) = 632 rad/s at 1 kHz
    assert substeps(path, COGGING) == 1
    assert substeps(path, COGGING, "simulation.plant.mass=0.02") == 1
    assert substeps(path, COGGING, "simulation.plant.mass=0.002") == 4
    assert substeps(path, LUGRE, "accuracy={substeps: 1}") == 1
    assert substeps(path, LUGRE, "accuracy={event_bits: 16}") == 4


def test_a_scene_keeps_its_hash_and_its_log_has_the_substeps(tmp_path: Path) -> None:
    path = scene_file(tmp_path)
    scene, given = (load_scene(path, [f"simulation.effects=[{LUGRE}]", *of]) for of in ([], ["accuracy={substeps: 1}"]))
    assert scene.config_hash() == given.config_hash()  # that of every log so far
    [axis] = scene.resolved()["axes"].values()
    assert axis["simulation"]["accuracy"]["substeps"] == 4


@pytest.mark.slow
@pytest.mark.parametrize("mass", [0.02, 0.25])
def test_by_default_a_bristle_errs_by_less_than_a_thousandth_of_its_travel(tmp_path: Path, mass: float) -> None:
    path = scene_file(tmp_path)
    words = [f"simulation.effects=[{LUGRE}]", f"simulation.plant.mass={mass}"]
    scene, fine = load_scene(path, words), load_scene(path, [*words, "accuracy={substeps: 128}"])
    period, axis = scene.bus.sample_time_ns, scene.axes[0]
    torques = torque_history(axis, scene, 150)
    one, other = (observed(build_plant(simulation_of(of.axes[0]), period), torques).position for of in (scene, fine))
    assert np.abs(one - other).max() <= 1e-3 * np.ptp(other)


@pytest.mark.slow
def test_a_substep_of_a_whole_number_of_detents_claims_no_small_error(tmp_path: Path) -> None:
    """At 0.1 m/s and 100 Hz it passes 2, then 8 pitches: halves of the step are whole numbers of them too."""
    for pitch, known in ((5e-4, True), (1.25e-4, False)):
        scene = load_scene(
            scene_file(tmp_path),
            ["bus.rate=100", f"simulation.effects=[{{type: cogging, amplitude: 0.1, pitch: {pitch}}}]",
             "simulation.plant={mass: 0.25, initial_velocity: 0.1}", "simulation.user=null", "accuracy={substeps: 1}"],
        )  # fmt: skip
        simulation = simulation_of(scene.axes[0])
        error = estimated_error(simulation, [0.0] * 100, 10_000_000)
        assert error is not None
        assert ("in which no error shows" in error.doubt) is not known
        assert error.size > 1e-9 or not known  # 6e-16 m by halves alone


@pytest.mark.slow
def test_figures_of_a_plant_that_is_not_exact_come_with_its_error(tmp_path: Path, capfd: pytest.CaptureFixture) -> None:
    path = scene_file(tmp_path)
    assert plant_errors(load_scene(path)) == []
    words = [str(path), "--set", f"simulation.effects=[{LUGRE}]", "--duration", "0.05"]
    assert main(["compare", *words, "--algorithms", "unprotected"]) == 0
    assert "plant of handle: not exact, estimated error" in capfd.readouterr().err
    table = str(tmp_path / "sweep")
    assert main(["sweep", *words, "--vary", "environment.stiffness=100,150,200", "--out", table, "--json"]) == 0
    captured = capfd.readouterr()
    json.loads(captured.out)
    for stiffness in ("100", "200"):
        assert f"with environment.stiffness={stiffness}: plant of handle: not exact, estimated error" in captured.err
    assert "environment.stiffness=150" not in captured.err
    assert "of 1 other scenes ERROR NOT KNOWN" in captured.err
    assert main(["sweep", "--map", table, "--json"]) in (0, 2)
    assert "with environment.stiffness=200: plant of handle: not exact, estimated error" in capfd.readouterr().err
