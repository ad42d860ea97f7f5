"""Own code in a process of its own: the same law a hold later, and a cycle that goes on in any case."""

import io
import json
import mmap
import os
import signal
import threading
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from canhaptic.audit.inspection import inspect
from canhaptic.audit.recompute import recompute_all, scene_of
from canhaptic.cli.main import main
from canhaptic.cycle import run
from canhaptic.drive.safety.link_policy import StopReason
from canhaptic.errors import InputError, OwnCodeError, OwnCodeLateError
from canhaptic.logs.energy_reader import EnergyLog
from canhaptic.logs.ring import allocate
from canhaptic.scene import own_code
from canhaptic.scene.build import build, experiment_account
from canhaptic.scene.load import load_scene
from canhaptic.scene.models import Scene
from canhaptic.scene.own_code import CodeProcess, LaterLaw, apart, require_law
from canhaptic.signals import Sample

ROOT = Path(__file__).resolve().parents[2]
WALL = """
import math, os, resource, sys
from typing import Annotated
from canhaptic.extending import Environment, quantity


CALLS = []


class Wall(Environment):
    stiffness: Annotated[float, quantity("N/m", "N*m/rad", ge=0.0)] = 200.0

    def effort(self, state: float) -> float:
        CALLS.append(state)
        if state < -{deep} and len(CALLS) > 200:  # not where the scene is loaded, which tries the law
            {deed}
        return self.stiffness * state + 1e4 * state**3
"""
HAND = """
from canhaptic.extending import OwnHand


class Still(OwnHand):
    def force(self, time: float, position: float, velocity: float) -> float:
        return 0.0
"""
CALM = "pass"


def scene_in(folder: Path, deed: str = CALM, *more: str, deep: float = 0.01) -> Scene:
    text = (ROOT / "configs" / "demo.yaml").read_text().replace("../eds", str(ROOT / "eds"))
    (folder / "scene.yaml").write_text(text)
    (folder / "wall.py").write_text(WALL.format(deed=deed, deep=deep))
    own = "environment={type: wall.py:Wall, stiffness: 300 N/m, damping: 1, side: below, position: -0.02 m}"
    return load_scene(folder / "scene.yaml", [own, "code_runs_in=process", *more], allow_code=True)


def test_own_code_of_real_drives_runs_apart_and_of_a_simulation_in_the_cycle(tmp_path: Path) -> None:
    real = ("code_runs_in=null", "bus.interface=udp_multicast")
    assert apart(scene_in(tmp_path, CALM, *real)).axes[0].guard == "certificates"
    assert apart(scene_in(tmp_path, CALM, "code_runs_in=null")).axes[0].guard == ""
    assert apart(scene_in(tmp_path, CALM, "code_runs_in=cycle", real[1])).axes[0].guard == ""
    plain = ("passivity={algorithm: unprotected}",)
    assert apart(scene_in(tmp_path, CALM, *plain)).axes[0].guard == "none"
    demo = load_scene(ROOT / "configs" / "demo.yaml", ["code_runs_in=process"])
    assert apart(demo) is demo


def test_a_hand_alone_is_part_of_the_drive_and_refused_by_its_name(tmp_path: Path) -> None:
    (tmp_path / "user.py").write_text(HAND)
    hand = "simulation.user={type: user.py:Still, stiffness: 60 N/m}"
    wall = "environment={type: spring_damper_wall, stiffness: 100, damping: 10, position: -0.05}"
    require_law(scene_in(tmp_path, CALM, hand))
    require_law(scene_in(tmp_path, CALM, hand, wall, "code_runs_in=cycle"))
    with pytest.raises(InputError, match=r"code_runs_in: process: got .*user.py, a hand or an effect.*canhaptic drive"):
        build(scene_in(tmp_path, CALM, hand, wall), "free")


def test_check_says_what_the_hold_costs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = scene_in(tmp_path)
    words = ["check", scene.source, *(word for text in scene.overrides for word in ("--set", text)), "--json"]
    assert main(words) == 0
    found = {hint["what"]: hint for hint in json.loads(capsys.readouterr().out)["stability"]}
    later = found["stiffness, certified by hand force, one hold later"]
    in_cycle = float(later["text"].partition("code_runs_in: cycle: ")[2].rstrip(")"))
    assert 0.0 < later["limit"] < 0.7 * in_cycle


