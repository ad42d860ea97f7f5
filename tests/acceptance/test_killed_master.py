"""A master killed in the middle of a contact: the drive, a process of its own, takes its torque away by itself."""

import signal

from tests.acceptance.bus_frames import DEMO, commands, reports
from tests.acceptance.two_processes import Listener, canhaptic, pushed, shared_bus

__all__ = ["shared_bus"]  # a fixture


def test_the_drive_of_a_killed_master_drops_its_torque_by_its_own_watchdog(shared_bus: tuple[Listener, list[str]]):
    listener, on_bus = shared_bus
    hand_in_the_wall = ["--set", "simulation.user.rest=-0.2 m"]
    with canhaptic("drive", str(DEMO), *on_bus, *hand_in_the_wall) as drive:
        listener.wait_for(lambda frame: frame.can_id == 0x701 and frame.data == b"\0")  # boot-up
        with canhaptic("run", str(DEMO), *on_bus, "--pace", "real", "--duration", "60") as master:
            listener.wait_for(pushed)
            master.send_signal(signal.SIGKILL)
            assert master.wait(10) == -signal.SIGKILL
        emergency = listener.wait_for(lambda frame: frame.can_id == 0x081)
        assert emergency.data[:3] == bytes.fromhex("30 81 11")  # heartbeat lost; communication and generic error
        last_word = max(frame.time for frame in listener.frames if frame.can_id == 0x77E)
        # A drive that a busy computer holds up sees its timer before heartbeats that wait: the order is certain
        assert emergency.time > last_word
        last = commands(listener.frames)[-50:]  # a busy computer skips SYNCs, behind which no torque may be certified
        assert any(command.target_torque for command in last)
        assert last[-1].controlword == 0xF  # no command to disable
        assert listener.upload(0x6041) & 0x6F != 0x27  # no longer in OPERATION ENABLED
        assert listener.upload(0x6074) == 0
        assert drive.poll() is None  # the drive itself lives
        assert_a_new_master_is_refused(listener, on_bus)


def assert_a_new_master_is_refused(listener: Listener, on_bus: list[str]) -> None:
    """The fault stays until an operator resets it: who comes next gets an error, and no torque."""
    begin = len(listener.frames)
    with canhaptic("run", str(DEMO), *on_bus, "--pace", "real", "--duration", "1") as master:
        while master.poll() is None:
            listener.hear(0.05)
        error = master.stderr.read() if master.stderr else ""
    while listener.hear(0.0):  # what still waits
        pass
    assert master.returncode == 3, error
    assert "handle: drive state: got FAULT" in error
    new = listener.frames[begin:]
    assert all(command.target_torque == 0 for command in commands(new))
    assert not any(report.is_enabled for report in reports(new))
