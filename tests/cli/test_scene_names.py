"""Scenes by name from anywhere, suggestions for what is mistyped, help in the order of a user, completion."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from canhaptic.cli.main import main
from canhaptic.errors import SceneError
from canhaptic.files import scene_file, scene_names, shipped
from canhaptic.scene.load import load_scene


@pytest.mark.parametrize("name", ["demo", "demo.yaml", "configs/demo.yaml"])
def test_a_scene_of_the_package_is_found_by_its_name_from_any_folder(name: str, tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert load_scene(name).config_hash() == load_scene(shipped("configs") / "demo.yaml").config_hash()


@pytest.mark.slow
def test_every_scene_is_found_by_its_whole_name_and_by_a_short_one_that_no_other_has(tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    names = scene_names()
    last = [name.split("/")[-1] for name in names]
    for name, short in zip(names, last, strict=True):
        assert scene_file(Path(name)) == shipped("configs") / f"{name}.yaml"
        if last.count(short) == 1:
            assert scene_file(Path(short)) == scene_file(Path(name))
    with pytest.raises(SceneError, match="2 scenes have this name: accuracy/coarse_encoder, hard/coarse_encoder"):
        scene_file(Path("coarse_encoder"))


def test_a_file_on_disk_wins(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    shutil.copy(shipped("configs") / "hard" / "stiff_wall.yaml", "demo")
    assert scene_file(Path("demo")) == Path("demo")


@pytest.mark.parametrize(
    ("wrong", "answer"),
    [
        ("demoo", "did you mean 'demo'?"),
        ("stif_wall", "did you mean 'hard/stiff_wall'"),
        ("zzzzzz", "`canhaptic configs` lists the scenes"),
    ],
)
def test_a_name_that_no_scene_has_is_answered_by_near_ones(wrong: str, answer: str, capsys) -> None:
    assert main(["check", wrong]) == 2
    assert answer in capsys.readouterr().err


@pytest.mark.parametrize(("wrong", "answer"), [("rnu", "did you mean 'run'"), ("xyz", "see --help")])
def test_a_command_that_is_mistyped_is_answered_by_near_ones(wrong: str, answer: str, capsys) -> None:
    with pytest.raises(SystemExit, match="2"):
        main([wrong, "demo"])
    assert answer in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize(
    ("line", "one"),
    [
        ("canhaptic ru", "run"),
        ("canhaptic check hard/sti", "hard/stiff_wall"),
        ("canhaptic run demo --no-t", "--no-torque"),
    ],
)
def test_a_shell_completes_commands_scenes_and_options(line: str, one: str) -> None:
    read, write = os.pipe()
    asked = {"_ARGCOMPLETE": "1", "_ARGCOMPLETE_IFS": "\n", "COMP_LINE": line, "COMP_POINT": str(len(line))}
    subprocess.run(
        ["bash", "-c", f'exec "{sys.executable}" -m canhaptic 8>&{write}'],
        env=os.environ | asked, pass_fds=[write], check=True, timeout=60,
    )  # fmt: skip
    os.close(write)
    with os.fdopen(read) as answered:
        assert one in [word.strip() for word in answered.read().splitlines()]
