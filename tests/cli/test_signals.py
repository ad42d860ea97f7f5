"""SIGINT and SIGTERM end a run by the operator's stop: torque to zero, drives disabled, exit 130 and 143."""

import re
import signal
import subprocess
import threading
from pathlib import Path

import pytest

from canhaptic.host.stop_signal import StopSignal
from tests.forked import command

DEMO = Path(__file__).resolve().parents[2] / "configs" / "demo.yaml"
IN_CONTACT = "simulation.user.rest=-0.2 m"  # the hand rests inside the wall, so that there is torque to take away


@pytest.mark.slow_for("15-143")
@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_signal_takes_the_torque_away_and_disables_the_drive(number: int, status: int, tmp_path: Path) -> None:
    bus_log = tmp_path / "a.log"
    words = ["run", str(DEMO), "--pace", "real", "--duration", "60", "--bus-log", str(bus_log)]
    words += ["--set", IN_CONTACT, "--set", "bus.rate=200"]
    with command(*words) as process:
        try:
            _wait_for_torque(process, bus_log)
            process.send_signal(number)
            out, err = process.communicate(timeout=20)
        finally:
            process.kill()
    assert process.returncode == status, err
    assert "stopped" in out
    assert "Traceback" not in err
    frames = re.findall(r"vcan0 (201|181)#(\w+)", bus_log.read_text())
    torques = [
        int.from_bytes(bytes.fromhex(data)[2:4], "little", signed=True) for can_id, data in frames if can_id == "201"
    ]
    assert max(torques) > 0
    assert torques[-1] == 0
    statuswords = [int.from_bytes(bytes.fromhex(data)[:2], "little") for can_id, data in frames if can_id == "181"]
    assert statuswords[-1] & 0x6F != 0x27  # no longer in OPERATION ENABLED


def _wait_for_torque(process: "subprocess.Popen[str]", bus_log: Path) -> None:
    """Returns when the log, which is written as the run goes on, shows a torque that is not zero."""
    for _ in range(150):
        if bus_log.exists() and re.search(r"201#0F00(?!0000)\w{4} ", bus_log.read_text()):
            return
        assert process.poll() is None, process.communicate()
        threading.Event().wait(0.1)
    raise AssertionError("no torque in the bus log")


def test_a_second_signal_ends_only_what_moves_no_drive_and_one_that_was_ignored_stays_so() -> None:
    ignored = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with StopSignal() as stop:
            assert not stop.requested()
            assert stop.exit_status == 0
            signal.raise_signal(signal.SIGHUP)
            assert not stop.requested()
            signal.raise_signal(signal.SIGQUIT)
            signal.raise_signal(signal.SIGINT)
            assert stop.requested()
            assert stop.exit_status == 131
        assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGHUP, ignored)
    with StopSignal(insists=True) as stop:
        signal.raise_signal(signal.SIGTERM)
        with pytest.raises(SystemExit) as caught:
            signal.raise_signal(signal.SIGINT)
        assert caught.value.code == 143
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
