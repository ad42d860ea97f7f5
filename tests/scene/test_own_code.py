"""A user's own environment named in a scene: it runs only where allowed, and only from the scene's own folder."""

import json
import os
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import canhaptic
from canhaptic.audit.recompute import scene_of
from canhaptic.cli.main import main
from canhaptic.errors import InputError, SceneError
from canhaptic.lab.batch import chosen_engine
from canhaptic.lab.judge.solvers import reference
from canhaptic.lab.reference import continuous_motion, textbook_model
from canhaptic.lab.studies.chunk import make_recipe
from canhaptic.lab.studies.chunk import scene_of as scene_of_row
from canhaptic.lab.studies.vary import make_points, parse_vary
from canhaptic.scene.far_side import build_plant
from canhaptic.scene.load import load_scene
from canhaptic.sim.plant import AccuracyParameters

ROOT = Path(__file__).resolve().parents[2]
SPRING = """
from typing import Annotated
from canhaptic.extending import OwnEnvironment, quantity

(__import__("pathlib").Path(__file__).parent / "ran").touch()


class CenteringSpring(OwnEnvironment):
    stiffness: Annotated[float, quantity("N/m", "N*m/rad", ge=0.0)] = 200.0

    def effort(self, state: float) -> float:
        return self.stiffness * state
"""
ENVIRONMENT = "environment={type: my_wall.py:CenteringSpring, stiffness: 300 N/m, damping: 1}"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with the demo and a wall of the user's own."""
    text = (ROOT / "configs" / "demo.yaml").read_text().replace("../eds", str(ROOT / "eds"))
    (tmp_path / "scene.yaml").write_text(text)
    (tmp_path / "my_wall.py").write_text(SPRING)
    return tmp_path


def ran(folder: Path) -> bool:
    return (folder / "ran").exists()


def refusal(folder: Path, environment: str, *, allow_code: bool = True) -> str:
    with pytest.raises(SceneError) as raised:
        load_scene(folder / "scene.yaml", [environment], allow_code=allow_code)
    assert not ran(folder)
    return str(raised.value)


def test_from_python_it_runs_with_permission_alone(folder: Path) -> None:
    values = {"type": "my_wall.py:CenteringSpring", "stiffness": 300.0, "damping": 1.0}
    with pytest.raises(SceneError, match="--allow-code"):
        canhaptic.simulate(folder / "scene.yaml", {"environment": values}, duration=0.05)
    assert not ran(folder)
    result = canhaptic.simulate(folder / "scene.yaml", {"environment": values}, duration=0.05, allow_code=True)
    assert result.account.passive == "yes"
    assert list(result.scene.own_code) == ["my_wall.py"]


COMMANDS = ("run", "compare", "accuracy", "sweep", "design", "drive", "commission", "touch")


@pytest.mark.parametrize("command", COMMANDS)
def test_no_command_runs_it_without_the_flag(folder: Path, command: str, capsys: pytest.CaptureFixture[str]) -> None:
    more = ["--vary", "environment.stiffness=1:2:2", "--out", str(folder / "x.h5")] if command == "sweep" else []
    assert main([command, str(folder / "scene.yaml"), "--set", ENVIRONMENT, *more]) == 2
    assert "my_wall.py" in capsys.readouterr().err
    assert not ran(folder)


def test_a_file_outside_the_folder_is_refused_however_it_is_named(folder: Path) -> None:
    below = folder / "inner"
    below.mkdir()
    (below / "scene.yaml").write_text((folder / "scene.yaml").read_text())
    for name in ("../my_wall.py", str(folder / "my_wall.py"), "./../my_wall.py", "..//my_wall.py"):
        with pytest.raises(SceneError, match="scene's folder"):
            load_scene(below / "scene.yaml", [f"environment={{type: '{name}:CenteringSpring'}}"], allow_code=True)
    (below / "linked.py").symlink_to(folder / "my_wall.py")
    with pytest.raises(SceneError, match="scene's folder"):
        load_scene(below / "scene.yaml", ["environment={type: 'linked.py:CenteringSpring'}"], allow_code=True)
    assert not ran(folder)


