"""The holds of a stop are a part of the account: until no torque acts, and with no more energy than is declared."""

import json
from pathlib import Path
from typing import Any

import pytest

from canhaptic.audit.inspection import inspect
from canhaptic.audit.recompute import recompute_all
from canhaptic.canopen.attached_devices import Brake
from canhaptic.cli.main import main
from canhaptic.commission.session import OpenLoop
from canhaptic.control.ports import axis_ports
from canhaptic.control.verdict import UNBOOKED
from canhaptic.cycle import Cycle, run, running
from canhaptic.errors import DriveFaultError, LinkError, RigError
from canhaptic.logs.energy_reader import EnergyLog
from canhaptic.result import run_result
from canhaptic.scene.build import build
from canhaptic.scene.load import load_scene
from tests.acceptance.bus_frames import DEMO, IN_CONTACT
from tests.drive.drive_bench import Bench, FreeMass, axis, make_bench
from tests.drive.test_brake import TIMES, WEIGHT, brakes, hung

WORDS = [word for word in IN_CONTACT if word != "--set"]
LIGHT = 0.25  # [kg]
DISPLAY = DEMO.parent / "admittance" / "virtual_mass.yaml"


class LightHandle(FreeMass):
    def advance_to(self, now: int, torque: float) -> None:
        super().advance_to(now, torque / LIGHT)


def let_go(stop_cycles: int = 20) -> tuple[Bench, Cycle]:
    """The rig of the demo after two holds at its torque limit, when the hand lets go."""
    b = make_bench([axis(torque_limit=20.0, speed_limit=100.0)], bus={"stop_cycles": stop_cycles})
    b.drives[0].servo._mover = b.drives[0].servo.motor = LightHandle()
    return b, Cycle(b.rig, axis_ports([OpenLoop([0.0, 0.0, 20.0, 20.0] + [20.0] * stop_cycles)]))


def cycle_on(cycle: Cycle) -> None:
    while True:
        cycle.step()


def energy(b: Bench) -> float:
    return 0.5 * LIGHT * b.drives[0].servo.motor.velocity ** 2


def test_a_handle_let_go_gets_a_few_millijoules_of_a_stop_and_the_account_says_how_many() -> None:
    b, cycle = let_go()
    run(cycle, 4)
    assert energy(b) == pytest.approx(3.2e-3)  # from its first torque on; of 562 mJ along a ramp of 50 ms
    assert -cycle.ledgers[0].interaction == pytest.approx(energy(b), rel=0.01)
    assert (cycle.holds_of_stop, b.torques_sent()[-1]) == (3, 0)


@pytest.mark.parametrize("is_confirmed", [True, False], ids=["disabled", "not confirmed"])
def test_what_a_torque_gives_after_a_fault_is_in_no_account_and_no_yes_is_measured(is_confirmed: bool) -> None:
    b, cycle = let_go()

    def fail(cycles: int) -> None:
        if cycles == 4:
            b.tampered.drop(*(() if is_confirmed else (0x185, 0x585)))
            raise ValueError("a program")

    with pytest.raises(RigError, match="the cycle failed" if is_confirmed else "not confirmed"):
        run(cycle, progress=fail)
    [account] = run_result(cycle, status="stopped", config_hash="", method="")["ports"].values()
    assert energy(b) > 5e-4  # none of it is booked
    assert (account["out"], cycle.unbooked) == (0.0, {0: is_confirmed})
    assert (account["passive"], account["why"]) == ("in doubt", "the run ended in holds without a position")


@pytest.mark.slow
def test_a_log_says_that_a_torque_acted_when_the_run_ended(tmp_path: Path) -> None:
    log = tmp_path / "run.h5"
    with build(load_scene(DEMO, WORDS), "free", log) as experiment:
        drive = experiment.far_side.drives[0] if experiment.far_side else None
        assert drive is not None
        with pytest.raises(DriveFaultError):
            run(experiment.cycle, 40, progress=lambda cycles: drive.inject_fault(0x2310) if cycles == 30 else None)
    live = run_result(experiment.cycle, status="stopped", config_hash="", method="")["ports"]["handle"]
    with EnergyLog.open(log) as opened:
        logged = inspect(opened)["ports"]["handle"]
        assert {event.kind for event in opened.events if event.port == "handle"} >= {UNBOOKED}
        assert not inspect(opened, stop=opened.time[-1])["ports"]["handle"]["open_hold"]
    assert live["open_hold"] is logged["open_hold"] is True
    assert live["passive"] == logged["passive"]


