import argparse
import json
from pathlib import Path

import pytest

from canhaptic.cli.main import main
from canhaptic.errors import InputError
from canhaptic.view.inspect_command import add_arguments, execute

DEMO = Path(__file__).parents[2] / "configs" / "demo.yaml"


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    folder = tmp_path_factory.mktemp("rederive")
    energy, bus = folder / "run.h5", folder / "run.log"
    words = ["run", str(DEMO), "--duration", "1.3", "--pace", "free", "--log", str(energy), "--bus-log", str(bus)]
    assert main([*words, "--json"]) == 0
    return energy, bus


def command(*words: str | Path) -> int:
    parser = argparse.ArgumentParser()
    add_arguments(parser)
    return execute(parser.parse_args([str(word) for word in words]))


def test_frames_alone_give_the_logged_account_bit_for_bit(
    logs: tuple[Path, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    energy, bus = logs
    assert command(energy, "--bus-log", bus, "--recompute", "--check", "in > 1 mJ") == 0
    text = capsys.readouterr().out
    assert "from the frames alone: 1300 cycles, samples and account equal bit for bit" in text
    assert "recomputed, every output equal bit for bit" in text


def test_one_flipped_bit_in_one_recorded_position_is_found(
    logs: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    energy, bus = logs
    lines = bus.read_text().splitlines(keepends=True)
    positions = [number for number, line in enumerate(lines) if " 181#" in line]
    chosen = positions[-100]
    start = lines[chosen].index("#") + 5  # the low byte of the position, behind the statusword
    flipped = f"{int(lines[chosen][start : start + 2], 16) ^ 1:02X}"
    lines[chosen] = lines[chosen][:start] + flipped + lines[chosen][start + 2 :]
    (tmp_path / "run.log").write_text("".join(lines))
    assert command(energy, "--bus-log", tmp_path / "run.log", "--json") == 1
    (found,) = json.loads(capsys.readouterr().out)["rederived"]["differences"]
    assert found["quantity"] == "position"
    assert found["logged"] != found["rederived"]


def test_a_bus_log_alone_can_be_inspected_with_its_scene(
    logs: tuple[Path, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    assert command(logs[1], "--config", DEMO, "--check", "deficit == 0") == 0
    assert "derived from the frames of run.log" in capsys.readouterr().out
    with pytest.raises(InputError, match="--config"):
        command(logs[1])


def test_another_scene_is_refused(logs: tuple[Path, Path], tmp_path: Path) -> None:
    other = tmp_path / "other.yaml"
    other.write_text(DEMO.read_text().replace("stiffness: ", "stiffness: 1"))
    with pytest.raises(InputError):
        command(logs[0], "--recompute", "--config", other)
