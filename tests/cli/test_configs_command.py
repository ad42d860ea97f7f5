"""`canhaptic configs`: every scene says what it is, and a copy overwrites nothing."""

import json
from pathlib import Path

import pytest

from canhaptic.cli.main import main


def test_every_scene_says_what_it_is(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["configs", "--json"]) == 0
    scenes = json.loads(capsys.readouterr().out)["configs"]
    assert "demo.yaml" in scenes
    assert all(len(about) > 20 for about in scenes.values()), scenes


def test_a_copy_is_a_whole_scene_and_is_not_overwritten(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["configs", "--copy", str(tmp_path)]) == 0
    assert main(["check", str(tmp_path / "configs" / "demo.yaml"), "--json"]) == 0
    capsys.readouterr()
    assert main(["configs", "--copy", str(tmp_path)]) == 2
    assert "already exists" in capsys.readouterr().err
