"""Master and drive as two processes over UDP multicast on this machine, on a group and port that no other test uses.

A third connection, in the test, records every frame and asks the drive.
"""

import os
import socket
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

import can
import pytest

from tests.acceptance.bus_frames import Frame, Report, reports
from tests.forked import command

HEARTBEAT_TIMEOUT = 300_000  # [us] long enough for a busy machine
PATIENCE = 20.0  # [s] for two commands to start on a busy machine


def private_bus() -> dict[str, Any]:
    """Group and port of this test alone; frames do not leave the machine."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("", 0))
        port = probe.getsockname()[1]
    number = os.getpid()
    return {"channel": f"239.75.{number // 250 % 250}.{1 + number % 250}", "port": port, "hop_limit": 0}


class Listener:
    """The third connection: records what it hears, and asks by SDO."""

    def __init__(self, bus: can.BusABC) -> None:
        self.bus = bus
        self.frames: list[Frame] = []

    def hear(self, seconds: float) -> Frame | None:
        message = self.bus.recv(seconds)
        if message is None:
            return None
        from_master = message.arbitration_id in (0x000, 0x080, 0x201, 0x601, 0x77E)
        frame = Frame(round(message.timestamp * 1e6), message.arbitration_id, bytes(message.data), from_master)
        self.frames.append(frame)
        return frame

    def wait_for(self, condition: Callable[[Frame], bool], seconds: float = PATIENCE) -> Frame:
        """The first frame from now on that meets the condition."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            frame = self.hear(0.05)
            if frame is not None and condition(frame):
                return frame
        raise AssertionError(f"not heard within {seconds} s; last frames: {self.frames[-5:]}")

    def upload(self, index: int) -> int:
        """Reads an object of the drive by SDO: literal request, expedited answer."""
        place = bytes([index & 0xFF, index >> 8, 0])
        self.bus.send(can.Message(arbitration_id=0x601, is_extended_id=False, data=b"\x40" + place + bytes(4)))
        answer = self.wait_for(lambda f: f.can_id == 0x581 and f.data[1:4] == place and f.data[0] & 0xE0 == 0x40)
        return int.from_bytes(answer.data[4:6], "little", signed=index == 0x6074)


@contextmanager
def canhaptic(*words: str) -> Iterator["subprocess.Popen[str]"]:
    """The command in a process of its own, gone at the end of the block in any case."""
    with command(*words) as process:
        try:
            yield process
        finally:
            process.kill()
            process.communicate()


@contextmanager
def listening() -> Iterator[tuple[Listener, list[str]]]:
    """A listener on a private bus, and the words that put a scene on it."""
    options = private_bus()
    with can.Bus(interface="udp_multicast", **options) as bus:
        bus.send(can.Message(arbitration_id=0x7FF, is_extended_id=False))
        if bus.recv(2.0) is None:
            raise OSError("a frame to the own group did not come back")
        channel = options.pop("channel")
        rest = f"bus.options={{port: {options['port']}, hop_limit: {options['hop_limit']}}}"
        scene = [f"bus.channel={channel}", rest, "bus.interface=udp_multicast", "bus.rate=200 Hz"]
        scene += [f"bus.heartbeat_timeout={HEARTBEAT_TIMEOUT} us", "bus.stop_cycles=60"]
        scene.append("axes.0.energy_uncertainty_limit=none")  # of a busy machine, which is late at both ends
        yield Listener(bus), [word for override in scene for word in ("--set", override)]


@pytest.fixture
def shared_bus() -> Iterator[tuple[Listener, list[str]]]:
    """As `listening`; skips where there is no multicast."""
    pytest.importorskip("msgpack", reason="python-can's udp_multicast needs msgpack (pip install canhaptic[multicast])")
    with ExitStack() as stack:
        try:
            heard = stack.enter_context(listening())
        except (can.CanError, OSError) as error:
            pytest.skip(f"no UDP multicast here: {error}")
        yield heard


def pushed(frame: Frame) -> bool:
    """Whether the drive reports a torque worth the name, in OPERATION ENABLED."""
    [report] = reports([frame]) or [Report(0, 0, 0)]
    return report.is_enabled and abs(report.torque) > 50