def test_what_is_no_regular_file_is_refused(folder: Path) -> None:
    os.mkfifo(folder / "pipe.py")
    (folder / "folder.py").mkdir()
    for name in ("pipe", "folder"):
        assert f"cannot be read ([Errno 22] is a {name}" in refusal(folder, f"environment={{type: '{name}.py:Wall'}}")
    absent = refusal(folder, "environment={type: 'absent.py:Wall'}")
    assert f"in the current folder: put it into the current folder, {Path.cwd()}" in absent
    assert "expected one of" in refusal(folder, "environment={type: 'os.path:join'}")  # no import by dotted name


def test_a_file_beside_the_scene_comes_before_one_in_the_current_folder(folder: Path, tmp_path_factory, monkeypatch):
    current = tmp_path_factory.mktemp("current")
    monkeypatch.chdir(current)
    (current / "my_wall.py").write_text(SPRING.replace("200.0", "1.0"))
    function = "def slope(x, stiffness=2.0):\n    return stiffness * x\n"
    (current / "other.py").write_text(SPRING.replace("200.0", "3.0") + function)
    for name, stiffness in (("my_wall.py", 200.0), ("other.py", 3.0), ("other.py:slope", 2.0)):
        [axis] = load_scene(folder / "scene.yaml", [f"environment={{type: '{name}'}}"], allow_code=True).axes
        assert axis.environment.parameters.model_dump()["stiffness"] == stiffness


def test_faults_in_the_file_are_told_with_its_line(folder: Path) -> None:
    (folder / "broken.py").write_text("x = 1\nraise KeyError('wall')\n")
    assert "broken.py:2: KeyError: 'wall'" in refusal(folder, "environment={type: 'broken.py:Wall'}")
    (folder / "typo.py").write_text("def f(:\n")
    assert "typo.py:1: SyntaxError" in refusal(folder, "environment={type: 'typo.py:Wall'}")
    (folder / "empty.py").write_text("class Other: pass\n")
    assert "expected one of: Other" in refusal(folder, "environment={type: 'empty.py:Wall'}")
    assert "no parameters" in refusal(folder, "environment={type: 'empty.py:Other'}")


@pytest.mark.slow
def test_a_log_names_the_code_and_another_code_is_not_its_scene(folder: Path, tmp_path: Path) -> None:
    words = ["run", str(folder / "scene.yaml"), "--set", ENVIRONMENT, "--duration", "0.2", "--pace", "free"]
    path = folder / "run.h5"
    assert main([*words, "--allow-code", "--log", str(path)]) == 0
    assert main(["inspect", str(path), "--recompute", "--allow-code"]) == 0
    (folder / "ran").unlink()
    with canhaptic.EnergyLog.open(path) as log:
        [digest] = json.loads(str(log.attributes["config_resolved"]))["own_code"].values()
        assert len(digest) == 64
        with pytest.raises(SceneError, match="--allow-code"):
            scene_of(log)
        (folder / "my_wall.py").write_text(SPRING + "\n# changed\n")
        with pytest.raises(InputError, match="is not the code of"):
            scene_of(log, allow_code=True)
    (folder / "ran").unlink()
    assert main(["inspect", str(path)]) == 0
    assert not ran(folder)


def test_its_folder_is_no_place_to_import_from(folder: Path) -> None:
    load_scene(folder / "scene.yaml", [ENVIRONMENT], allow_code=True)
    assert ran(folder)
    assert str(folder) not in sys.path
    assert "my_wall" not in sys.modules


HAND = """
from canhaptic.extending import OwnHand

(__import__("pathlib").Path(__file__).parent / "ran").touch()


class Pull(OwnHand):
    strength: float = 0.0

    def force(self, time: float, position: float, velocity: float) -> float:
        return -self.strength if time > 0.1 else 0.0
"""


