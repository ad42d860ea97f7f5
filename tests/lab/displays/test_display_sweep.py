"""Admittance displays in sweep and map: their loop without a bus agrees with the run over CAN."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from canhaptic.cli.main import main
from canhaptic.cycle import run
from canhaptic.errors import ParameterError
from canhaptic.lab.batch.scalar import render, run_scalar
from canhaptic.lab.figures.figures import DISPLAY_METRICS
from canhaptic.lab.loop.admittance_loop import felt
from canhaptic.lab.loop.axis_loop import LoopRun, parts_of
from canhaptic.scene.build import build, experiment_account
from canhaptic.scene.displays import display_properties
from canhaptic.scene.load import load_scene

SCENES = Path(__file__).parents[3] / "configs" / "admittance"
MASS, NODE = SCENES / "virtual_mass.yaml", SCENES / "force_node.yaml"


@pytest.mark.slow_but("wall")
@pytest.mark.parametrize("name", ["virtual_mass", "wall", "force_node", "guided_path"])
def test_the_loop_without_a_bus_agrees_with_the_run_over_can(name: str) -> None:
    scene, cycles = load_scene(SCENES / f"{name}.yaml"), 400
    ((part, alone),) = parts_of(scene).items()
    found = render(alone, cycles)
    with build(scene, "free") as experiment:
        run(experiment.cycle, cycles)
        account = experiment_account(experiment, "completed", 1.0)
    assert found.ended == ""
    assert found.interaction[-1] == pytest.approx(account["truth"][part]["interaction"], rel=0.02)
    assert found.resolution == pytest.approx(account["ports"][part]["energy_resolution"], rel=0.02)


def test_the_mass_felt_is_found_exactly_in_a_motion_that_has_it() -> None:
    scene = load_scene(MASS, ["environment.stiffness=50 N/m", "environment.lower_wall=-10 m"])
    t = np.arange(200) * scene.bus.sample_time  # velocity t^2, so that the central difference is exact
    motion = np.stack([t**3 / 3.0, t * t, 3.5 * 2.0 * t + 7.0 * t * t + 50.0 * t**3 / 3.0], axis=1)[:, None]
    assert felt(LoopRun(np.empty((0, 19)), motion=motion), scene) == pytest.approx((3.5, 7.0))


def test_a_light_mass_gives_energy_out_unless_it_is_guarded() -> None:
    changes = ["environment.mass=0.3 kg", "environment.damping=0", "bus.rate=250 Hz"]
    changes += ["simulation.admittance.grip={mass: 0.05 kg, stiffness: 20 kN/m, damping: 0.5 N*s/m}"]
    changes += ["simulation.user={stiffness: 2 kN/m, motion: {type: sinusoid, amplitude: 20 mm, frequency: 2 Hz}}"]
    found = {}
    for name in ("guarded", "unprotected"):
        given = [f"passivity={{algorithm: {name}}}"] if name == "unprotected" else []
        found[name] = run_scalar(load_scene(MASS, [*changes, *given]), 200)
    assert found["unprotected"]["least_interaction"] < -0.1
    assert found["guarded"]["least_interaction"] >= -1e-3
    assert found["guarded"]["guard_acts"] > 0.1


def test_a_force_beyond_the_range_ends_a_run() -> None:
    scene = load_scene(MASS, ["axes.0.admittance.force.range=2 N"])
    found = run_scalar(scene, 1000, ["diverged", "cycles", "stiffness_rendered.share"])
    assert found["diverged"] == 1.0
    assert found["cycles"] < 1000
    assert math.isnan(found["stiffness_rendered.share"])  # of impedance displays


@pytest.mark.slow
def test_a_display_is_swept_under_its_own_algorithms_and_mapped(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table, picture = str(tmp_path / "sweep"), tmp_path / "map.png"
    vary = ["--vary", "environment.mass=1,4", "--vary", "bus.rate=500,1000", "--controllers", "guarded,unprotected"]
    assert main(["sweep", str(MASS), *vary, "--duration", "0.3", "--out", table, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["status"] == {"completed": 8}
    assert found["figures"]["handle"]["guarded"]["guard_acts"] > 0.0
    assert found["figures"]["handle"]["unprotected"]["guard_acts"] == 0.0
    assert main(["sweep", "--map", table, "--png", str(picture), "--json"]) == 0
    assert picture.stat().st_size > 10_000
    assert main(["sweep", str(MASS), *vary[:2], "--controllers", "energy_bounding"]) == 2
    assert "unknown algorithm of an admittance display" in capsys.readouterr().err


@pytest.mark.slow
def test_a_group_of_displays_is_swept(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["sweep", str(SCENES / "guided_path.yaml"), "--vary", "groups.0.network.mass=1,4", "--duration", "0.3"]
    assert main([*words, "--json", "--metrics", "guard_acts,least_interaction"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["status"] == {"completed": 2}
    assert found["figures"]["stage"]["of the scene"]["scenes"] == 2


def test_every_figure_is_measured_and_a_heavy_mass_is_felt_as_it_is() -> None:
    scene = load_scene(MASS)
    assert set(run_scalar(scene, 40)) == set(DISPLAY_METRICS)
    heavy = run_scalar(load_scene(NODE, ["environment.mass=6 kg", "environment.lower_wall=-1 m"]), 600)
    assert heavy["mass_felt.share"] == pytest.approx(1.0, abs=0.1)


def test_a_display_commands_speed_in_steps_of_its_counts() -> None:
    axis = load_scene(MASS).axes[0]
    given, time = axis.parameters, axis.loop.sample_time
    assert given.admittance is not None
    for mode, counts, quantum in (
        ("position", None, 1.0 / (given.counts_per_unit * time)),
        ("velocity", None, 1.0 / given.counts_per_unit),
        ("velocity", 1e5, 1e-5),
    ):
        display = given.admittance.model_copy(update={"mode": mode, "velocity_counts": counts})
        changed = replace(axis, parameters=given.model_copy(update={"admittance": display}))
        assert display_properties(changed).speed_quantum == pytest.approx(quantum, rel=1e-12)


def test_a_torque_axis_has_no_properties_of_a_display() -> None:
    axis = load_scene(MASS).axes[0]
    torque = replace(axis, parameters=axis.parameters.model_copy(update={"admittance": None}))
    with pytest.raises(ParameterError, match="has no `admittance`"):
        display_properties(torque)
