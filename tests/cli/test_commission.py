"""`canhaptic commission` as it is typed: unattended, at a terminal, and where it must refuse."""

import json
import os
import pty
import subprocess
import sys
from pathlib import Path

import pytest

from canhaptic.cli.main import main
from tests.forked import command

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
DEMO = str(CONFIGS / "demo.yaml")


@pytest.mark.slow
def test_a_right_configuration_ends_with_status_zero_and_values_to_paste(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    out = tmp_path / "values.yaml"
    status = main(["commission", DEMO, "--yes", "--duration", "0.1", "--json", "--out", str(out)])
    report = json.loads(capsys.readouterr().out)
    assert status == 0
    assert report["status"] == "ok"
    assert report["snippet"] == out.read_text()
    assert "moving_mass: 0.2247" in report["snippet"]


@pytest.mark.slow
def test_what_differs_ends_with_status_one(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["commission", DEMO, "--yes", "--duration", "0.1", "--set", "simulation.drive.counts_per_unit=5e5"]
    assert main(words) == 1
    assert "every position" in capsys.readouterr().out


def test_yes_is_refused_at_a_real_drive(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["commission", str(CONFIGS / "socketcan_example.yaml"), "--yes"]) == 2
    assert "--yes is for drives that are simulated" in capsys.readouterr().err


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
    "press Enter": "",
    "how far was it": "0.1",
    "Pulses of at most": "yes",
    "A sweep of": "y",
    "A shake of": "y",
    "moving mass from a scale": "0.25 kg",
    "A rattle of": "y",
    "falls silent. Now": "y",
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
                    if said.endswith(("] ", "Enter\n")):
                        os.write(person, f"{waiting.pop(question)}\n".encode())
            report = json.loads(process.stdout.read())
            status = process.wait(30)
    finally:
        os.close(person)
        os.close(terminal)
    return status, {finding["item"]: finding["verdict"] for finding in report["findings"]}, said


def test_a_person_at_a_terminal_answers_every_question() -> None:
    status, verdicts, said = commissioned_at_a_terminal(ANSWERS)
    assert (verdicts["torque sign"], verdicts["watchdog"]) == ("agrees",) * 2
    assert verdicts["torque scale"] == "agrees" or verdicts["encoder counts"] == "differs"  # measured by the counts
    assert "expected a number" not in said
    assert status in (0, 1)  # the simulated hand moves as it likes: what was said of its distance may differ


def test_what_was_typed_ahead_agrees_to_nothing() -> None:
    answers = dict.fromkeys(ANSWERS, "")
    _status, verdicts, _said = commissioned_at_a_terminal(answers, typed_ahead="y\n" * 9)
    assert "torque sign" not in verdicts
