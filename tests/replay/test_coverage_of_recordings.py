import tomllib
from collections.abc import Callable
from pathlib import Path
from pkgutil import resolve_name
from typing import Any
from xml.etree import ElementTree

import pytest

from canhaptic.audit.replay_coverage import _others, covered, scene_next_to
from canhaptic.cli.main import main
from canhaptic.cli.pytest_replay import canhaptic_replay  # noqa: F401 - also an entry point, where it is installed
from canhaptic.errors import InputError
from canhaptic.replay import replay_bus_log
from canhaptic.scene.load import load_scene

ROOT = Path(__file__).resolve().parents[2]
DEMO = ROOT / "configs" / "demo.yaml"
RECORDED = ROOT / "tests" / "recordings" / "demo.log"
Replay = Callable[..., dict[str, Any]]


@pytest.fixture
def empty(tmp_path: Path) -> Path:
    """A recording of the demo that ends away from the wall."""
    path = tmp_path / "empty.log"
    lines = RECORDED.read_text().splitlines(keepends=True)
    start = next(
        n for n, line in enumerate(lines) if " 201#0F00" in line and not line.split("#")[1].startswith("0F000000")
    )
    path.write_text("".join(lines[: start - 1000]))
    return path


@pytest.mark.slow
def test_a_recording_without_torque_fails_unless_that_is_allowed(empty: Path, capsys) -> None:
    words = ["replay", str(empty), "--config", str(DEMO), "--set", "environment.stiffness=900", "--quick"]
    assert main(words) == 1
    assert "handle: not tested: no torque was sent" in capsys.readouterr().out
    assert main([*words, "--allow-empty"]) == 0


@pytest.mark.slow
def test_a_key_leaves_a_trace_where_another_value_sends_other_frames() -> None:
    scene = load_scene(DEMO)
    result = replay_bus_log(RECORDED, scene)
    found = covered(result, scene)
    assert found["commands"]["handle"] == sum(" 201#0F00" in line and "#0F000000" not in line for line in _lines())
    assert (found["stop"], found["untested"]) == ("operator", [])
    assert found["contacts"]["handle"] >= found["commands"]["handle"] > 0
    tried = {"environment.stiffness", "environment.damping", "environment.position", "passivity.hand_push"}
    assert tried & set(found["untraced"]) == {"passivity.hand_push"}


@pytest.mark.slow
def test_a_replay_that_ends_at_another_frame_says_no_more_than_that(capsys: pytest.CaptureFixture[str]) -> None:
    """It ended before the first torque, which the recording has."""
    assert main(["replay", str(RECORDED), "--config", str(DEMO), "--set", "environment.stiffness=900"]) == 1
    out = capsys.readouterr().out
    assert "different at line" in out
    assert "not tested: no torque" not in out


def _lines() -> list[str]:
    return RECORDED.read_text().splitlines()


@pytest.mark.parametrize(
    ("value", "others"),
    [
        ("100 N/m", ['"125 N/m"', '"80 N/m"']),
        ("0", ["2", "1"]),
        ("1", ["2"]),
        ("1e6 count/m", ['"1250000.0 count/m"', '"800000.0 count/m"']),
    ],
)
def test_another_value_keeps_the_unit(value: str, others: list[str]) -> None:
    assert list(_others(value)) == others


@pytest.mark.slow
def test_the_result_is_a_test_case_of_junit(empty: Path, tmp_path: Path) -> None:
    file = tmp_path / "result.xml"
    words = ["replay", str(empty), "--config", str(DEMO), "--quick", "--junit", str(file), "--json"]
    assert main(words) == 1
    (case,) = ElementTree.parse(file).getroot()
    assert case.find("failure").get("message").startswith("handle: not tested")
    assert main([*words, "--allow-empty"]) == 0
    assert ElementTree.parse(file).getroot().get("failures") == "0"


@pytest.mark.slow
def test_the_fixture_fails_a_test_as_the_command_does(canhaptic_replay: Replay, empty: Path) -> None:  # noqa: F811
    assert canhaptic_replay(RECORDED, DEMO, keys=False)["status"] == "identical"
    with pytest.raises(pytest.fail.Exception, match="different at line"):
        canhaptic_replay(RECORDED, DEMO, {"environment.stiffness": 101}, keys=False)
    with pytest.raises(pytest.fail.Exception, match="no torque was sent"):
        canhaptic_replay(empty, DEMO, keys=False)


def test_pytest_finds_the_fixture_by_its_entry_point() -> None:
    listed = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["entry-points"]["pytest11"]
    assert hasattr(resolve_name(listed["canhaptic"]), "canhaptic_replay")


def test_the_scene_is_found_next_to_the_log_and_never_guessed(tmp_path: Path) -> None:
    (folder := tmp_path / "recordings").mkdir()
    log = folder / "press.log"
    with pytest.raises(InputError, match="found no scene next to it"):
        scene_next_to(log)
    (tmp_path / "rig.yaml").touch()
    assert scene_next_to(log) == tmp_path / "rig.yaml"
    (tmp_path / "other.yaml").touch()
    with pytest.raises(InputError, match=r"got the scenes other\.yaml, rig\.yaml"):
        scene_next_to(log)
    (folder / "press.yaml").touch()
    assert scene_next_to(log) == scene_next_to(folder / "press.log.gz") == folder / "press.yaml"
