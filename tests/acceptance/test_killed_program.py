"""A program that ends in a way that no code answers: the drive, a process of its own, takes its torque away."""

import os
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest

from tests.acceptance.bus_frames import DEMO, commands
from tests.acceptance.two_processes import HEARTBEAT_TIMEOUT, Listener, canhaptic, shared_bus

__all__ = ["shared_bus"]  # a fixture
ROOT = Path(__file__).resolve().parents[2]
PROGRAM = """
import faulthandler, os, signal, sys
import canhaptic
with canhaptic.open_rig(canhaptic.load_scene(sys.argv[1], sys.argv[2:])) as rig:
    for turn, sample in enumerate(rig):
        handle = sample["handle"]
        rig["handle"].torque = -100.0 * min(0.0, handle.position + 0.05)
        if turn >= {turn} and rig["handle"].granted > 0.5 and abs(handle.torque) > 0.5:  # sent, and acting
            {way}
sys.exit(f"ran to its end: granted {{rig['handle'].granted:g}}, limited by {{rig['handle'].limited_by}}")
"""
WAYS = {
    "SIGKILL": ("os.kill(os.getpid(), signal.SIGKILL)", -9),
    "os._exit": ("os._exit(9)", 9),
    "a crash of the interpreter": ("faulthandler._sigsegv()", -11),
    "a body that never ends": ("signal.pause()", None),
}


class TooBusyError(Exception):
    """This computer was late for too many SYNCs."""


def time_to_zero(way: str, turn: int, listener: Listener, on_bus: list[str]) -> int:
    """Returns the time from the last heartbeat of a program that ended to the drive's own end of its torque [us].

    Args:
        way: How it ends.
        turn: The first turn in which it may.
        listener: A third connection to their bus.
        on_bus: Words that put a scene on it.

    Raises:
        TooBusyError: The rig itself ended the run, with zero torque, as this computer was late for too many SYNCs.
    """
    deed, status = WAYS[way]
    # The hand of the drive has long been in motion: without an allowance the account may be empty for good, and no
    # torque would be granted that could be taken away.
    overrides = [*(word for word in on_bus if word != "--set"), "passivity.energy_allowance=1 J"]
    words = [sys.executable, "-c", PROGRAM.format(way=deed, turn=turn), str(DEMO), *overrides]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    with canhaptic("drive", str(DEMO), *on_bus, "--set", "simulation.user.rest=-0.2 m") as drive:
        listener.wait_for(lambda frame: frame.can_id == 0x701 and frame.data == b"\0")  # boot-up
        with subprocess.Popen(words, env=environment, stderr=subprocess.PIPE, text=True) as program:
            emergency = None
            try:
                with suppress(AssertionError):
                    emergency = listener.wait_for(lambda frame: frame.can_id == 0x081)
                ended = program.poll()
            finally:
                program.kill()
                error = program.communicate()[1]
        if "SYNCS_SKIPPED" in error:
            raise TooBusyError(error)
        assert emergency is not None, error
        assert ended == status, error
        assert emergency.data[:3] == bytes.fromhex("30 81 11")  # heartbeat lost; communication and generic error
        last = commands(listener.frames)[-1]
        assert last.target_torque != 0  # no command took it away
        assert last.controlword == 0xF
        assert listener.upload(0x6041) & 0x6F != 0x27  # no longer in OPERATION ENABLED
        assert listener.upload(0x6074) == 0
        assert drive.poll() is None
    return emergency.time - max(frame.time for frame in listener.frames if frame.can_id == 0x77E)


@pytest.mark.slow
@pytest.mark.parametrize("way", WAYS)
def test_the_watchdog_of_the_drive_ends_the_torque_of_a_program_that_no_code_ends(way, shared_bus):
    for attempt in range(5):
        try:
            assert time_to_zero(way, 20, *shared_bus) >= HEARTBEAT_TIMEOUT - 1_000
        except TooBusyError:
            assert attempt < 4, "this computer was too busy five times"
        else:
            return
