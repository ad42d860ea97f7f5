"""A run on a simulated EtherCAT line is logged frame by frame, and its replay finds every difference."""

from pathlib import Path

import pytest

from canhaptic.cli.main import main
from canhaptic.errors import InputError
from canhaptic.logs.frame_log import FrameLog, read_frame_log
from canhaptic.replay import replay_line
from canhaptic.scene.load import load_scene
from tests.conftest import REPOSITORY

SCENE = REPOSITORY / "configs" / "ethercat.yaml"
CHANGES = ["duration=0.3 s", "environment.position=0.01 rad", "environment.side=above"]
SHORT = [word for change in CHANGES for word in ("--set", change)]


@pytest.fixture
def log(tmp_path: Path) -> Path:
    path = tmp_path / "line.pcap"
    assert main(["run", str(SCENE), *SHORT, "--bus-log", str(path)]) == 0
    return path


def test_every_frame_of_a_run_is_sent_again_and_another_scene_is_named(log: Path, capsys) -> None:
    capsys.readouterr()
    assert main(["replay", str(log), "--config", str(SCENE), *SHORT]) == 0
    assert "identical" in capsys.readouterr().out
    assert main(["replay", str(log), "--config", str(SCENE), *SHORT, "--set", "environment.stiffness=1.9 N*m/rad"]) == 1
    assert "recorded 0x" in capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.parametrize("change", ["bus.frames=1", "simulation.bus={falls_to_safe_op: 0.2 s}", "bus.rate=500"])
def test_a_run_that_ended_before_its_scene_says_is_replayed_to_its_end(change: str, tmp_path: Path) -> None:
    path, changes = tmp_path / "line.pcap", [*SHORT[2:], "--set", change]
    main(["run", str(SCENE), *changes, "--duration", "0.4", "--bus-log", str(path)])
    assert main(["replay", str(path), "--config", str(SCENE), *changes]) == 0


@pytest.mark.slow
def test_one_flipped_bit_of_an_answer_is_named(log: Path) -> None:
    frames = read_frame_log(log)
    number = next(
        n for n in range(len(frames) - 400, len(frames)) if frames[n].is_answer and frames[n].content[50] == 10
    )
    content = bytearray(frames[number].content)
    content[62] ^= 0x20  # of the position
    frames[number] = frames[number]._replace(content=bytes(content))
    with FrameLog(log) as changed:
        for frame in frames:
            changed.note(frame.time, frame.content)
    result = replay_line(log, load_scene(SCENE, CHANGES))
    assert result.difference.startswith("frame ")
    assert result.compared < result.recorded


@pytest.mark.slow
def test_a_scene_on_can_is_refused(log: Path) -> None:
    with pytest.raises(InputError, match="give the scene of one such line"):
        replay_line(log, load_scene(REPOSITORY / "configs" / "demo.yaml"))
