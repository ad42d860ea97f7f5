"""`canhaptic accuracy` of admittance displays: the plant against a solver, the loop against an ideal display."""

import json
from pathlib import Path

import numpy as np
import pytest

from canhaptic.cli.main import main
from canhaptic.errors import InputError
from canhaptic.lab.batch.scalar import render
from canhaptic.lab.render.accuracy_picture import draw_accuracy
from canhaptic.lab.studies.accuracy.accuracy_table import accuracy_tables
from canhaptic.lab.studies.accuracy.ideal_loop import IdealStudy, exact_motion, why_no_equations
from canhaptic.scene.load import load_scene
from canhaptic.scene.method import simulation_of

SCENES = Path(__file__).parents[3] / "configs" / "admittance"
NODE = SCENES / "force_node.yaml"


@pytest.mark.slow
@pytest.mark.parametrize("name", ["virtual_mass", "wall"])  # without and with the integral of the loop
def test_the_plant_is_that_of_a_solver_which_shares_nothing_with_it(name: str) -> None:
    scene = load_scene(SCENES / f"{name}.yaml")
    run, simulation = render(scene, 60), simulation_of(scene.axes[0])
    exact = exact_motion(simulation, run.torque[1:, 0].tolist(), scene.bus.sample_time_ns)
    assert np.abs(run.motion[1:, 0, :1] - exact.position).max() < 1e-12
    assert np.abs(run.interaction[1:] - exact.user).max() < 1e-10
    assert max(run.interaction) > 1e-4
    lighter = load_scene(SCENES / f"{name}.yaml", ["simulation.plant.mass=1.9 kg"])
    wrong = exact_motion(simulation_of(lighter.axes[0]), run.torque[1:, 0].tolist(), scene.bus.sample_time_ns)
    assert np.abs(run.motion[1:, 0, :1] - wrong.position).max() > 1e-7


@pytest.mark.slow
def test_the_loop_is_near_the_ideal_display_and_a_coarser_one_is_further_off(
    capsys: pytest.CaptureFixture[str],
) -> None:
    words = ["accuracy", str(NODE), "--duration", "0.3", "--json", "--set", "passivity={algorithm: unprotected}"]
    assert main([*words, "--set", "simulation.admittance.sensor.noise=0 N"]) == 0
    found = json.loads(capsys.readouterr().out)
    rates = {row["setting"]: row["position_error"] for row in found["loop"] if row["group"] == "sample rate"}
    scene = next(row["position_error"] for row in found["loop"] if row["is_scene"])
    assert scene < rates["500 Hz"]
    assert max(rates.values()) < 0.05 * found["reference"]["travel"]
    assert found["reference"]["apart"] < 0.5 * min(scene, *rates.values())
    assert found["plant"][0]["position_error"] < 1e-12
    assert {"algorithm", "sampling", "sensor", "encoder count"} <= {row["group"] for row in found["loop"]}


@pytest.mark.slow
def test_a_group_and_what_has_no_equations_are_studied_as_far_as_they_go() -> None:
    friction = ["simulation.effects=[{type: coulomb_friction, kinetic: 2 N, static: 3 N}]", "duration=0.1"]
    scene = load_scene(SCENES / "guided_path.yaml", friction)
    assert why_no_equations(simulation_of(scene.axes[0])) == "effect coulomb_friction"
    found = IdealStudy(scene, "stage").run()
    assert "no equations" in found["plant"][0]["status"]
    assert found["loop"][0]["status"] == "ok"
    stopped = IdealStudy(scene, stop=lambda: True).run()
    assert (stopped["status"], stopped["loop"]) == ("stopped", [])


def test_the_table_of_the_loop_has_the_columns_that_its_rows_have_and_says_what_was_refused() -> None:
    known = {"position_error": 1e-6, "energy_error": 2e-6, "mass_felt": float("nan"), "guard_acts": 0.1}
    rows = [{"group": "the scene", "setting": "", "is_scene": True, "status": "ok", **known},
            {"group": "rate", "setting": "500 Hz", "is_scene": False, "status": "too fast", **known},
            {"group": "algorithm", "setting": "guarded", "is_scene": False, "status": "refused: no mass"}]  # fmt: skip
    [table] = accuracy_tables({"unit": "m", "reference": {"travel": 1.0}, "plant": [], "loop": rows})
    lines = [line for line in table.markdown().splitlines() if line.startswith("|")]
    assert [line.strip("| ") for line in (lines[0], *lines[2:])] == [
        "changed | to | position | energy | mass felt | guard acts",
        "**the scene** |  | 1.00 um | 2.00 uJ | - | 10 %",
        "rate | 500 Hz (ended: too fast) | 1.00 um | 2.00 uJ | - | 10 %",
        "algorithm | guarded | refused",
    ]


def test_an_absent_axis_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["accuracy", str(NODE), "--axis", "absent"]) == 2
    assert "expected one of" in capsys.readouterr().err


@pytest.mark.slow
def test_a_picture_is_drawn(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    picture = tmp_path / "study.png"
    assert main(["accuracy", str(NODE), "--duration", "0.03", "--json", "--png", str(picture)]) == 0
    assert picture.read_bytes()[:4] == b"\x89PNG"


@pytest.mark.slow
def test_page_and_markdown_show_every_change(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("matplotlib")
    files = {name: tmp_path / f"study.{name}" for name in ("html", "markdown")}
    words = [word for name, path in files.items() for word in (f"--{name}", str(path))]
    assert main(["accuracy", str(NODE), "--duration", "0.03", "--json", *words]) == 0
    found = json.loads(capsys.readouterr().out)
    table = files["markdown"].read_text(encoding="utf-8").splitlines()
    rows = [line for line in table if line.startswith("| ")]
    assert len(rows) == 1 + len(found["loop"])
    assert {line.count(" | ") for line in rows} == {7}
    page = files["html"].read_text(encoding="utf-8")
    for row in found["loop"]:
        assert f"| {row['group']} | {row['setting']}" in "\n".join(rows).replace("**", "")
        assert row["setting"] in page
    assert "position" in page
    nothing = found.copy()
    nothing["loop"] = []
    with pytest.raises(InputError, match="nothing was measured"):
        draw_accuracy(nothing, tmp_path / "none.png")