def test_lost_tpdos_take_the_torque_away_in_one_hold() -> None:
    b, cycle = let_go(stop_cycles=60)
    with running(cycle):
        for _ in range(4):
            cycle.step()
        before = energy(b)
        b.tampered.drop(0x185)
        with pytest.raises(LinkError, match="TPDO_LOST"):
            cycle_on(cycle)
    assert energy(b) - before < 0.1  # 845 mJ along a ramp


@pytest.mark.slow_but("30-scene0", "300-scene1")
@pytest.mark.parametrize("scene", [DEMO, DISPLAY])
@pytest.mark.parametrize("cycles", [30, 300])
def test_the_account_ends_with_what_the_plant_has_given_when_all_is_still(scene: Path, cycles: int) -> None:
    with build(load_scene(scene, WORDS if scene is DEMO else []), "free") as experiment:
        run(experiment.cycle, cycles)
        judge, ledger = experiment.cycle.judge, experiment.cycle.ledgers[0]
        assert judge is not None
        assert experiment.far_side is not None
        truth = experiment.far_side.drives[0].truth().energy
        resolution = experiment.cycle.meters.ports[0].measured().energy_resolution
        assert experiment.cycle.holds_of_stop > 2
        assert abs(-truth.motor - ledger.interaction) <= resolution + 1e-9 or scene is DISPLAY
        assert judge.believed_error[0] <= resolution + 1e-9


@pytest.mark.slow
def test_a_stop_that_waits_for_a_lagging_torque_and_holds_a_weight_is_recomputed(tmp_path: Path) -> None:
    brake = "axes.0.brake={release_time: 5 ms, set_time: 5 ms, holds_weight: 1 N}"
    lag = "simulation.effects=[{type: current_loop, time_constant: 300 us}]"
    with build(load_scene(DEMO, [brake, lag]), "free", tmp_path / "run.h5") as experiment:
        run(experiment.cycle, 40)
    with EnergyLog.open(tmp_path / "run.h5") as log:
        assert [port["mismatch"] for port in recompute_all(log)] == [None]


def test_a_fault_met_in_a_stop_ends_it_at_once() -> None:
    with build(load_scene(DEMO, WORDS), "free") as experiment:
        cycle, drive = experiment.cycle, experiment.far_side.drives[0] if experiment.far_side else None
        assert drive is not None
        answer, seen = cycle.answer, []

        def fail(samples: Any) -> Any:
            if cycle.holds_of_stop == 6:
                drive.inject_fault(0x2310)
            if cycle.holds_of_stop:
                seen.append(cycle.holds_of_stop)
            return answer(samples)

        cycle.answer = fail
        with pytest.raises(DriveFaultError, match="0x2310"):
            run(cycle, 30)
        assert seen[-1] <= 7
        assert drive.torque == 0.0


@pytest.mark.parametrize("by", [0, 1], ids=["by the drive", "by the host"])
def test_a_booked_stop_holds_the_weight_and_not_the_last_torque(tmp_path: Path, by: int) -> None:
    brake, values = brakes(tmp_path)[by]
    b = hung(make_bench, brake, **values)
    cycle = Cycle(b.rig, axis_ports([OpenLoop([WEIGHT] * 50 + [8.0])]))
    run(cycle, 51)
    sent = b.torques_sent()
    assert sent[-100:].count(500) > 50
    assert (sent.count(800), sent[-1]) == (1, 0)
    ends = b.drives[0].servo.motor.position
    b.links[0].pump(b.clock.now() + 1_000_000_000)
    b.drives[0].servo.sample()
    assert b.drives[0].servo.motor.position == pytest.approx(ends, abs=1e-6)  # the brake holds
    assert cycle.ledgers[0].interaction == pytest.approx(-8.0 * 0.0 - WEIGHT * (ends - 0.01), abs=2e-3)


@pytest.mark.parametrize("by", [0, 1], ids=["by the drive", "by the host"])
def test_where_tpdos_are_lost_a_weight_is_held_unseen_until_the_brake_is_set(tmp_path: Path, by: int) -> None:
    brake, values = brakes(tmp_path)[by]
    b = hung(make_bench, brake, **values)
    b.rig.start()
    b.run(50, WEIGHT)
    before, bound = b.drives[0].servo.motor.position, b.rig.drives[0].read_back_bound
    begin = b.clock.now()
    b.tampered.drop(0x185)
    with pytest.raises(LinkError, match="TPDO_LOST"):
        b.run(100, WEIGHT)
    b.links[0].pump(b.clock.now() + 1_000_000_000)
    b.drives[0].servo.sample()
    assert abs(b.drives[0].servo.motor.position - before) < 1e-3
    held = [time for time, can_id, data, is_rx in b.frames if can_id == 0x205 and not is_rx and data[2:4] != b"\0\0"]
    assert held[-1] - begin <= 1_000_000 * (20 + 50 + 2 + 1)  # the loss, set_time, two SYNCs; within the next
    assert b.rig.drives[0].read_back_bound - bound >= WEIGHT * 50 * 10.0 * 1e-3  # at the largest speed


