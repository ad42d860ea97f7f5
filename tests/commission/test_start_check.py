"""`check_hold: each_start`: a drive that acts in another hold is refused, a doubt forbids a yes."""

import argparse
from pathlib import Path
from typing import Any

import pytest

import canhaptic
from canhaptic.audit.inspection import inspect
from canhaptic.audit.recompute import recompute_all, rederive, scene_of
from canhaptic.cli import run as run_command
from canhaptic.cli.options import add_arguments
from canhaptic.commission import mass_and_friction, torque_tests
from canhaptic.commission.torque_tests import checked_holds
from canhaptic.cycle import run
from canhaptic.drive.clock import WallClock
from canhaptic.errors import SceneError, StartError
from canhaptic.logs.energy_reader import EnergyLog
from canhaptic.scene.build import build, experiment_account
from canhaptic.scene.load import load_scene
from canhaptic.scene.models import Scene
from tests.commission.whole_session import DEMO

ASKED = "axes.0.check_hold=each_start"


def checked(*overrides: str) -> tuple[Scene, list[str]]:
    """The demo after its check, and what was said."""
    said: list[str] = []
    return checked_holds(load_scene(DEMO, [ASKED, *overrides]), said.append, lambda: False), said


@pytest.mark.slow
def test_logs_of_a_run_say_what_its_check_said(tmp_path: Path) -> None:
    scene, _ = checked("duration=0.3")
    energy, bus = tmp_path / "energy.h5", tmp_path / "bus.log"
    with build(scene, "free", energy, bus) as experiment:
        run(experiment.cycle, 300)
    with EnergyLog.open(energy) as log:
        assert inspect(log)["ports"]["handle"]["hold"] == "checked at this start"
        again = scene_of(log)
        assert again.config_hash() == scene.config_hash()
        assert [each["mismatch"] for each in recompute_all(log)] == [None]
        assert rederive(bus, again, log)["ports"]["handle"]["hold"] == "checked at this start"


@pytest.mark.slow_but("early")
@pytest.mark.parametrize(
    ("drive", "words"),
    [
        ("acts_at_once=true", "acts before its SYNC"),
        ("syncs_late=1", "neighbour's torque"),
        ("torque_read_back=after_update", "hold that the drive reports"),
    ],
    ids=["early", "late", "after"],
)
def test_a_drive_that_acts_in_another_hold_or_reports_it_is_refused(drive: str, words: str) -> None:
    with pytest.raises(StartError, match=f"check_hold: .*{words}"):
        checked(f"simulation.drive.{drive}")


def test_a_hold_that_nothing_tells_leaves_no_yes_by_certificate(monkeypatch: pytest.MonkeyPatch) -> None:
    """The check is broken off: what an earlier one said of the drive does not count either."""
    monkeypatch.setattr(mass_and_friction, "time_the_torque", lambda *_: None)
    known = "axes.0.hold_checked=0-192-10000-0-fada816f-1000Hz-synchronous-0"
    wall = ("environment.position=-0.002", "environment.stiffness=1000", "axes.0.counts_per_unit=2e4")
    scene, _ = checked(known, *wall, "simulation.user={push: -2, damping: 60}")  # comes in slowly, count by count
    with build(scene) as experiment:
        run(experiment.cycle, 1500)
        port = experiment_account(experiment, "completed", 1.0)["ports"]["handle"]
    assert port["hold"] == "not checked"
    assert "hand_force" in port["certificates"]
    assert (port["passive"], port["why"][:33]) == ("in doubt", "the hold of its torques was not c")


@pytest.mark.slow
def test_a_run_without_torque_or_without_the_key_checks_nothing(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(torque_tests, "checked_holds", lambda *_: pytest.fail("it moved the handle"))
    for words in (["--set", ASKED, "--no-torque"], []):
        parser = argparse.ArgumentParser()
        add_arguments("run", parser)
        arguments = parser.parse_args(
            [str(DEMO), "--duration", "0.05", "--log", str(tmp_path / f"{len(words)}.h5"), *words]
        )
        assert run_command.execute(arguments) == 0


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        (("passivity.moving_mass=null", "passivity.device_damping=0.1"), "without moving_mass"),
        (("simulation=null", "axes.0.torque_verified=no"), "not verified"),
    ],
)
def test_a_check_that_cannot_tell_a_hold_is_refused_by_the_scene(overrides: tuple[str, ...], words: str) -> None:
    with pytest.raises(SceneError, match=f"check_hold: got a check at each start .*{words}"):
        load_scene(DEMO, [ASKED, *overrides])


def test_a_person_at_a_real_drive_has_three_seconds_in_which_to_stop_it(monkeypatch: pytest.MonkeyPatch) -> None:
    times = iter(range(0, 10**12, 10**9))
    monkeypatch.setattr(WallClock, "now", lambda _: next(times))
    monkeypatch.setattr(WallClock, "wait_until", lambda *_: None)
    said: list[str] = []
    looks = iter([False, True, True])
    scene: Any = type("RealScene", (), {"simulated": False})
    dialogue = torque_tests._Announced(said.append, lambda: next(looks), scene)
    assert dialogue.confirm("x: Reversals of 1 N. Start now?") is False
    assert said == ["x: check_hold: reversals of 1 N in 3 s"]
    assert torque_tests._Announced(said.append, lambda: False, scene).confirm("x: Start now?") is True
    assert next(times) >= 3 * 10**9


@pytest.mark.parametrize(
    ("changes", "hold"),
    [
        ([], "by construction"),
        (["simulation.drive.acts_at_once=true", "axes.0.demand_reported=after"], "not checked"),
        (["simulation.drive.syncs_late=1"], "not checked"),
        (["axes.0.quirks=[acts_a_sync_late]"], "by construction"),
        (["simulation.drive.torque_read_back=after_update"], "not checked"),
    ],
)
def test_the_hold_of_a_twin_is_known_where_it_acts_as_its_scene_declares(changes: list[str], hold: str) -> None:
    scene = load_scene(DEMO, changes)
    assert [scene.hold_of(axis) for axis in scene.axes] == [hold]


def test_a_twin_that_acts_in_another_hold_than_declared_makes_no_measured_yes() -> None:
    scene = load_scene(DEMO, [
        "simulation.drive.acts_at_once=true", "axes.0.demand_reported=after", "bus.rate=100",
        "environment={type: detents, peak: 1.73 N, pitch: 8.19 mm}", "passivity.moving_mass=0.739",
        "passivity.hand_force=5", "passivity.hand_push=40", "simulation.plant.mass=0.821",
        "simulation.user={stiffness: 787, damping: 3.52}",
        "simulation.user.motion={type: sinusoid, amplitude: 62.3 mm, frequency: 2.97}",
    ])  # fmt: skip
    with build(scene) as experiment:
        run(experiment.cycle, 300)
        port = experiment_account(experiment, "completed", 3.0)["ports"]["handle"]
    assert port["in"] > 1e-3
    assert port["least_certain"] > -1e-9  # the account itself sees nothing: it would be measured
    assert (port["passive"], port["hold"], port["plant_passive"]) == ("in doubt", "not checked", "no")


@pytest.mark.slow
def test_a_simulation_from_python_checks_the_hold_as_a_run_does() -> None:
    port = canhaptic.simulate(load_scene(DEMO, [ASKED]), duration=0.01, progress=False).account["handle"]
    assert port.hold == "checked at this start"
    with pytest.raises(StartError, match="acts before its SYNC"):
        canhaptic.simulate(load_scene(DEMO, [ASKED, "simulation.drive.acts_at_once=true"]), duration=0.01)
