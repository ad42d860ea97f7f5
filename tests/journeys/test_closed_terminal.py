"""The terminal of a run is closed, as when ssh drops: the rig stops in order, or `nohup` lets the run go on."""

import fcntl
import os
import pty
import re
import signal
import subprocess
import sys
import termios
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from canhaptic.logs.energy_reader import EnergyLog

DEMO = Path(__file__).resolve().parents[2] / "configs" / "demo.yaml"
WORDS = ["--pace", "real", "--set", "simulation.user.rest=-0.2 m", "--set", "bus.rate=200"]
WORDS += ["--set", "axes.0.energy_uncertainty_limit=none"]  # of a busy machine


@contextmanager
def run_in_terminal(
    folder: Path, duration: float, *, nohup: bool = False
) -> Iterator[tuple[subprocess.Popen[bytes], int]]:
    """Starts a run that pushes, in a terminal of its own; yields the process and the other end of the terminal."""
    here, there = pty.openpty()

    def take_terminal() -> None:
        os.setsid()
        fcntl.ioctl(there, termios.TIOCSCTTY, 0)
        signal.signal(signal.SIGHUP, signal.SIG_IGN if nohup else signal.SIG_DFL)

    words = ["run", str(DEMO), *WORDS, "--duration", str(duration), "--log", "run.h5", "--bus-log", "run.log"]
    with subprocess.Popen(
        [sys.executable, "-m", "canhaptic", *words], cwd=folder, stdin=there, stdout=there, stderr=there,
        preexec_fn=take_terminal,
    ) as process:  # fmt: skip
        os.close(there)
        try:
            wait_for_torque(process, folder / "run.log")
            yield process, here
        finally:
            process.kill()


def wait_for_torque(process: "subprocess.Popen[bytes]", bus_log: Path) -> None:
    for _ in range(600):
        if bus_log.exists() and re.search(r"201#0F00(?!0000)\w{4} ", bus_log.read_text()):
            return
        assert process.poll() is None
        threading.Event().wait(0.1)
    raise AssertionError("no torque in the bus log")


def frames(bus_log: Path, can_id: str) -> list[bytes]:
    return [bytes.fromhex(data) for data in re.findall(rf" {can_id}#(\w+)", bus_log.read_text())]


@pytest.mark.slow
def test_the_terminal_of_a_run_is_closed_and_the_rig_stops_in_order_with_a_whole_log(tmp_path: Path) -> None:
    with run_in_terminal(tmp_path, 60.0) as (process, terminal):
        os.close(terminal)
        assert process.wait(60.0) == 128 + signal.SIGHUP
    rpdos, tpdos = frames(tmp_path / "run.log", "201"), frames(tmp_path / "run.log", "181")
    first_word = next(n for n, data in enumerate(rpdos) if n > rpdos.index(pushing(rpdos)) and data[0] != 0x0F)
    assert rpdos[first_word - 1][2:4] == b"\0\0"  # zero torque first, the drive disabled second
    assert tpdos[-1][0] & 0x6F != 0x27
    with EnergyLog.open(tmp_path / "run.h5") as log:
        assert log.status == "stopped"
        assert log.rows > 0
        assert log.rows_lost == log.dropped == 0
        assert log.timing["sync_index"].tolist() == list(range(log.rows))


def pushing(rpdos: list[bytes]) -> bytes:
    return next(data for data in rpdos if data[:2] == b"\x0f\0" and data[2:4] != b"\0\0")


@pytest.mark.slow
def test_under_nohup_the_run_goes_on_without_its_terminal_and_ends_as_it_should(tmp_path: Path) -> None:
    with run_in_terminal(tmp_path, 5.0, nohup=True) as (process, terminal):
        os.close(terminal)
        assert process.wait(60.0) == 0
    with EnergyLog.open(tmp_path / "run.h5") as log:
        assert log.status == "completed"
        assert log.rows >= 1000
