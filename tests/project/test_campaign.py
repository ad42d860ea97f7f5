"""The campaign of damaged files: a short one is clean, and it finds what it looks for."""

import os
import random
import signal
import time
from pathlib import Path

import pytest

from tools import campaign
from tools.campaign import CASES, Session, run_case


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("recorded")
    campaign.record(folder)
    return folder


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("cases", [6, pytest.param(100, marks=pytest.mark.campaign)])
@pytest.mark.parametrize("kind", CASES)
def test_a_campaign_finds_nothing(kind: str, cases: int, recorded: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert campaign.campaign(kind, range(cases), 1, recorded, time.monotonic() + 800.0) == 0
    assert f"{kind}: {cases} cases, 0 faulty" in capsys.readouterr().out


@pytest.mark.slow
def test_tracebacks_wrong_passes_and_deaths_are_found(tmp_path: Path) -> None:
    def broken(chance: random.Random, folder: Path, run: Session) -> str:
        raise IndexError(chance.random())

    def passes(chance: random.Random, folder: Path, run: Session) -> str:
        return f"passes: {run('configs')}"

    def dies(chance: random.Random, folder: Path, run: Session) -> str:
        os.kill(os.getpid(), signal.SIGKILL)
        return ""

    assert "IndexError" in run_case(broken, "1", tmp_path).faults()[0]
    found = run_case(passes, "1", tmp_path)
    assert found.faults() == ["passes: 0"]
    assert found.statuses == [("configs", 0)]
    assert run_case(dies, "1", tmp_path).faults() == ["killed by signal 9"]
