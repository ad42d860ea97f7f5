"""`canhaptic commission` as it is typed: unattended, at a terminal, and where it must refuse."""

import json
import os
import pty
import signal
import subprocess
import sys
from copy import deepcopy
from pathlib import Path
from typing import Any

import pytest

from canhaptic.cli import commission as commission_command
from canhaptic.cli.main import main
from canhaptic.commission.session import Session
from canhaptic.scene.load import load_scene
from canhaptic.scene.models import Scene
from tests.commission.whole_session import whole_session
from tests.forked import command

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
DEMO = str(CONFIGS / "demo.yaml")


def assert_declared_within(scene: Scene) -> None:
    """What is declared of every axis is on the safe side of its simulated plant."""
    for axis in scene.axes:
        simulation, loop = axis.simulation, axis.loop
        assert simulation is not None
        assert loop.moving_mass is not None
        assert 0.7 * simulation.plant.mass < loop.moving_mass <= simulation.plant.mass
        assert (loop.device_damping or 0.0) <= simulation.plant.damping <= (loop.device_damping_bound or 0.0)
        of_effects = {effect.name: effect.parameters for effect in simulation.effects}
        friction = getattr(of_effects.get("coulomb_friction"), "static", 0.0)
        assert (loop.device_friction or 0.0) <= friction <= (loop.device_friction_bound or 0.0)
        assert (loop.current_lag or 0.0) >= getattr(of_effects.get("current_loop"), "time_constant", 0.0)


def commissioned(scene: Path | str, out: Path, *words: str) -> Path:
    """The scene that `commission` writes."""
    assert main(["commission", str(scene), "--yes", "--duration", "0.1", "--out", str(out), *words]) == 0
    assert_declared_within(load_scene(out))
    return out


@pytest.fixture
def walked_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """The steps with the demonstration's rig are taken once; every session has their report."""

    def once(session: Session, _duration: float) -> Any:
        report, outcome, _ = whole_session()
        session.report = deepcopy(report)
        return outcome

    monkeypatch.setattr(commission_command, "walk", once)


