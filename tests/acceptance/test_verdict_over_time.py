"""A verdict does not forget: energy that went out for certain stays said, in every view of the run."""

import json
from pathlib import Path

import h5py
import pytest

import canhaptic
from canhaptic.audit.inspection import inspect
from canhaptic.audit.recompute import recompute_all, rederive, scene_of
from canhaptic.cli.main import main
from canhaptic.logs.energy_reader import EnergyLog
from canhaptic.result import with_groups
from canhaptic.view.series import LiveLog

CONFIGS = Path(__file__).parents[2] / "configs"
SHAFT = "[{type: shaft_compliance, load_mass: 0.15 kg, stiffness: 2e4 N/m, damping: 1 N*s/m}]"
FALSE = {
    "a mass behind a shaft": [
        "environment.stiffness=20000", "environment.damping=0", "passivity.hand_force=20",
        "simulation.plant.mass=0.1", "passivity.moving_mass=0.226", f"simulation.effects={SHAFT}",
    ],
    "a mass three times too large": [
        "environment.stiffness=40000", "environment.damping=0", "passivity.hand_force=10", "passivity.moving_mass=0.75",
    ],
}  # fmt: skip
"""Scenes of the demonstration that declare what the plant is not."""


def run(folder: Path, changes: list[str], duration: float) -> None:
    words = [word for value in changes for word in ("--set", value)]
    log, bus = str(folder / "run.h5"), str(folder / "run.log")
    main(["run", str(CONFIGS / "demo.yaml"), "--pace", "free", "--duration", str(duration), "--log", log, *words,
          "--bus-log", bus, "--json"])  # fmt: skip


@pytest.mark.parametrize("changes", FALSE.values(), ids=FALSE)
@pytest.mark.slow_but("1.3-*large")
@pytest.mark.parametrize("duration", [1.3, 4.0, 20.0])
def test_what_the_account_knows_once_it_says_until_the_end(changes: list[str], duration: float, tmp_path, capsys):
    run(tmp_path, changes, duration)
    result = json.loads(capsys.readouterr().out)
    port = result["ports"]["handle"]
    assert (result["verdict"], port["passive"], port["plant_passive"]) == ("no", "no", "no")
    assert 1.1 < port["active_since"] < 1.3
    assert (port["contradicted"], port["certificates"]) == (["hand_force"], ["none"])
    assert "moving_mass" in port["suspects"]
    if duration > 3.0:
        assert port["energy_resolution"] > 1e-3
    with EnergyLog.open(tmp_path / "run.h5") as log:
        whole = inspect(log)["ports"]["handle"]
        assert all(outcome["mismatch"] is None for outcome in recompute_all(log))
        derived = rederive(tmp_path / "run.log", scene_of(log), log)["ports"]["handle"]
        column = log.ports["handle"]["active"]
        assert 0 < int(column.argmax()) * log.sample_time == pytest.approx(port["active_since"])
        assert set(column[column.argmax() :].tolist()) == {1}
        rest = inspect(log, start=1.25)["ports"]["handle"]
    assert rest["active_before"]
    assert rest["passive"] == "no"
    assert "active_since" not in rest
    live = with_groups(LiveLog(tmp_path / "run.h5").look().accounts, {})["handle"]
    for account in (whole, derived, live):
        assert account["passive"] == "no"
        assert account["active_since"] == pytest.approx(port["active_since"])
        assert account["contradicted"] == ["hand_force"]


@pytest.mark.slow
def test_a_changed_latch_in_a_log_is_noticed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run(tmp_path, FALSE["a mass behind a shaft"], 1.3)
    capsys.readouterr()
    with h5py.File(tmp_path / "run.h5", "r+") as file:
        file["ports/handle/active"][:] = 0
    with EnergyLog.open(tmp_path / "run.h5") as log:
        (outcome,) = recompute_all(log)
    assert outcome["mismatch"] is not None
    assert outcome["mismatch"]["quantity"] == "active"


@pytest.mark.slow
def test_a_resolution_that_is_an_estimate_says_no_at_no_time() -> None:
    changes = {"passivity": {"algorithm": "unprotected", "current_lag": "0.2 ms"}, "environment.stiffness": "10 kN/m",
               "environment.damping": 0.0}  # fmt: skip
    result = canhaptic.simulate(CONFIGS / "demo.yaml", changes, duration=1.4, progress=False, check=False)
    port = result.account.raw["ports"]["handle"]
    assert port["resolution_is_estimated"]
    assert (port["passive"], port["plant_passive"], port["verdict"]) == ("in doubt", "no", "no")
    assert "active_since" not in port


@pytest.mark.slow
def test_below_zero_at_the_motor_a_promise_at_the_handle_holds() -> None:
    changes = {"environment.stiffness": "20 kN/m", "environment.damping": 0.0, "passivity.device_friction": "1 N",
               "passivity.hand_force": 5.0,
               "simulation.effects": [{"type": "coulomb_friction", "static": 1.0, "kinetic": 1.0}]}  # fmt: skip
    result = canhaptic.simulate(CONFIGS / "demo.yaml", changes, duration=2.0, progress=False)
    port = result.account.raw["ports"]["handle"]
    assert "active_since" in port
    assert "contradicted" not in port
    assert (port["passive"], port["passive_at_handle"], port["verdict"]) == ("no", "yes", "yes")


@pytest.mark.slow
def test_an_allowance_moves_the_limit_of_account_and_plant() -> None:
    changes = {"environment.stiffness": "40 kN/m", "environment.damping": 0.0, "passivity.hand_force": 10.0,
               "passivity.moving_mass": 0.75, "passivity.energy_allowance": 1.0}  # fmt: skip
    result = canhaptic.simulate(CONFIGS / "demo.yaml", changes, duration=1.3, progress=False)
    port = result.account.raw["ports"]["handle"]
    assert port["least_interaction"] < -1e-3
    assert (port["passive"], port["plant_passive"], port["energy_allowance"]) == ("yes", "yes", 1.0)


@pytest.mark.slow
def test_a_group_was_active_by_its_sum_and_no_axis_by_itself() -> None:
    changes = {"groups.stage.network.stiffness": 40000, "groups.stage.network.damping": 0,
               "groups.stage.passivity.moving_mass": 0.75}  # fmt: skip
    result = canhaptic.simulate(CONFIGS / "xy_box.yaml", changes, duration=0.3, progress=False, check=False)
    port = result.account.raw["ports"]["stage"]
    assert (port["passive"], port["verdict"], port["contradicted"]) == ("no", "no", ["hand_force"])
    columns = result.to_numpy()
    assert columns["stage.active"][-1] == 1
    assert not columns["x.active"].any() | columns["y.active"].any()