def test_a_record_that_is_being_written_is_not_read() -> None:
    memory = mmap.mmap(-1, 4096)
    writer, reader = own_code._Slot(memory, 0, 2), own_code._Slot(memory, 0, 2)
    assert reader.read() is None
    writer.write(7, 1, (0.5, -0.25))
    assert reader.read() == (7, 1, 0.5, -0.25, 7)
    writer._cell[0] += 1
    assert reader.read() is None
    writer._cell[0] += 1
    memory[8:16] = (8).to_bytes(8, "little")  # torn: its two indices differ
    assert reader.read() is None


def test_what_it_prints_is_bounded() -> None:
    stream = io.StringIO()
    printed = own_code._Printed(stream)
    for _ in range(100):
        assert printed.write("x" * 100_000) == 100_000
    assert len(stream.getvalue()) < 1_000_100
    assert "printed too much" in stream.getvalue()


@pytest.mark.slow
def test_the_law_is_bit_for_bit_the_one_in_the_cycle_a_hold_later(tmp_path, capsys) -> None:
    with build(scene_in(tmp_path), "free", tmp_path / "e.h5", tmp_path / "b.log") as experiment:
        run(experiment.cycle, 1500)
        assert experiment.code is not None
        answered_holds = experiment.cycle.cycles - experiment.cycle.holds_of_stop  # the stop asks for less by itself
        assert answered_holds == 1500
        assert (experiment.code.late, experiment.cycle.ledgers[0].summary().energy_in > 1e-3) == (0, True)
        known = experiment_account(experiment, "completed", 1.0)["own_code"]
        assert known == {"runs_in": "process", "late_holds": 0, "longest": 0}
    with EnergyLog.open(tmp_path / "e.h5") as log:
        assert recompute_all(log, allow_code=True)[0]["mismatch"] is None
        law, port = LaterLaw(scene_of(log, allow_code=True)), log.ports["handle"]
        rows = zip(port["position"], port["torque_applied"], port["fresh"], strict=True)
        torques = [law.step(1, 0, (float(q), float(f), float(fresh)))[0] for q, f, fresh in rows]
        asked = [-effort for effort in port["effort_asked"].tolist()][:answered_holds]
        assert asked[1:] == torques[: answered_holds - 1]
        assert max(map(abs, torques)) > 1.0
        deepest = -0.02 - port["position"].min()
        assert max(contact["depth"] or 0.0 for contact in inspect(log)["contacts"]["handle"]) == deepest
    words = ["inspect", str(tmp_path / "e.h5"), "--recompute", "--bus-log", str(tmp_path / "b.log"), "--allow-code"]
    assert main([*words, "--check", "passive"]) == 0
    logs = [str(tmp_path / "b.log"), "--energy-log", str(tmp_path / "e.h5")]
    assert main(["replay", "--quick", *logs, "--config", str(tmp_path / "scene.yaml"), "--allow-code"]) == 0
    assert "identical" in capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.parametrize(
    ("deed", "error", "message"),
    [
        (
            "raise ValueError('no such law')",
            OwnCodeError,
            r"torque is zero: wall.py:Wall at SYNC \d+: effort raised ValueError: no such law \(wall.py:16\); correct",
        ),
        ("return math.nan", OwnCodeError, "effort returned nan"),
        ("os._exit(5)", OwnCodeLateError, r"its process has ended.*did not answer at SYNC .*OWN_CODE_LATE"),
        ("os.kill(os.getpid(), 9)", OwnCodeLateError, "ended by signal 9"),
        ("while True: pass", OwnCodeLateError, "OWN_CODE_LATE"),
        ("raise ValueError(resource.getrlimit(resource.RLIMIT_DATA)[0])", OwnCodeError, r"ValueError: \d{9,}"),
        ("sys.exit()", OwnCodeError, r"torque is zero: wall.py at SYNC \d+: SystemExit"),
    ],
)
def test_what_it_does_wrong_ends_the_run_with_its_name(deed, error: type[Exception], message, tmp_path, monkeypatch):
    monkeypatch.setattr(own_code, "_FREE_WAIT", 0.5)
    with build(scene_in(tmp_path, deed), "free") as experiment:
        with pytest.raises((error, Exception), match=message) as raised:
            run(experiment.cycle, 1500)
        assert isinstance(raised.value, error) or isinstance(raised.value.__cause__, error)
        assert str(raised.value).count("correct the program") <= 1
        assert experiment.rig.stop_reason.name in ("OWN_CODE_LATE", "EXCEPTION")
        assert not experiment.rig.is_running
        assert experiment.code is not None
        process = experiment.code._process
    assert process.poll() is not None


