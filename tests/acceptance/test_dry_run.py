"""`run --no-torque` over the whole CAN path: no frame carries a torque, and the account books and claims nothing."""

import json
import struct
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import canhaptic
from canhaptic.audit.inspection import inspect
from canhaptic.audit.recompute import recompute_all, rederive
from canhaptic.cli.main import main
from canhaptic.cycle import run
from canhaptic.errors import InputError
from canhaptic.logs.energy_reader import EnergyLog
from canhaptic.replay import replay_bus_log
from canhaptic.scene.build import build
from canhaptic.scene.load import load_scene
from canhaptic.view.series import LiveLog
from tests.acceptance.bus_frames import DEMO, commands, read_log
from tests.acceptance.group_runs import REPOSITORY

CONFIGS = REPOSITORY / "configs"
LOSSES = "simulation.bus={drop: 0.03, direction: to_master}"
PATIENT = ("bus.hold_cycles=10", "bus.stop_cycles=20")
ONE = ("demo", ("environment.side=above",))
WITH_LOSSES = ("demo", ("environment.side=above", LOSSES, *PATIENT))
MEASURED = ("demo", ("environment.side=above", "axes.0.read_back=actual"))
UNREAD = ("demo", ("environment.side=above", LOSSES, *PATIENT, "axes.0.read_back=none"))
GROUP = ("xy_box", (LOSSES, *PATIENT))
OTHER_GROUP = ("two_handles", ())  # loses frames by itself
KINDS = {"one axis": ONE, "losses": WITH_LOSSES, "group": GROUP, "another group": OTHER_GROUP}

PUSHY = """
from canhaptic.control.passivity.unprotected import Unprotected


class Pushy(Unprotected):
    def step(self, position, torque_applied):
        assert torque_applied == 0.0
        return super().step(position, torque_applied)._replace(torque=9.0)
"""


class DryRun:
    """A shipped scene run dry for 0.3 s: its result, its frames and its log."""

    def __init__(self, kind: tuple[str, tuple[str, ...]], folder: Path, *, no_torque: bool = True) -> None:
        name, self.overrides = kind
        self.scene = load_scene(CONFIGS / f"{name}.yaml", self.overrides)
        self.log, self.bus = folder / "run.h5", folder / "run.log"
        words = ["--no-torque"] if no_torque else []
        sets = [word for text in self.overrides for word in ("--set", text)]
        files = ["--log", str(self.log), "--bus-log", str(self.bus)]
        config, printed = str(CONFIGS / f"{name}.yaml"), StringIO()
        with redirect_stdout(printed):
            assert main(["run", config, "--duration", "0.3", "--pace", "free", "--json", *words, *sets, *files]) == 0
        self.result: Any = json.loads(printed.getvalue())

    def torques(self) -> set[int]:
        """Target torques of every RPDO (0x201, 0x202) that the master sent."""
        sent = [f for f in read_log(self.bus) if f.can_id in (0x201, 0x202) and f.is_sent]
        assert len(sent) > 250
        return {struct.unpack("<Hh", frame.data)[1] for frame in sent}


