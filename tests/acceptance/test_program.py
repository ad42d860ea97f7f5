"""A program that iterates over a rig: what it asks for, what is sent, what stays in the logs, and how it ends."""

import itertools
import json
import math
import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import canhaptic
from canhaptic.cli.main import main
from canhaptic.drive.exchange import Exchange
from canhaptic.drive.rig import Rig
from canhaptic.errors import CycleFailedError, InputError, RigError
from canhaptic.logs.energy_reader import EnergyLog
from canhaptic.program import OpenRig
from tests.acceptance.bus_frames import (
    DEMO,
    assert_never_enabled,
    commands,
    read_log,
    reports,
    syncs_from_torque_to_zero,
)

ROOT = Path(__file__).resolve().parents[2]
FAR = {"bus.interface": "udp_multicast", "bus.channel": "239.74.163.2"}
"""Drives that are not in this process: real ones, as far as the guard is asked."""


def wall(rig: OpenRig, sample: Any, stiffness: float = 300.0) -> None:
    handle = sample["handle"]
    inside = handle.position > 0.0
    rig["handle"].torque = -stiffness * handle.position - 3.0 * handle.velocity if inside else 0.0


def touched(law: Callable[..., None] = wall, **options: Any) -> OpenRig:
    with canhaptic.open_rig(DEMO, None, **{"duration": 0.6, **options}) as rig:
        for sample in rig:
            law(rig, sample)
    return rig


