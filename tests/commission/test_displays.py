"""`commission` of an admittance display: what it finds of sensor and drive, against what is simulated."""

import json
from pathlib import Path
from typing import Any

import pytest

from canhaptic.cli.main import main
from canhaptic.commission.admittance_tests import _loop
from canhaptic.commission.session import CommissioningLimits, Session, Unattended
from canhaptic.scene.load import load_scene

SCENE = str(Path(__file__).parents[2] / "configs" / "admittance" / "virtual_mass.yaml")


def _commissioned(capsys: pytest.CaptureFixture[str], *overrides: str) -> tuple[int, dict[str, Any]]:
    words = [word for override in ("bus.rate=500", *overrides) for word in ("--set", override)]
    status = main(["commission", SCENE, "--yes", "--json", *words])
    report = json.loads(capsys.readouterr().out)
    return status, {finding["item"]: finding for finding in report["findings"]} | {
        "values": {value["key"]: value["text"] for value in report["values"] if value["text"]}
    }


@pytest.mark.slow
def test_a_right_configuration_agrees_and_the_drive_is_measured(capsys: pytest.CaptureFixture[str]) -> None:
    status, found = _commissioned(capsys)
    assert status == 0
    verdicts = {item: of["verdict"] for item, of in found.items() if item != "values"}
    assert verdicts.pop("friction of the drive") == "measured"  # none is declared
    kept = {item: verdicts.pop(item) for item in list(verdicts) if item.startswith("0x")}
    assert set(kept.values()) == {"measured"}
    assert any(item.startswith("0x6085:00") for item in kept)
    assert set(verdicts.values()) == {"agrees"}
    assert float(found["mass of the drive"]["found"].split()[0]) == pytest.approx(2.0, rel=0.03)
    assert float(found["gain of the velocity loop"]["found"].split()[0]) == pytest.approx(630.0, rel=0.02)
    assert set(found["values"]) == {"settings_checked"}


@pytest.mark.slow
def test_a_late_sensor_with_an_offset_and_a_heavy_drive_are_found(capsys: pytest.CaptureFixture[str]) -> None:
    wrong = (
        "simulation.admittance.sensor.latency=2",
        "simulation.admittance.sensor.offset=5",
        "simulation.plant.mass=3",
    )
    status, found = _commissioned(capsys, *wrong)
    assert status == 1
    assert found["latency of the force"]["found"] == "2 samples"
    assert found["values"]["admittance.force.offset_counts"].startswith("499")
    assert found["values"]["admittance.force.latency"] == "2"
    assert found["values"]["passivity.drive_mass"].startswith("3.2")


@pytest.mark.slow
def test_a_wrong_sign_fails(capsys: pytest.CaptureFixture[str]) -> None:
    status, found = _commissioned(capsys, "simulation.admittance.sensor.gain=-1")
    assert status == 1
    assert found["sign of the force"]["verdict"] == "failed"
    assert found["values"]["admittance.force.per_count"] == "-0.01 N"


def test_a_stop_while_the_drive_moves_leaves_the_loop_untried() -> None:
    session = Session(load_scene(SCENE), Unattended(lambda _: None), CommissioningLimits(), lambda: True)
    with session.rig_of(with_hand=True):
        _loop(session, 0)
    assert [(found.item, found.found) for found in session.report.findings] == [("velocity loop", "not tried")]
