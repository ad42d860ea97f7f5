"""A drive killed in the middle of a contact, and started again: the master stops, and a new run begins as any other."""

import signal

import pytest

from tests.acceptance.bus_frames import DEMO, commands, reports
from tests.acceptance.two_processes import Listener, canhaptic, pushed, shared_bus

__all__ = ["shared_bus"]  # a fixture

HAND_IN_THE_WALL = ("--set", "simulation.user.rest=-0.2 m")
STOP_CYCLES = 60  # of the scene on the shared bus: missed SYNCs after which the torque is zero
TOO_BUSY = ("[TPDO_LOST]", "[HEARTBEAT_LOST]", "[SYNCS_SKIPPED]", "[EMERGENCY]")  # how a busy computer ends a run


@pytest.mark.slow
def test_a_killed_drive_stops_the_master_and_one_that_is_started_again_serves_the_next_run(shared_bus):
    listener, on_bus = shared_bus
    run = ["run", str(DEMO), *on_bus, "--pace", "real"]
    with canhaptic("drive", str(DEMO), *on_bus, *HAND_IN_THE_WALL) as drive:
        listener.wait_for(lambda frame: frame.can_id == 0x701 and frame.data == b"\0")  # boot-up
        with canhaptic(*run, "--duration", "60") as master:
            listener.wait_for(pushed)
            drive.send_signal(signal.SIGKILL)
            while master.poll() is None:
                listener.hear(0.05)
            error = master.stderr.read() if master.stderr else ""
    assert master.returncode == 3, error
    assert "torque is zero" in error
    assert "[TPDO_LOST]" in error or "[HEARTBEAT_LOST]" in error
    while listener.hear(0.1):  # what still waits
        pass
    assert_zero_within_the_policy(listener)
    with canhaptic("drive", str(DEMO), *on_bus, *HAND_IN_THE_WALL):
        listener.wait_for(lambda frame: frame.can_id == 0x701 and frame.data == b"\0")
        begin = len(listener.frames)
        with canhaptic(*run, "--duration", "1") as master:
            listener.wait_for(pushed)
            while master.poll() is None:
                listener.hear(0.05)
            error = master.stderr.read() if master.stderr else ""
        assert master.returncode == 0 or any(reason in error for reason in TOO_BUSY), error
        while listener.hear(0.0):  # the drive beats on
            pass
    assert commands(listener.frames[begin:])[-1].target_torque == 0
    assert any(report.is_enabled for report in reports(listener.frames[begin:]))


def assert_zero_within_the_policy(listener: Listener) -> None:
    """Counts SYNCs from the drive's last answer to the first zero torque, which stays."""
    last = max(n for n, frame in enumerate(listener.frames) if frame.can_id == 0x181)
    syncs, torques = 0, []
    for frame in listener.frames[last + 1 :]:
        syncs += frame.can_id == 0x080
        torques += [(syncs, command.target_torque) for command in commands([frame])]
    first_zero = next(n for n, (_at, torque) in enumerate(torques) if torque == 0)
    assert torques[first_zero][0] <= STOP_CYCLES + 1
    assert all(torque == 0 for _at, torque in torques[first_zero:])
