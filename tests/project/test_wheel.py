"""The wheel, installed where no source tree is: command, scenes and dictionary come with it."""

import json
import shutil
import subprocess
import sys
import venv
from pathlib import Path

import pytest

PROJECT = Path(__file__).resolve().parents[2]

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]


def run(*words: str | Path, folder: Path) -> str:
    done = subprocess.run([str(word) for word in words], cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    return done.stdout


def tracked(folder: str) -> list[str]:
    """Every file that belongs to the project, also what is not committed yet."""
    words = ["git", "ls-files", "--cached", "--others", "--exclude-standard", folder]
    return run(*words, folder=PROJECT).splitlines()


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of programs of a fresh environment with nothing but the wheel and what it requires."""
    folder = tmp_path_factory.mktemp("wheel")
    source = folder / "source"
    if not (PROJECT / ".git").exists():
        pytest.skip("no git checkout here to build from")
    for name in tracked("."):
        if (PROJECT / name).is_file():  # the tree as it is, without what a build leaves in it
            (source / name).parent.mkdir(parents=True, exist_ok=True)
            (source / name).write_bytes((PROJECT / name).read_bytes())
    pip = (sys.executable, "-m", "pip")
    run(*pip, "wheel", "--quiet", "--no-deps", "--wheel-dir", folder / "dist", source, folder=folder)
    [wheel] = (folder / "dist").glob("canhaptic-*.whl")
    venv.create(folder / "environment", with_pip=True)
    programs = folder / "environment" / "bin"
    run(programs / "python", "-m", "pip", "install", "--quiet", wheel, folder=folder)
    return programs


@pytest.mark.campaign
def test_two_builds_of_one_commit_are_the_same_bytes(installed: Path, tmp_path: Path) -> None:
    """In two folders, whose files were written at different times."""
    run(installed / "python", "-m", "pip", "install", "--quiet", "setuptools>=70", folder=tmp_path)
    found = []
    for name in ("first", "second"):
        copied = shutil.copytree(installed.parents[1] / "source", tmp_path / name, copy_function=shutil.copyfile)
        words: tuple[str | Path, ...] = (installed / "python", "-m", "tools.make_dist", tmp_path / "dist")
        found.append(run("env", "SOURCE_DATE_EPOCH=1700000000", *words, folder=copied).splitlines()[-2:])
    assert found[0] == found[1]
    assert all("canhaptic-" in line for line in found[0])


def test_a_fixture_replays_a_recording_from_the_wheel(installed: Path, tmp_path: Path) -> None:
    """pytest finds it by the entry point of the installed package, and it fails where a key changed."""
    run(installed / "python", "-m", "pip", "install", "--quiet", "pytest", folder=tmp_path)
    words = ["run", "demo", "--duration", "3", "--bus-log", "rig.log"]
    run(installed / "canhaptic", *words, folder=tmp_path)
    run(installed / "canhaptic", "configs", "--copy", tmp_path / "shipped", folder=tmp_path)
    scene = (tmp_path / "shipped" / "configs" / "demo.yaml").read_text()
    (tmp_path / "rig.yaml").write_text(scene)
    (tmp_path / "test_rig.py").write_text("def test_rig(canhaptic_replay):\n    canhaptic_replay('rig.log')\n")
    assert "1 passed" in run(installed / "python", "-m", "pytest", "-q", folder=tmp_path)
    (tmp_path / "rig.yaml").write_text(scene.replace("stiffness:", "stiffness: 1 N/m #", 1))
    failed = subprocess.run(
        [installed / "python", "-m", "pytest", "-q"], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert failed.returncode == 1
    assert "different at line" in failed.stdout


def test_the_demo_runs_from_the_wheel_alone(installed: Path, tmp_path: Path) -> None:
    run(installed / "canhaptic", "configs", "--copy", tmp_path, folder=tmp_path)
    words = ["run", "configs/demo.yaml", "--duration", "1", "--pace", "free", "--json", "--log", "run.h5"]
    account = json.loads(run(installed / "canhaptic", *words, folder=tmp_path))
    assert (account["status"], account["cycles"]) == ("completed", 1000)
    assert "margin" in run(installed / "canhaptic", "inspect", "run.h5", folder=tmp_path)


def test_a_scene_without_a_dictionary_beside_it_finds_the_installed_one(installed: Path, tmp_path: Path) -> None:
    scene = (PROJECT / "configs" / "demo.yaml").read_text()
    (tmp_path / "mine.yaml").write_text(scene)
    run(installed / "canhaptic", "check", "mine.yaml", folder=tmp_path)


def test_every_scene_and_profile_of_the_tree_is_in_the_wheel(installed: Path, tmp_path: Path) -> None:
    listed = json.loads(run(installed / "canhaptic", "configs", "--json", folder=tmp_path))["configs"]
    tree = [name for name in tracked("configs") if name.endswith(".yaml")]
    assert sorted(listed) == sorted(name.removeprefix("configs/") for name in tree)
    run(installed / "canhaptic", "check", "recorded_hand", folder=tmp_path)  # which reads a table of the wheel
