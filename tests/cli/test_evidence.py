"""Evidence of a drive: a folder from which others replay and derive again what was seen; what a person reads first."""

import hashlib
import json
import re
import signal
from pathlib import Path
from typing import Any

import pytest

from canhaptic.cli.commission import _confirmed
from canhaptic.cli.long_command import check_list, walls_first
from canhaptic.cli.main import main
from canhaptic.commission.session import Unattended
from canhaptic.cycle import run
from canhaptic.scene.build import build
from canhaptic.scene.load import load_scene
from canhaptic.scene.models import CHECK_LIST, CheckItem

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
DEMO = CONFIGS / "demo.yaml"
EDS = CONFIGS.parent / "eds" / "cia402_servo.eds"


@pytest.mark.slow
def test_a_bundle_of_the_simulated_drive_is_replayed_and_derived_again(tmp_path, monkeypatch, capsys) -> None:
    text = EDS.read_text().replace("CreatedBy=", "CreatedBy=Ada Lovelace ") + "\n"
    (tmp_path / "mine.eds").write_text(text)
    monkeypatch.chdir(tmp_path)
    assert main(["new", "mine.eds", "--simulate", "--out", "rig.yaml"]) == 0
    assert (
        main(["evidence", "rig.yaml", "--out", "bundle", "--yes", "--anonymous", "--travel", "0.1", "--duration", "2"])
        == 0
    )
    bundle, log = tmp_path / "bundle", str(tmp_path / "bundle" / "tenth.h5")
    listed = dict(re.findall(r"^\| (\S+) \| ([0-9a-f]{64}) \|$", (bundle / "sign.md").read_text(), re.MULTILINE))
    assert {*listed, "sign.md"} == {file.name for file in bundle.iterdir()}
    assert {
        "rig.yaml",
        "drive0.eds",
        "commissioning.json",
        "versions.json",
        "dry_run.log",
        "tenth.log",
    } <= listed.keys()
    for name, seen in listed.items():
        content = (bundle / name).read_bytes()
        assert hashlib.sha256(content).hexdigest() == seen
        assert b"Lovelace" not in content
        assert str(tmp_path).encode() not in content
    for name in ("tenth", "dry_run"):
        words = ["--config", "bundle/rig.yaml", "--energy-log", f"bundle/{name}.h5"]
        assert main(["replay", "--quick", f"bundle/{name}.log", *words]) == 0
    assert main(["inspect", log, "--recompute", "--bus-log", "bundle/tenth.log"]) == 0
    assert "account equal bit for bit" in capsys.readouterr().out
    tenth, dry = (json.loads((bundle / f"{name}.json").read_text()) for name in ("tenth", "dry_run"))
    [scene] = load_scene(bundle / "rig.yaml").axes
    assert tenth["ports"]["axis1"]["verdict"] == "yes"
    assert dry["verdict"] == "dry run"
    assert dry["ports"]["axis1"]["withheld_torque"] <= scene.parameters.torque_limit
    assert {row["item"]: row["verdict"] for row in json.loads((bundle / "commissioning.json").read_text())["findings"]}[
        "torque scale"
    ] == "agrees"


def test_no_evidence_of_a_real_drive_without_a_person_or_with_values_to_set(tmp_path, capsys) -> None:
    scene, out = str(CONFIGS / "socketcan_example.yaml"), tmp_path / "bundle"
    assert main(["evidence", scene, "--out", str(out), "--yes"]) == 2
    assert "values to set" in capsys.readouterr().err
    assert main(["evidence", str(DEMO), "--out", str(tmp_path), "--yes"]) == 2
    assert "already exists" in capsys.readouterr().err
    assert not out.exists()


def test_walls_are_shown_before_any_torque_where_the_counts_begin_at_power_on(capsys) -> None:
    sets = ["axes.0.position_reference=at_start", "simulation.plant.initial_position=0.02 m"]
    with build(load_scene(DEMO, sets)) as experiment:
        seen: list[float] = []

        def sent_so_far() -> bool:
            seen.append(experiment.rig.drives[0].limiter.last)
            return False

        asked = walls_first(experiment, sent_so_far)
        run(experiment.cycle, 3, asked)
    said = capsys.readouterr().err
    assert said.count("the handle is 0.02 m from its position at power-on; position: -0.05 m (-0.07 m from here)") == 1
    assert seen[0] == 0.0
    with build(load_scene(DEMO)) as experiment:
        assert walls_first(experiment, lambda: True)()
    assert not capsys.readouterr().err  # absolute positions


def test_what_was_confirmed_and_when_is_kept_and_changes_no_configuration() -> None:
    said: list[str] = []
    confirmed = _confirmed(Unattended(said.append))
    assert confirmed.keys() == CHECK_LIST.keys()
    assert all(re.fullmatch(r"\d{4}-\d\d-\d\d \d\d:\d\d UTC", moment) for moment in confirmed.values())
    given: dict[CheckItem, str] = {"brake": "2026-11-23 10:00 UTC"}
    lines = list(check_list(given))
    assert [line for line in lines if line.startswith("x")] == [
        "x brake: the brake holds, and releases before any torque; or there is none; 2026-11-23 10:00 UTC"
    ]
    assert sum(line.endswith("not confirmed") for line in lines) == len(CHECK_LIST) - 1
    scene = load_scene(DEMO, ['confirmed={brake: "2026-11-23 10:00 UTC"}'])
    assert scene.resolved()["run"]["confirmed"] == given  # as the log holds it
    assert scene.config_hash() == load_scene(DEMO).config_hash()


@pytest.mark.slow
def test_evidence_ends_at_the_first_signal_without_another_run_and_without_a_page_to_sign(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(*words: Any, **more: Any) -> Any:
        signal.raise_signal(signal.SIGHUP)  # between the question and the start of the dry run
        return build(*words, **more)

    monkeypatch.setattr("canhaptic.cli.evidence.walk", lambda session, duration: ([], None))
    monkeypatch.setattr("canhaptic.cli.evidence.build", interrupted)
    out = tmp_path / "bundle"
    assert main(["evidence", str(DEMO), "--yes", "--out", str(out), "--duration", "1"]) == 129
    assert {file.name for file in out.iterdir()} >= {"dry_run.log", "dry_run.json"}
    assert not list(out.glob("tenth*"))
    assert not (out / "sign.md").exists()
    assert not re.search(r"201#0[67F]00", (out / "dry_run.log").read_text())  # nothing was enabled
    assert "is incomplete and has no page to sign" in capsys.readouterr().err