class Asked:
    def __init__(self) -> None:
        self.torques: list[float] = []

    def ask(self, torque: float) -> None:
        self.torques.append(torque)


@pytest.mark.slow
def test_late_holds_ask_for_nothing_and_are_counted_and_answers_count_again(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(own_code, "allocate", lambda size: seen_by_owner(allocate(size)))
    controller, stopped = Asked(), list[tuple[StopReason, str]]()

    def end(reason: StopReason, what: str) -> RuntimeError:
        stopped.append((reason, what))
        return RuntimeError(what)

    rig = SimpleNamespace(periods=1, end=end)
    cycle: Any = SimpleNamespace(rig=rig, ports=[SimpleNamespace(axes=(0,), controller=controller)])
    plain = ("late_holds=5", "passivity={algorithm: unprotected}")
    code = CodeProcess(apart(scene_in(tmp_path, CALM, *plain)), cycle, "real")
    try:
        turns = iter(range(1000))
        answered(code, turns, controller)
        assert controller.torques[-1] > 1.0
        os.kill(code._process.pid, signal.SIGSTOP)
        pause(0.05)
        late = code.late
        turn(code, turns, 4)
        assert (controller.torques[-3:], code.late >= late + 3, stopped) == ([0.0, 0.0, 0.0], True, [])
        os.kill(code._process.pid, signal.SIGCONT)
        answered(code, turns, controller)
        assert controller.torques[-1] > 1.0
        os.kill(code._process.pid, signal.SIGKILL)
        code._process.wait()
        with pytest.raises(RuntimeError, match=r"wall.py: 5 holds in a row; its process was ended by signal 9"):
            turn(code, turns, 7)
        assert stopped[0][0].name == "OWN_CODE_LATE"
    finally:
        code.close()
        code.close()


def seen_by_owner(descriptor: int) -> int:
    found = os.fstat(descriptor)
    assert (found.st_mode & 0o777, found.st_nlink, found.st_uid) == (0o600, 0, os.getuid())
    return descriptor


def turn(code: CodeProcess, turns: Any, count: int = 1) -> None:
    for _ in range(count):
        code.turn([Sample(next(turns), -0.03, 0.0, 0, fresh=True)])


def pause(seconds: float) -> None:
    threading.Event().wait(seconds)


def answered(code: CodeProcess, turns: Any, controller: Asked) -> None:
    """Asks until an answer was in time."""
    for _ in range(100):
        code._in_a_row = 0
        turn(code, turns)
        before = code._answers.sequence
        end = time.monotonic() + 2.0
        while code._answers.sequence == before and time.monotonic() < end:
            pause(0.001)
        pause(0.01)
        if len(controller.torques) > 5 and controller.torques[-1] > 1.0:
            return


@pytest.mark.slow
def test_code_that_does_not_start_is_refused_before_the_rig_does(tmp_path: Path) -> None:
    scene = scene_in(tmp_path)
    (tmp_path / "wall.py").write_text("raise RuntimeError('not today')\n")
    with pytest.raises(InputError, match=r"^wall\.py: [^:]*: (?!wall\.py: ).*not today"):
        build(scene, "free")


@pytest.mark.slow
def test_code_that_was_replaced_since_the_cycle_read_it_is_refused(tmp_path: Path) -> None:
    scene = scene_in(tmp_path)
    with (tmp_path / "wall.py").open("a") as file:
        file.write("# another\n")
    with pytest.raises(InputError, match=r"^wall\.py: in a process of its own: is not the code of the cycle"):
        build(scene, "free")
