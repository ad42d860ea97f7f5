"""A program that ends in a way that no code answers: the drive, a process of its own, takes its torque away."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.acceptance.bus_frames import DEMO, commands
from tests.acceptance.two_processes import HEARTBEAT_TIMEOUT, Listener, canhaptic, shared_bus

__all__ = ["shared_bus"]  # a fixture
ROOT = Path(__file__).resolve().parents[2]
PROGRAM = """
import ctypes, os, signal, sys
import canhaptic
scene = canhaptic.load_scene(sys.argv[1], [*sys.argv[2:], "guard=none", "axes.0.energy_loss_limit=none"])
with canhaptic.open_rig(scene, guard="none") as rig:
    for sample in rig:
        rig["handle"].torque = 3.0
        if sample["handle"].sync_index == 60:
            {way}
"""
WAYS = {
    "SIGKILL": "os.kill(os.getpid(), signal.SIGKILL)",
    "os._exit": "os._exit(1)",
    "a crash of the interpreter": "ctypes.string_at(0)",
    "a body that never ends": "signal.pause()",
}


@pytest.mark.slow
@pytest.mark.parametrize("way", WAYS)
def test_the_watchdog_of_the_drive_ends_the_torque_within_its_time(
    way: str, shared_bus: tuple[Listener, list[str]]
) -> None:
    listener, on_bus = shared_bus
    overrides = [word for word in on_bus if word != "--set"]
    with canhaptic("drive", str(DEMO), *on_bus) as drive:
        listener.wait_for(lambda frame: frame.can_id == 0x701 and frame.data == b"\0")
        words = [sys.executable, "-c", PROGRAM.replace("{way}", WAYS[way]), str(DEMO), *overrides]
        with subprocess.Popen(words, env={**os.environ, "PYTHONPATH": str(ROOT)}, stderr=subprocess.DEVNULL) as program:
            emergency = listener.wait_for(lambda frame: frame.can_id == 0x081, 60.0)
            program.kill()
        last_word = max(frame.time for frame in listener.frames if frame.can_id == 0x77E)
        assert HEARTBEAT_TIMEOUT - 1_000 <= emergency.time - last_word <= HEARTBEAT_TIMEOUT + 100_000
        assert commands(listener.frames)[-1].target_torque != 0  # no command took it away
        assert listener.upload(0x6041) & 0x6F != 0x27
        assert listener.upload(0x6074) == 0
        assert drive.poll() is None