@pytest.mark.slow
def test_logs_of_a_program_recompute_rederive_and_check(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rig = touched(energy_log=tmp_path / "e.h5", bus_log=tmp_path / "b.log")
    assert rig.account["handle"].passive == "yes"
    assert rig.account["handle"].energy_in > 1e-3
    words = ["inspect", str(tmp_path / "e.h5"), "--recompute", "--bus-log", str(tmp_path / "b.log"), "--json"]
    assert main([*words, "--check", "passive"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["cycles"], found["recomputed"][0]["mismatch"], found["rederived"]["differences"]) == (603, None, [])
    with EnergyLog.open(tmp_path / "e.h5") as log:
        assert abs(log.ports["handle"]["effort_asked"]).max() > 1.0
        assert log.attributes["handle.environment"] == "program"
    assert {contact["depth"] for contact in found["contacts"]["handle"]} == {None}  # a program tells of no wall
    ran, inspected = rig.account.raw["ports"]["handle"], found["ports"]["handle"]
    for account in (ran, inspected, found["rederived"]["ports"]["handle"]):
        assert (account["dissipated"], account["damping_rendered"]) == (None, {"least": None, "most": None})
    assert math.isnan(rig.account["handle"].dissipated)
    assert main([*words[:2], "--full"]) == 0
    shown = capsys.readouterr().out
    assert re.search(r"^ *dissipated +not known", shown, re.MULTILINE)
    assert re.search(r"^ *damping rendered +not known", shown, re.MULTILINE)
    assert re.search(r"s +not known ", shown)
    assert "moving mass, hand never pulls" in shown  # the demo declares hand_force 0


@pytest.mark.slow
def test_a_replay_sends_what_the_same_program_sent_and_finds_another_one(tmp_path: Path) -> None:
    touched(bus_log=tmp_path / "b.log")
    same = touched(replay=tmp_path / "b.log")
    assert same.replayed is not None
    assert same.replayed["status"] == "identical"
    assert same.account["handle"].energy_in > 1e-3
    other = touched(lambda rig, sample: wall(rig, sample, 310.0), replay=tmp_path / "b.log")
    assert other.replayed is not None
    assert other.replayed["status"] == "different"
    with pytest.raises(InputError, match="open_rig"):
        canhaptic.run(canhaptic.build(canhaptic.load_scene(DEMO, ["guard=certificates"])).cycle, 1)


def test_frames_alone_do_not_say_what_a_program_asked_for(tmp_path: Path) -> None:
    from canhaptic.audit.recompute import rederive

    touched(bus_log=tmp_path / "b.log", duration=0.01)
    with pytest.raises(InputError, match="energy log"):
        rederive(tmp_path / "b.log", canhaptic.load_scene(DEMO, ["guard=certificates"]))


def test_a_torque_that_is_not_set_in_a_turn_is_zero() -> None:
    sent = []
    with canhaptic.open_rig(DEMO, guard="none", duration=0.05) as rig:
        for sample in rig:
            assert rig["handle"].torque == 0.0
            if sample["handle"].sync_index % 3 == 1:
                rig["handle"].torque = 2.0
            sent.append(rig["handle"].granted)
    assert sent[2:8] == [2.0, 0.0, 0.0, 2.0, 0.0, 0.0]


@pytest.mark.slow_but("unprotected")
@pytest.mark.parametrize("algorithm", ["guarded", "internal_dissipation", "unprotected"])
def test_the_guard_is_there_whatever_algorithm_the_scene_names(algorithm: str) -> None:
    is_guarded = algorithm == "guarded"
    known = {"hand_force": 0.0, "hand_push": 20.0} if is_guarded else {"device_damping": 0.1}
    changes = {"passivity": {"algorithm": algorithm, "moving_mass": 0.2, "device_damping_bound": 0.2, **known}}
    found = {}
    for guard in (None, "none"):
        with canhaptic.open_rig(DEMO, changes, guard=guard, duration=0.5) as rig:
            for sample in rig:
                rig["handle"].torque = math.copysign(3.0, sample["handle"].velocity)  # along every motion
                assert guard or abs(rig["handle"].granted) < 3.0
        found[guard] = rig.account.raw["ports"]["handle"]
    assert found[None]["passive" if is_guarded else "passive_at_handle"] == "yes"  # what the damping took is given back
    assert found["none"]["passive"] == "no"
    assert found["none"]["least_interaction"] < 10.0 * found[None]["least_interaction"] - 0.01


def test_a_guard_of_which_nothing_is_declared_is_refused() -> None:
    nothing = {"passivity": {"algorithm": "unprotected"}}
    with pytest.raises(InputError, match="neither moving_mass with hand_force"), canhaptic.open_rig(DEMO, nothing):
        pass
    no_push = {"passivity": {"algorithm": "guarded", "moving_mass": 0.2, "device_damping_bound": 0.2}}
    with pytest.raises(InputError, match="hand_push: not declared"), canhaptic.open_rig(DEMO, no_push):
        pass


def test_what_was_cut_and_why_is_said_in_the_next_turn() -> None:
    with canhaptic.open_rig(DEMO, duration=0.3) as rig:
        seen = set()
        for sample in rig:
            seen.add(rig["handle"].limited_by)
            against = -100.0 if sample["handle"].velocity > 0.2 else -15.0
            rig["handle"].torque = against if sample["handle"].sync_index % 100 < 90 else 1.0
    assert seen == {"", "start", "account", "hand_force", "torque_limit"}


@pytest.mark.parametrize("scene", [None, "none"])
def test_a_real_rig_goes_without_a_guard_only_where_scene_and_call_say_so(scene: str | None) -> None:
    said = FAR | ({"guard": scene} if scene else {})
    call = None if scene else "none"
    off = "the scene switches" if scene else r'open_rig\(guard="none"\) switches'
    with pytest.raises(InputError, match=off):
        canhaptic.open_rig(DEMO, said, guard=call)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="the scene switches the guard off"):
        canhaptic.open_rig(DEMO, FAR | {"passivity": {"algorithm": "unprotected"}})
    both = canhaptic.open_rig(DEMO, FAR | {"guard": "none"}, guard="none")
    assert both.scene.axes[0].guard == "none"


def test_what_does_not_fit_a_program_is_refused_before_anything_is_opened(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="watchdog"):
        canhaptic.open_rig(DEMO, {"axes.0.watchdog": False})
    with pytest.raises(InputError, match="is no torque axis by itself"):
        canhaptic.open_rig(ROOT / "configs" / "xy_box.yaml")
    with pytest.raises(InputError, match="guard: got 'no'"):
        canhaptic.open_rig(DEMO, guard="no")  # type: ignore[arg-type]
    (tmp_path / "e.h5").touch()
    with pytest.raises(InputError, match="force=True"):
        canhaptic.open_rig(DEMO, energy_log=tmp_path / "e.h5")
    rig = canhaptic.open_rig(DEMO, duration=0.01)
    with pytest.raises(InputError, match="inside the block"):
        iter(rig)
    with pytest.raises(InputError, match="has ended"):
        _ = rig.account
    with rig:
        assert sum(1 for _ in rig) == 10
        with pytest.raises(InputError, match="iterated once"):
            iter(rig)
        with pytest.raises(InputError, match="did you mean 'handle'"):
            _ = rig["hande"]
    with pytest.raises(InputError, match="inside the block"):
        iter(rig)


def test_a_dry_run_sends_no_torque_and_proves_nothing(tmp_path: Path) -> None:
    rig = touched(no_torque=True, bus_log=tmp_path / "b.log")
    assert rig.account.verdict == "dry run"
    assert {command.target_torque for command in commands(read_log(tmp_path / "b.log"))} == {0}


def raising(error: BaseException) -> Callable[[OpenRig], None]:
    def end(_: OpenRig) -> None:
        raise error

    return end


def asking(value: Any) -> Callable[[OpenRig], None]:
    return lambda rig: setattr(rig["handle"], "torque", value)


ENDINGS: dict[str, tuple[Callable[[OpenRig], Any], type[BaseException] | None, str]] = {
    "an exception": (raising(KeyError("no such world")), KeyError, "no such world"),
    "sys.exit": (lambda rig: sys.exit(4), SystemExit, "4"),
    "Ctrl-C": (lambda rig: signal.raise_signal(signal.SIGINT), KeyboardInterrupt, "^$"),
    "SIGTERM": (lambda rig: signal.raise_signal(signal.SIGTERM), SystemExit, "143"),
    "NaN": (asking(math.nan), InputError, "got nan, expected a finite number"),
    "infinity": (asking(-math.inf), InputError, "got -inf, expected a finite number"),
    "a text": (asking("3 N"), InputError, "got '3 N', expected a number"),
    "None": (asking(None), InputError, "got None, expected a number"),
    "a truth value": (asking(True), InputError, "got True, expected a number"),
    "break": (lambda rig: "break", None, ""),
}


@pytest.mark.slow_but("NaN", "an exception", "Ctrl-C", "break")
@pytest.mark.parametrize("what", ENDINGS)
def test_every_way_out_sends_zero_torque_first_and_disables_second(what: str, tmp_path: Path) -> None:
    end, expected, message = ENDINGS[what]
    before = signal.getsignal(signal.SIGTERM)

    def law(rig: OpenRig) -> None:
        for sample in rig:
            wall(rig, sample)
            if sample["handle"].sync_index == 500 and end(rig) == "break":
                break

    with canhaptic.open_rig(DEMO, bus_log=tmp_path / "b.log") as rig:
        if expected is None:
            law(rig)
        else:
            with pytest.raises(expected, match=message):
                law(rig)
        assert_taken_away(tmp_path / "b.log", rig)  # before the block ends
    assert signal.getsignal(signal.SIGTERM) is before


@pytest.mark.slow
def test_a_program_that_catches_the_interrupt_in_its_loop_ends_at_the_next_turn(tmp_path: Path) -> None:
    turns: list[int] = []

    def law(rig: OpenRig) -> None:
        for sample in rig:
            wall(rig, sample)
            turns.append(sample["handle"].sync_index)
            if len(turns) == 500:
                with pytest.raises(KeyboardInterrupt):
                    signal.raise_signal(signal.SIGINT)

    with canhaptic.open_rig(DEMO, bus_log=tmp_path / "b.log") as rig, pytest.raises(KeyboardInterrupt):
        law(rig)
    assert len(turns) == 500
    frames = read_log(tmp_path / "b.log")
    torques = [command.target_torque for command in commands(frames)]
    assert any(torques)
    assert (torques[-1], reports(frames)[-1].is_enabled) == (0, False)


def test_a_handler_of_the_program_is_called_between_two_pieces_of_the_rigs_work_and_decides(monkeypatch) -> None:
    called: list[str] = []
    sync = Rig.sync

    def interrupted(rig: Rig) -> Any:
        if rig.sync_index == 3:
            signal.raise_signal(signal.SIGTERM)
            assert not called
        return sync(rig)

    monkeypatch.setattr(Rig, "sync", interrupted)
    before = signal.signal(signal.SIGTERM, lambda number, frame: called.append(f"signal {number}"))
    try:
        with canhaptic.open_rig(DEMO) as rig:
            for sample in rig:
                if sample["handle"].sync_index == 5:
                    assert called == [f"signal {signal.SIGTERM}"]
                    break
    finally:
        signal.signal(signal.SIGTERM, before)


@pytest.mark.parametrize("signals", [1, 3])
def test_signals_in_the_start_end_it_before_anything_is_enabled(tmp_path, monkeypatch, signals: int) -> None:
    begin = Exchange.begin

    def interrupted(exchange: Exchange) -> None:
        for _ in range(signals):
            signal.raise_signal(signal.SIGQUIT)
        begin(exchange)

    with canhaptic.open_rig(DEMO, bus_log=tmp_path / "b.log") as rig:
        monkeypatch.setattr(Exchange, "begin", interrupted)
        with pytest.raises(SystemExit, match="131"):
            next(iter(rig))
    assert_never_enabled(read_log(tmp_path / "b.log"))


def assert_taken_away(bus_log: Path, rig: OpenRig) -> None:
    with pytest.raises(InputError, match="outside a turn"):
        rig["handle"].torque = 1.0
    assert rig._source is not None
    rig._source.close()
    frames = read_log(bus_log)
    torques = [command.target_torque for command in commands(frames)]
    last = max(k for k, torque in enumerate(torques) if torque)
    assert abs(torques[last]) > 50
    assert set(torques[last + 1 :]) == {0}
    told = reports(frames)
    first_off = next(k for k, report in enumerate(told) if k and told[k - 1].is_enabled and not report.is_enabled)
    assert {report.torque for report in told[first_off - 1 :]} == {0}
    assert syncs_from_torque_to_zero(frames) == 1


def test_a_generator_that_is_closed_and_one_that_is_kept_end_the_run(tmp_path: Path) -> None:
    with canhaptic.open_rig(DEMO) as rig:
        turns: Any = iter(rig)
        for sample in itertools.islice(turns, 400):
            wall(rig, sample)
        turns.close()
        assert rig._source is not None
        assert not rig._source.cycle.rig.is_running
    with canhaptic.open_rig(DEMO, bus_log=tmp_path / "b.log") as rig:
        kept = iter(rig)
        next(kept)
    assert not reports(read_log(tmp_path / "b.log"))[-1].is_enabled
    with pytest.raises((RigError, StopIteration)):
        next(kept)


def test_errors_of_rig_and_program_are_in_the_log_and_the_account_stays(tmp_path: Path) -> None:
    rigs = []

    def law(rig: OpenRig, sample: Any) -> None:
        rigs.append(rig)
        rig["handle"].torque = 1.0 / (20 - sample["handle"].sync_index)

    with pytest.raises(ZeroDivisionError):
        touched(law, energy_log=tmp_path / "e.h5")
    with EnergyLog.open(tmp_path / "e.h5") as log:
        assert re.match(r"failed: ZeroDivisionError: float division by zero \(test_program\.py:\d+\)$", log.status)
        [event] = log.events[-1:]
        assert (event.kind, event.text) == ("fault", log.status.removeprefix("failed: "))
    assert rigs[0].account.raw["cycles"] == 20


ENDS_INSIDE = """
import sys, canhaptic
rig = canhaptic.open_rig(sys.argv[1], bus_log=sys.argv[2])
turns = iter(rig.__enter__())
for sample in turns:
    handle = sample["handle"]
    rig["handle"].torque = -300.0 * max(0.0, handle.position)
    if handle.sync_index == 500:
        next(turns)  # the turn stays open while the interpreter ends
        break
"""


@pytest.mark.slow
def test_the_end_of_the_interpreter_takes_the_torque_away(tmp_path: Path) -> None:
    words = [sys.executable, "-c", ENDS_INSIDE, str(DEMO), str(tmp_path / "b.log")]
    paths = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(words, env=paths, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    frames = read_log(tmp_path / "b.log")
    assert max(abs(c.target_torque) for c in commands(frames)) > 50
    assert commands(frames)[-1].target_torque == 0
    assert not reports(frames)[-1].is_enabled


def test_an_exception_of_the_rig_itself_is_that_of_a_run() -> None:
    def law(rig: OpenRig, _: Any) -> None:
        assert rig._source is not None
        rig._source.cycle.ports[0].controller.step = None

    with pytest.raises(CycleFailedError, match="torque is zero"):
        touched(law)
