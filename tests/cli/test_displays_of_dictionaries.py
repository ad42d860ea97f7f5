"""`check-eds --display`, `new --display`, `check` and `run` say the same of every dictionary, simulated and real."""

import json
import re
from pathlib import Path
from typing import Any

import pytest

from canhaptic.cli.main import main

OURS = Path(__file__).resolve().parents[2] / "eds"
VENDORS = (
    *("elmo_gold.dcf", "elmo_simpliq.dcf", "kollmorgen_rgm.eds", "maxon_epos2.eds", "maxon_epos4.dcf"),
    *("schunk_prl.dcf", "zeroerr_erob.eds"),
)
NAMES = [*sorted(path.name for path in OURS.glob("*.eds")), *VENDORS]
LIMIT = re.compile(r"(?m)^ *limit_in_drive:.*\n")


def dictionary(name: str, request: pytest.FixtureRequest) -> str:
    """The path of a dictionary; skips, visibly, where it is a vendor's and their folder is not named."""
    return str((request.getfixturevalue("vendor_eds") if name in VENDORS else OURS) / name)


def judged(eds: str, mode: str, capsys: pytest.CaptureFixture[str]) -> tuple[int, dict[str, Any]]:
    status = main(["check-eds", eds, "--display", mode, "--json"])
    return status, json.loads(capsys.readouterr().out)


@pytest.mark.slow_but("cia402_servo.eds-*", "cia402_admittance.eds-velocity")
@pytest.mark.parametrize("mode", ["velocity", "position"])
@pytest.mark.parametrize("name", NAMES)
def test_a_dictionary_that_is_fit_gives_a_simulated_display_that_runs_and_another_none(
    name: str, mode: str, request: pytest.FixtureRequest, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    eds, scene = dictionary(name, request), str(tmp_path / "rig.yaml")
    unfit, found = judged(eds, mode, capsys)
    status = main(["new", eds, "--display", mode, "--simulate", "--out", scene])
    if unfit:
        assert status == 2
        assert "; ".join(found["reasons"]) in capsys.readouterr().err
        return
    assert status == 0
    assert main(["check", scene, "--json"]) == 0
    assert main(["run", scene, "--duration", "0.02", "--json"]) == 0


@pytest.mark.slow_but("cia402_admittance.eds-velocity")
@pytest.mark.parametrize("mode", ["velocity", "position"])
@pytest.mark.parametrize("name", NAMES)
def test_a_dictionary_that_is_fit_gives_a_real_display_that_waits_for_its_marks_alone(
    name: str, mode: str, request: pytest.FixtureRequest, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    eds, scene = dictionary(name, request), tmp_path / "rig.yaml"
    channel = ["--set", "bus.channel=no_such_bus"]
    unfit, found = judged(eds, mode, capsys)
    status = main(["new", eds, "--display", mode, "--out", str(scene)])
    if unfit:
        assert status == 2
        assert "; ".join(found["reasons"]) in capsys.readouterr().err
        return
    assert status == 0
    assert main(["check", str(scene), "--json"]) == 1
    assert json.loads(capsys.readouterr().out)["to_set"]
    assert main(["run", str(scene), *channel]) == 2
    assert "marked TO SET" in capsys.readouterr().err
    scene.write_text(scene.read_text().replace("TO SET", ""))
    assert main(["check", str(scene)]) == 1  # a display's drive takes the torque that it needs
    assert "axis1.torque_verified" in capsys.readouterr().out
    scene.write_text(scene.read_text().replace("torque_verified: no", "torque_verified: balance"))
    assert main(["check", str(scene), "--json"]) == 0
    assert main(["run", str(scene), *channel]) != 0
    assert "no_such_bus: interface: got none" in capsys.readouterr().err  # all that is left is the bus
    said = [text for text in found["conditions"] if text.startswith("0x6072") and "limit_in_drive" in text]
    assert bool(said) == bool(LIMIT.search(scene.read_text()))
    scene.write_text(LIMIT.sub("", scene.read_text()))
    for command in ("check", "run"):
        assert (main([command, str(scene), *channel, "--json"]) == 2) == bool(said)
        assert all(text in capsys.readouterr().err for text in said)


@pytest.mark.slow_but("6083")
@pytest.mark.parametrize("index", ["6083", "6084", "60C5", "60C6"])
def test_a_ramp_in_the_drive_that_would_bend_the_command_is_refused_and_a_starter_stays_below_it(
    index: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text, eds, scene = (OURS / "cia402_admittance.eds").read_text(), tmp_path / "slow.eds", tmp_path / "rig.yaml"
    text = text.replace("DefaultValue=0xFFFFFFFF", "DefaultValue=10000")
    eds.write_text(text.replace(f"[{index}]\n", f"[{index}]\nHighLimit=65500\n"))
    assert main(["new", str(eds), "--display", "velocity", "--simulate", "--out", str(scene)]) == 0
    assert "acceleration_limit: 6.22 rad/s^2" in scene.read_text()  # 65500 of 65536 / 2 pi counts, less 1 %
    assert main(["run", str(scene), "--duration", "0.02", "--json"]) == 0
    for command in ("check", "run"):
        capsys.readouterr()
        assert main([command, str(scene), "--set", "axes.0.admittance.acceleration_limit=6.3", "--json"]) == 2
        assert "ramps: take 6.28 rad/s^2 at most" in capsys.readouterr().err


def test_every_vendor_dictionary_is_walked(vendor_eds: Path) -> None:
    assert {path.name for path in vendor_eds.iterdir() if path.suffix in (".dcf", ".eds")} == set(VENDORS)