def felt(scene: Path, capsys: pytest.CaptureFixture[str]) -> float:
    """Share of the stiffness that a run of 3 s renders, which is passive."""
    capsys.readouterr()
    assert main(["run", str(scene), "--duration", "3", "--pace", "free", "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    [port] = result["ports"].values()
    assert result["verdict"].startswith("yes")  # at the handle, where damping was measured
    return float(port["rendered"]["stiffness"])


@pytest.mark.slow
@pytest.mark.usefixtures("walked_once")
def test_the_whole_scene_is_written_and_says_what_was_measured(capsys, tmp_path) -> None:
    scene = tmp_path / "rig.yaml"
    scene.write_text(Path(DEMO).read_text().replace("0.2 kg     # an", "0.2 kg     # TO SET: an"))
    out = commissioned(scene, tmp_path / "mine.yaml", "--json")
    report = json.loads(capsys.readouterr().out)
    assert (report["status"], report["written"], report["unfinished"]) == ("ok", str(out), [])
    assert "moving_mass: 0.2" in out.read_text()
    assert {value["key"] for value in report["values"]} >= {"passivity.moving_mass", "passivity.current_lag"}
    kept = [line for line in scene.read_text().splitlines() if not set(line.split(":")) & {"  moving_mass"}]
    assert (
        len(set(kept) - set(out.read_text().splitlines())) <= 5
    )  # node_id, unit, counts_per_unit, rated_torque, bound


@pytest.mark.parametrize(
    ("words", "taken", "says"),
    [
        (["--out", "mine.yaml"], "mine.yaml", "mine.yaml already exists; choose another name"),
        (["--in-place"], "rig.yaml.bak", "rig.yaml.bak already exists"),
        (["--out", "mine.yaml", "--in-place"], "", "not allowed with argument"),
        (["--out", "mine.yaml", "--set", "axes=[]"], "", "axes"),
    ],
)
def test_nothing_that_exists_is_overwritten_and_nothing_is_tried_before(
    words: list[str], taken: str, says: str, capsys: pytest.CaptureFixture[str], tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    Path("rig.yaml").write_text(Path(DEMO).read_text())
    if taken:
        Path(taken).write_text("mine")
    assert status_of(["commission", "rig.yaml", "--yes", *words]) == 2
    said = capsys.readouterr()
    assert says in said.err
    assert "1 of 6" not in said.err
    assert not taken or Path(taken).read_text() == "mine"
    assert Path("rig.yaml").read_text() == Path(DEMO).read_text()


def status_of(words: list[str]) -> int:
    """Exit status, also of what the parser of the arguments refuses."""
    try:
        return main(words)
    except SystemExit as end:
        return int(str(end.code))


@pytest.mark.slow
@pytest.mark.usefixtures("walked_once")
def test_in_place_the_scene_before_is_kept(tmp_path: Path) -> None:
    scene = tmp_path / "rig.yaml"
    scene.write_text(Path(DEMO).read_text())
    assert main(["commission", str(scene), "--yes", "--duration", "0.1", "--in-place"]) == 0
    assert (tmp_path / "rig.yaml.bak").read_text() == Path(DEMO).read_text()
    assert_declared_within(load_scene(scene))
    assert "  current_lag:" in scene.read_text()


@pytest.mark.slow_for("words1-*")
@pytest.mark.parametrize(
    ("words", "missing", "todo"),
    [
        (["--speed", "1e-6"], "handle: torque sign: not verified", "handle: torque sign: stopped; moved faster than"),
        (["--set", "axes.0.watchdog=false"], "handle: watchdog: OPERATION ENABLED", "handle: watchdog: OPERATION"),
    ],
)
def test_an_unfinished_commissioning_writes_what_was_found_and_no_run_takes_it(words, missing, todo, capsys, tmp_path):
    out = tmp_path / "mine.yaml"
    assert main(["commission", DEMO, "--yes", "--duration", "0.1", "--out", str(out), *words]) == 1
    said = capsys.readouterr().err
    assert f"\n    {missing}" in said
    last = said.splitlines()[-1]
    assert last.startswith(f"  To do: {todo}")
    assert last.endswith("is marked unfinished and is not run; then commission again")
    assert (load_scene(out).run.unfinished or "").startswith(todo)
    assert main(["run", str(out), "--pace", "free"]) == 2
    assert f"its commissioning is not finished: {todo}" in capsys.readouterr().err


@pytest.mark.slow
def test_a_scene_that_is_commissioned_again_loses_its_mark(tmp_path: Path) -> None:
    scene = tmp_path / "rig.yaml"
    scene.write_text(Path(DEMO).read_text() + '\nunfinished: "handle: moving mass: unclear"\n')
    assert load_scene(commissioned(scene, tmp_path / "mine.yaml")).run.unfinished is None


@pytest.mark.slow
def test_a_stopped_commissioning_writes_what_was_found(tmp_path: Path) -> None:
    out = tmp_path / "mine.yaml"
    with command("commission", DEMO, "--yes", "--duration", "600", "--out", str(out)) as process:
        assert process.stderr is not None
        for line in process.stderr:
            if line.startswith("6 of 6"):
                process.send_signal(signal.SIGINT)
        assert process.wait(30) == 130
    assert load_scene(out).run.unfinished == "stopped"


@pytest.mark.slow
@pytest.mark.parametrize(
    "effects",
    [
        "[{type: current_loop, time_constant: 300 us}]",
        "[{type: coulomb_friction, kinetic: 0.2 N, static: 0.3 N}, {type: current_loop, time_constant: 500 us}]",
        "[{type: current_loop, time_constant: 900 us}]",
    ],
)
def test_a_late_torque_and_dry_friction_are_bounded_and_the_wall_is_kept(effects: str, capsys, tmp_path) -> None:
    """Nothing of it is declared in the scene: what is derived from the plant is replaced by what was measured."""
    out = commissioned(DEMO, tmp_path / "mine.yaml", "--set", f"simulation.effects={effects}")
    assert felt(out, capsys) >= 0.9


@pytest.mark.slow
def test_the_axes_of_a_group_get_values_of_their_own(tmp_path: Path) -> None:
    words = [
        "--set",
        "simulation.bus.drop=1e-12",
        "--set",
        "simulation.axes.second.plant={mass: 0.5 kg, damping: 0.2 N*s/m}",
    ]
    text = commissioned(CONFIGS / "two_handles.yaml", tmp_path / "mine.yaml", *words).read_text()
    assert text.count("    passivity:") == 3
    assert "    - &handle" in text or "  - &handle" in text


@pytest.mark.slow
def test_what_differs_ends_with_status_one(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["commission", DEMO, "--yes", "--duration", "0.1", "--set", "simulation.drive.counts_per_unit=5e5"]
    assert main(words) == 1
    assert "every position" in capsys.readouterr().out


def test_yes_is_refused_at_a_real_drive(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["commission", str(CONFIGS / "socketcan_example.yaml"), "--yes"]) == 2
    assert "--yes is for drives simulated" in capsys.readouterr().err


@pytest.mark.slow
def test_without_a_terminal_it_asks_for_one() -> None:
    words = [sys.executable, "-m", "canhaptic", "commission", DEMO]
    done = subprocess.run(words, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "needs a terminal" in done.stderr


@pytest.mark.parametrize("words", [["--torque", "0.9"], ["--travel", "0"], ["--speed", "nan"]])
def test_limits_beyond_reason_are_refused(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["commission", DEMO, "--yes", *words]) == 2
    assert words[0][2:] in capsys.readouterr().err


ANSWERS = {
    "Enable the drives": "y",
    "the simulated hand to move": "0.02",
    "the hand moves. Start now": "y",
    "Pulses from": "yes",
    "how is the scale": "mass",
    "moving mass, weighed": "0.25 kg",
    "Doublets of": "y",
    "A sweep of": "y",
    "A shake of": "y",
    "Reversals of": "y",
    "A dither of": "y",
    "stops sending. Start now": "y",
    "reset the faults": "y",
}


def commissioned_at_a_terminal(answers: dict[str, str], typed_ahead: str = "") -> tuple[int, dict[str, str], str]:
    """Exit status, verdict by item, and what was said, of a person who answers each question when it is asked."""
    person, terminal = pty.openpty()
    said = ""
    try:
        os.write(person, typed_ahead.encode())
        with command("commission", DEMO, "--duration", "0.1", "--json", stdin=terminal) as process:
            assert process.stderr is not None
            assert process.stdout is not None
            waiting = dict(answers)
            while piece := os.read(process.stderr.fileno(), 4096):
                said += piece.decode()
                for question in [asked for asked in waiting if asked in said]:
                    if said.endswith("] "):
                        os.write(person, f"{waiting.pop(question)}\n".encode())
            report = json.loads(process.stdout.read())
            status = process.wait(30)
    finally:
        os.close(person)
        os.close(terminal)
    return status, {finding["item"]: finding["verdict"] for finding in report["findings"]}, said


@pytest.mark.slow
def test_a_person_at_a_terminal_answers_every_question() -> None:
    status, verdicts, said = commissioned_at_a_terminal(ANSWERS)
    assert (verdicts["torque sign"], verdicts["watchdog"]) == ("agrees",) * 2
    assert (verdicts["torque scale"], verdicts["encoder counts"]) == ("agrees",) * 2
    assert "expected a number" not in said
    assert status == 0


def test_what_was_typed_ahead_agrees_to_nothing() -> None:
    answers = dict.fromkeys(ANSWERS, "")
    _status, verdicts, _said = commissioned_at_a_terminal(answers, typed_ahead="y\n" * 9)
    assert "torque sign" not in verdicts
