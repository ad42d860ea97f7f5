"""A user's own environment named in a scene: it runs only where allowed, and only from the scene's own folder."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

import canhaptic
from canhaptic.audit.recompute import scene_of
from canhaptic.cli.main import main
from canhaptic.errors import InputError, SceneError
from canhaptic.scene.load import load_scene

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


def test_an_own_wall_renders_from_the_command_line(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["run", str(folder / "scene.yaml"), "--set", ENVIRONMENT, "--duration", "1", "--pace", "free", "--json"]
    assert main([*words, "--allow-code"]) == 0
    port = json.loads(capsys.readouterr().out)["ports"]["handle"]
    assert port["in"] > 1e-4
    assert port["least_interaction"] >= -1e-9


def test_from_python_it_runs_with_permission_alone(folder: Path) -> None:
    values = {"type": "my_wall.py:CenteringSpring", "stiffness": 300.0, "damping": 1.0}
    with pytest.raises(SceneError, match="--allow-code"):
        canhaptic.simulate(folder / "scene.yaml", {"environment": values}, duration=0.5)
    assert not ran(folder)
    result = canhaptic.simulate(folder / "scene.yaml", {"environment": values}, duration=0.5, allow_code=True)
    assert result.account.passive == "yes"
    assert list(result.scene.own_code) == ["my_wall.py"]


COMMANDS = ("run", "compare", "accuracy", "sweep", "design", "check", "drive", "commission", "preflight")


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
    for name in ("pipe.py", "folder.py"):
        assert "no regular Python file" in refusal(folder, f"environment={{type: '{name}:Wall'}}")
    assert "cannot be read" in refusal(folder, "environment={type: 'absent.py:Wall'}")
    assert "expected one of" in refusal(folder, "environment={type: 'os.path:join'}")  # no import by dotted name


def test_faults_in_the_file_are_told_with_its_line(folder: Path) -> None:
    (folder / "broken.py").write_text("x = 1\nraise KeyError('wall')\n")
    assert "broken.py:2: KeyError: 'wall'" in refusal(folder, "environment={type: 'broken.py:Wall'}")
    (folder / "typo.py").write_text("def f(:\n")
    assert "typo.py:1: SyntaxError" in refusal(folder, "environment={type: 'typo.py:Wall'}")
    (folder / "empty.py").write_text("class Other: pass\n")
    assert "expected one of: Other" in refusal(folder, "environment={type: 'empty.py:Wall'}")
    assert "no parameters" in refusal(folder, "environment={type: 'empty.py:Other'}")


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
        with pytest.raises(InputError, match="changed since"):
            scene_of(log, allow_code=True)
    (folder / "ran").unlink()
    assert main(["inspect", str(path)]) == 0
    assert not ran(folder)


def test_its_folder_is_no_place_to_import_from(folder: Path) -> None:
    code = (
        "import sys\nfrom canhaptic import load_scene\n"
        f"load_scene({str(folder / 'scene.yaml')!r}, [{ENVIRONMENT!r}], allow_code=True)\n"
        f"print({str(folder)!r} in sys.path, 'my_wall' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    assert done.stdout.split() == ["False", "False"]