def test_a_brake_without_a_weight_holds_nothing(tmp_path: Path) -> None:
    b = hung(make_bench, Brake(**{**TIMES, "holds_weight": 0.0}))
    cycle = Cycle(b.rig, axis_ports([OpenLoop([8.0] * 10)]))
    run(cycle, 10)
    assert b.torques_sent()[-60:] == [0] * 60
    assert cycle.holds_of_stop > 50


def test_check_says_the_most_that_a_stop_gives_out(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", str(DEMO), "--json", "--set", "bus.rate=40"]) in (0, 1)
    [hint] = [of for of in json.loads(capsys.readouterr().out)["stability"] if of["what"] == "energy out at a stop"]
    assert hint["limit"] == pytest.approx(0.5 * (20.0 * 2 / 40.0) ** 2 / 0.2)  # [J] of one hold and that under way


@pytest.mark.slow_but("xy_box-2")
@pytest.mark.parametrize(("name", "lost"), [("two_handles", 0), ("xy_box", 2), ("admittance/two_link_arm", 0)])
def test_a_group_stops_and_its_account_ends_with_what_its_plants_gave(name: str, lost: int) -> None:
    with build(load_scene(DEMO.parent / f"{name}.yaml"), "free") as experiment:
        cycle, judge = experiment.cycle, experiment.cycle.judge
        drives: Any = experiment.rig.drives
        for drive in drives:
            whole = drive.sample

            def sample(sync: int, periods: int = 1, *, is_whole: bool = True, whole: Any = whole) -> Any:
                return whole(sync, periods, is_whole=is_whole and (not lost or cycle.holds_of_stop != lost))

            drive.sample = sample
        run(cycle, 120)
        sent = [record.torques_per_mille for record in experiment.rig.records]
        assert any(any(torques) for torques in sent[: -cycle.holds_of_stop])
        assert not any(sent[-1])
        assert name.startswith("admittance") or not any(any(torques) for torques in sent[-cycle.holds_of_stop :])
        assert judge is not None
        assert judge.believed_error[-1] <= cycle.meters.ports[-1].measured().energy_resolution + 1e-9


def test_a_sample_lost_on_a_ramp_holds_its_torque_once_and_no_ramp_goes_on() -> None:
    with build(load_scene(DEMO, WORDS), "free") as experiment:
        cycle: Any = experiment.cycle
        answer = cycle.answer

        def lose(samples: Any) -> Any:
            lost = [sample._replace(fresh=cycle.holds_of_stop != 6) for sample in samples]
            return answer(lost)

        cycle.answer = lose
        run(cycle, 30)
        sent = [torque for record in experiment.rig.records for torque in record.torques_per_mille][30:]
    assert 0 > sent[4] > sent[3]  # it falls
    assert sent[5] == sent[4]
    assert set(sent[6:]) == {0}


@pytest.mark.parametrize("by", [0, 1], ids=["by the drive", "by the host"])
def test_a_weight_is_held_in_time_though_no_sync_can_be_sent_any_more(tmp_path: Path, by: int) -> None:
    brake, values = brakes(tmp_path)[by]
    b = hung(make_bench, brake, **values)
    b.rig.start()
    b.run(50, WEIGHT)
    b.tampered.drop(0x185)
    exchange: Any = b.rig._exchange
    begin = b.clock.now()

    def refused() -> None:
        if not b.rig.is_running:
            raise LinkError("no buffer")
        type(exchange).sync(exchange)

    exchange.sync = refused
    with pytest.raises(LinkError, match="TPDO_LOST"):
        b.run(100, WEIGHT)
    held = [time for time, can_id, data, is_rx in b.frames if can_id == 0x205 and not is_rx and data[2:4] != b"\0\0"]
    assert 1_000_000 * (20 + 50) <= held[-1] - begin <= 1_000_000 * (20 + 50 + 2 + 1)