@pytest.mark.slow
def test_check_and_readers_leave_own_code_unread(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = folder / "scene.yaml"
    text = scene.read_text().replace("type: spring_damper_wall", "type: my_wall.py:CenteringSpring")
    scene.write_text(text.replace("  position: -0.05 m\n", "").replace("log:", "#log:"))
    assert main(["check", str(scene), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["unread"] == ["my_wall.py:CenteringSpring"]
    assert found["config"]["axes"]["handle"]["environment"]["stiffness"] == "100 N/m"
    assert found["config_hash"] is None
    assert main(["check", str(scene)]) == 0
    assert "not run, so its parameters are not checked" in " ".join(capsys.readouterr().out.split())
    assert main(["check", "--host", str(scene)]) == 0
    (folder / "bus.log").write_text("(0.000000) vcan0 080#\n")
    assert main(["inspect", "--frames", str(folder / "bus.log"), "--config", str(scene)]) == 0
    assert main(["scope", "--config", str(scene)]) == 2  # the scene names no log, and is read so far
    assert "has no log.energy" in capsys.readouterr().err
    assert main(["configs", "--schema"]) == 0
    assert not ran(folder)


def test_what_was_left_unread_is_not_built(folder: Path) -> None:
    scene = load_scene(folder / "scene.yaml", [ENVIRONMENT], leave_code=True)
    with pytest.raises(InputError, match="left unread"):
        canhaptic.build(scene)


@pytest.mark.slow
def test_an_own_hand_pulls_at_the_handle(folder: Path) -> None:
    (folder / "my_hand.py").write_text(HAND)
    user = {"type": "my_hand.py:Pull", "strength": 3.0, "stiffness": 60.0, "damping": 5.0}
    with pytest.raises(SceneError, match="--allow-code"):
        canhaptic.simulate(folder / "scene.yaml", {"simulation.user": user}, duration=0.1)
    assert not ran(folder)
    path = folder / "scene.yaml"
    pulled = canhaptic.simulate(path, {"simulation.user": user}, duration=4.0, allow_code=True)
    assert pulled.to_numpy()["true.handle.position"][-1] == pytest.approx(-0.05, abs=1e-3)  # 3 N against 60 N/m
    assert list(pulled.scene.own_code) == ["my_hand.py"]
    assert pulled.scene.resolved()["axes"]["handle"]["simulation"]["user"]["type"] == "Pull"
    wrong = {"simulation.user": {"type": "my_wall.py:CenteringSpring"}}
    with pytest.raises(SceneError, match="subclass of UserParameters"):
        canhaptic.simulate(path, wrong, duration=0.1, allow_code=True)


@pytest.mark.slow
def test_the_plant_moves_with_an_own_hand_as_the_textbook_says(folder: Path) -> None:
    pytest.importorskip("scipy")
    text = "import math\n" + HAND.replace("-self.strength if time > 0.1 else 0.0", "self.strength * math.sin(9 * time)")
    (folder / "my_hand.py").write_text(text)
    user = "simulation.user={type: my_hand.py:Pull, strength: 3.0, stiffness: 60.0, damping: 5.0}"
    scene = load_scene(folder / "scene.yaml", [user], allow_code=True)
    [axis] = scene.axes
    assert axis.simulation is not None
    exact = reference(textbook_model(axis.simulation), [0.0] * 500, scene.bus.sample_time_ns)
    errors = []
    for substeps in (1, 4):
        finer = replace(axis.simulation, accuracy=AccuracyParameters(substeps=substeps))
        plant = build_plant(finer, scene.bus.sample_time_ns)
        found = plant.run(np.zeros(500))
        errors.append(np.abs(found - exact.position[-500:]).max())
        energy = plant.energy()
        assert energy.motor + energy.user - energy.dissipated - energy.stored == pytest.approx(0.0, abs=1e-12)
    assert np.ptp(found) > 0.01
    assert errors[0] < 1e-6
    assert errors[0] / errors[1] == pytest.approx(16.0, rel=0.1)  # second order


@pytest.mark.slow
def test_an_own_wall_has_a_continuous_reference(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("scipy")
    (folder / "my_wall.py").write_text(SPRING)
    same = "environment={type: my_wall.py:CenteringSpring, stiffness: 100, damping: 10, position: -0.05, side: below}"
    own = load_scene(folder / "scene.yaml", [same], allow_code=True)
    wall = load_scene(folder / "scene.yaml")
    step, steps = 2_000_000, 800
    mine, known = continuous_motion(own, step, steps), continuous_motion(wall, step, steps)
    assert np.abs(known.impulse).max() > 0.1
    assert mine.position == pytest.approx(known.position, abs=1e-9)
    assert mine.interaction == pytest.approx(known.interaction, abs=1e-9)
    words = ["accuracy", str(folder / "scene.yaml"), "--set", same, "--duration", "0.1", "--budget", "0", "--json"]
    assert main([*words, "--allow-code"]) == 0


def test_a_wall_with_another_contact_says_where_it_switches_itself(folder: Path) -> None:
    pytest.importorskip("scipy")
    text = SPRING + "\n    def contact(self, position: float) -> int:\n        return int(position < -0.06)\n"
    (folder / "my_wall.py").write_text(text)
    scene = load_scene(folder / "scene.yaml", [ENVIRONMENT], allow_code=True)
    with pytest.raises(InputError, match="`surfaces`"):
        continuous_motion(scene, 1_000_000, 10)


@pytest.fixture
def plug_in(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A package, installed, that offers a wall."""
    site = tmp_path / "site"
    about = site / "bumpy_walls-1.2.dist-info"
    about.mkdir(parents=True)
    (site / "bumpy_walls_for_tests.py").write_text(SPRING)
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: bumpy-walls\nVersion: 1.2\n")
    (about / "entry_points.txt").write_text(
        "[canhaptic.environments]\nbumpy = bumpy_walls_for_tests:CenteringSpring\nlost = bumpy_walls_for_tests:Absent\n"
    )
    monkeypatch.syspath_prepend(str(site))
    yield site
    sys.modules.pop("bumpy_walls_for_tests", None)


def test_an_installed_plug_in_is_named_by_its_entry_point(folder: Path, plug_in: Path) -> None:
    path, environment = folder / "scene.yaml", ["environment={type: bumpy, stiffness: 300 N/m}"]
    left = load_scene(path, environment, leave_code=True)
    assert left.unread == ("bumpy",)
    assert not ran(plug_in)
    scene = load_scene(path, environment)
    assert list(scene.own_code) == ["bumpy (bumpy-walls 1.2)"]
    canhaptic.build(scene).close()
    with pytest.raises(SceneError, match=r"bumpy-walls 1\.2 cannot be used"):
        load_scene(path, ["environment={type: lost}"])
    with pytest.raises(SceneError, match="expected one of"):
        load_scene(path, ["environment={type: bumpy_walls_for_tests.CenteringSpring}"])


@pytest.mark.slow
def test_a_replay_takes_the_code_of_the_run_and_no_other(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, energy, frames = (str(folder / name) for name in ("scene.yaml", "run.h5", "run.log"))
    words = ["run", path, "--set", ENVIRONMENT, "--duration", "0.2", "--pace", "free", "--allow-code"]
    assert main([*words, "--log", energy, "--bus-log", frames]) == 0
    replay = ["replay", "--quick", frames, "--config", path]
    (folder / "ran").unlink()
    assert main([*replay, "--energy-log", energy]) == 2
    assert not ran(folder)
    assert main([*replay, "--set", ENVIRONMENT, "--allow-code"]) == 2
    assert "--energy-log" in capsys.readouterr().err
    assert main([*replay, "--energy-log", energy, "--allow-code"]) == 0
    (folder / "my_wall.py").write_text(SPRING + "\n# changed\n")
    assert main([*replay, "--energy-log", energy, "--allow-code"]) == 2
    assert "my_wall.py: is not the code of" in capsys.readouterr().err


@pytest.mark.slow
def test_a_sweep_gives_its_workers_the_code_of_the_flag_alone(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, vary = folder / "scene.yaml", "environment.stiffness=100:300:3"
    words = ["sweep", str(path), "--set", ENVIRONMENT, "--vary", vary, "--cycles", "300", "--workers", "2"]
    assert main([*words, "--allow-code", "--json"]) == 0
    scene = load_scene(path, [ENVIRONMENT], allow_code=True)
    points = make_points([parse_vary(vary)])
    engine = chosen_engine("python", pays=False)
    recipe = make_recipe(scene, points, metrics=("margin",), engine=engine, cycles=10)
    assert recipe.allow_code
    row = (("environment.stiffness", 200.0),)
    refused = scene_of_row(replace(recipe, allow_code=False), row)
    assert "--allow-code" in refused.remark
    (folder / "my_wall.py").write_text(SPRING + "\n# changed\n")
    assert "is not the code of" in scene_of_row(replace(recipe, cycles=11), row).remark
