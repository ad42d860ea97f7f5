"""The programs behind a rig that can run here say what they are there to say; those that cannot are marked."""

import ast
import json
import os
import re
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from tests.docs.documents import ROOT

WORLDS = ROOT / "examples" / "worlds"


def started(name: str, folder: Path) -> "subprocess.Popen[str]":
    words = [sys.executable, "-W", "error", str(WORLDS / name), "virtual"]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    pipe = subprocess.PIPE
    return subprocess.Popen(words, cwd=folder, env=environment, stdout=pipe, stderr=pipe, text=True)


def test_every_program_is_listed_is_short_and_says_where_it_was_not_run() -> None:
    page = (WORLDS / "README.md").read_text(encoding="utf-8")
    listed = dict(re.findall(r"^\| `(\w+\.py)` \|.*\| ([^|]+) \|$", page, re.MULTILINE))
    assert sorted(listed) == sorted(path.name for path in WORLDS.glob("*.py"))
    for name, said in listed.items():
        text = (WORLDS / name).read_text(encoding="utf-8")
        ast.parse(text)
        assert len(text.splitlines()) <= 45
        assert said.startswith("by a test") or "Not run" in text.splitlines()[0], name


@pytest.mark.slow
def test_mujoco_says_what_the_hand_touched(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    out, error = started("mujoco_ball.py", tmp_path).communicate(timeout=100)
    assert re.match(r"[1-9]\d+ frames in touch, ball at 50 mm\nyes 0\.0\n", out), error


@pytest.mark.slow
def test_a_game_that_sends_json_has_the_hand_and_its_wall(tmp_path: Path) -> None:
    frame = json.dumps({"wall": 0.02, "pushes": "-", "speed": 0.0, "work": 0.0}).encode()
    came = []
    with started("unity_bridge.py", tmp_path) as bridge, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as game:
        game.connect(("127.0.0.1", 5600))
        game.settimeout(0.05)
        while bridge.poll() is None:
            try:
                game.send(frame)
                came.append(json.loads(game.recv(4096)))
            except OSError:  # not there yet, or no frame of it has come
                continue
        _, error = bridge.communicate(timeout=10)
    assert bridge.returncode == 0, error
    assert len(came) > 20
    assert max(hand["x"] for hand in came) > 0.01
