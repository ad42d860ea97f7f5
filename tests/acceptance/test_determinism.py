"""The same scene gives the same frames, to the byte, in any process."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from canhaptic.cli.main import main
from tests.acceptance.bus_frames import DEMO, IN_CONTACT

RUN = ["run", str(DEMO), "--pace", "free", "--duration", "0.4", *IN_CONTACT]
NOISY = ["--set", "simulation.effects=[{type: encoder_noise, deviation: 3e-6}]", "--set", "simulation.seed=7"]


def in_another_process(bus_log: Path, *words: str) -> bytes:
    environment = {**os.environ, "PYTHONHASHSEED": "4711"}
    subprocess.run(
        [sys.executable, "-m", "canhaptic", *RUN, *words, "--bus-log", str(bus_log)],
        env=environment, cwd=bus_log.parent, check=True, capture_output=True,
    )  # fmt: skip
    return bus_log.read_bytes()


def in_this_process(bus_log: Path, *words: str) -> bytes:
    assert main([*RUN, *words, "--bus-log", str(bus_log)]) == 0
    return bus_log.read_bytes()


@pytest.mark.slow
@pytest.mark.parametrize("words", [[], NOISY], ids=["demo", "with encoder noise"])
def test_another_process_gives_the_same_bus_log(words: list[str], tmp_path: Path) -> None:
    here = in_this_process(tmp_path / "a.log", *words)
    assert here == in_another_process(tmp_path / "b.log", *words)
    assert here.count(b"080#") >= 400


@pytest.mark.slow
def test_another_seed_gives_another_bus_log(tmp_path: Path) -> None:
    seeded = [in_this_process(tmp_path / f"{n}.log", *NOISY, "--set", f"simulation.seed={n}") for n in (7, 8)]
    assert seeded[0] != seeded[1]