@pytest.fixture(scope="module", params=KINDS)
def dry(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> DryRun:
    return DryRun(KINDS[request.param], tmp_path_factory.mktemp("dry"))


@pytest.mark.slow_but("one*")
def test_every_torque_sent_is_zero_while_the_requests_are_kept(dry: DryRun) -> None:
    ran, result = dry, dry.result
    assert ran.torques() == {0}
    assert result["dry_run"] is True
    with EnergyLog.open(ran.log) as log:
        assert log.dry_run
        for name, port in log.ports.items():
            assert not port["torque_applied"].any()  # as read back
            assert not port["h_i"].any(), name
            assert not port["deficit"].any()
        assert not any(truth["motor"].any() for truth in log.truth.values())
        for name, account in result["ports"].items():
            if "withheld_torque" in account:
                limit = ran.scene.axis(name).parameters.torque_limit
                asked = np.abs(log.ports[name]["torque_command"]).max()
                assert asked > 0.1
                assert account["withheld_torque"] <= min(asked, limit)


@pytest.mark.slow_but("one axis")
def test_its_account_claims_nothing(dry: DryRun) -> None:
    ran, result = dry, dry.result
    with EnergyLog.open(ran.log) as log:
        inspected = inspect(log)
    news = LiveLog(ran.log).look()
    assert inspected["dry_run"] is True
    assert news is not None
    for name, account in result["ports"].items():
        if "group" not in account:
            for found in (account, inspected["ports"][name], news.accounts[name]):
                assert (found["dry_run"], found["certificates"], found["certificate"]) == (True, [], "none")
                assert found["contact"]["without_torque"] == found["contact"]["holds"] > 0
                assert found["damping_rendered"] == {"least": 0.0, "most": 0.0}
                assert not any((found.get("rendered") or {}).values())
                assert found["energy_resolution"] == 0.0
                assert found["least_interaction"] == 0.0


@pytest.mark.slow
def test_it_is_recomputed_rederived_and_replayed_as_it_ran(dry: DryRun) -> None:
    ran = dry
    with EnergyLog.open(ran.log) as log:
        assert [found["mismatch"] for found in recompute_all(log)] == [None] * len(log.ports)
        derived = rederive(ran.bus, ran.scene, log)
        assert derived["differences"] == []
        assert all(port.get("dry_run") for port in derived["ports"].values())
    assert replay_bus_log(ran.bus, ran.scene, dry_run=True)["status"] == "identical"
    assert replay_bus_log(ran.bus, ran.scene)["status"] == "different"  # a run would have sent torques


@pytest.mark.slow
@pytest.mark.parametrize("kind", [MEASURED, UNREAD], ids=["measured", "not read back"])
def test_a_drive_that_reads_back_otherwise_books_nothing_either(kind: tuple[str, tuple[str, ...]], tmp_path) -> None:
    ran = DryRun(kind, tmp_path)
    port = ran.result["ports"]["handle"]
    assert ran.torques() == {0}
    assert (port["in"], port["out"], port["energy_resolution"], port["uncommanded_cycles"]) == (0.0, 0.0, 0.0, 0)
    assert port["read_back"] == kind[1][-1].partition("=")[2]


def test_own_code_sends_no_torque_in_a_dry_run(tmp_path: Path) -> None:
    (tmp_path / "pushy.py").write_text(PUSHY)
    (tmp_path / "scene.yaml").write_text(DEMO.read_text().replace("cia402", str(REPOSITORY / "eds" / "cia402")))
    override = "passivity={algorithm: pushy.py:Pushy}"
    scene = load_scene(tmp_path / "scene.yaml", [override], allow_code=True)
    with build(scene, "free", None, tmp_path / "run.log", no_torque=True) as experiment:
        run(experiment.cycle, 50)
        assert experiment.rig.drives[0].withheld == 9.0
    assert {command.target_torque for command in commands(read_log(tmp_path / "run.log"))} == {0}


def test_a_display_has_no_dry_run_and_leaves_no_log(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = tmp_path / "run.h5"
    assert main(["run", str(CONFIGS / "admittance" / "wall.yaml"), "--no-torque", "--log", str(log)]) == 2
    assert "an admittance display cannot run without torque" in capsys.readouterr().err
    assert not log.exists()


@pytest.mark.slow
def test_simulate_runs_dry() -> None:
    with pytest.raises(InputError, match="leave --no-torque out"):
        canhaptic.simulate(CONFIGS / "admittance" / "wall.yaml", duration=0.1, no_torque=True)
    result = canhaptic.simulate(DEMO, {"environment.side": "above"}, duration=0.2, no_torque=True)
    assert result.account.raw["dry_run"]
    assert result.account["handle"].certificate == "none"
    columns = result.to_numpy()
    assert not columns["handle.torque_applied"].any()
    assert columns["handle.torque_command"].any()
