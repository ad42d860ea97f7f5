"""What the operating system granted to a run is in its account, and `check` asks before anything is sent."""

import json
from pathlib import Path

import pytest

from canhaptic.cli.main import main

DEMO = str(Path(__file__).resolve().parents[2] / "configs" / "demo.yaml")
PATIENT = ["--set", "bus.heartbeat_timeout=5"]  # a machine under load stalls a process for longer than the usual 0.1 s
ASKED = [*PATIENT, "--set", "bus.realtime={freeze_garbage: true, cpus: [1000]}"]  # no such processor

Captured = pytest.CaptureFixture[str]


def test_the_account_of_a_run_says_what_was_granted_and_what_was_refused(capsys: Captured) -> None:
    assert main(["run", DEMO, "--pace", "real", "--duration", "0.05", "--json", *ASKED]) == 0
    timing = json.loads(capsys.readouterr().out)["timing"]
    assert timing["realtime_freeze_garbage"] == "granted"
    assert timing["realtime_cpus"].startswith("refused: ")


@pytest.mark.slow
def test_a_brief_run_says_what_was_refused_and_nothing_that_was_granted(capsys: Captured) -> None:
    assert main(["run", DEMO, "--pace", "real", "--duration", "0.05", *ASKED]) == 0
    out = " ".join(capsys.readouterr().out.split())
    assert "timing realtime cpus refused: [Errno 22]" in out
    assert "granted" not in out


def test_nothing_is_said_where_nothing_was_asked(capsys: Captured) -> None:
    assert main(["run", DEMO, "--pace", "real", "--duration", "0.05", "--json", *PATIENT]) == 0
    assert not [name for name in json.loads(capsys.readouterr().out)["timing"] if name.startswith("realtime")]


@pytest.mark.slow
def test_check_asks_and_gives_back(capsys: Captured) -> None:
    assert main(["check", DEMO, "--json", *ASKED]) == 0
    answers = json.loads(capsys.readouterr().out)["realtime"]
    assert answers["freeze_garbage"] == "granted"
    assert answers["cpus"].startswith("refused: ")
    assert main(["check", DEMO, *ASKED]) == 0
    assert "bus.realtime" in capsys.readouterr().out
