"""A recorded bus, decoded from literal bytes: RPDO 0x201 and TPDO 0x181 of the demo's only drive (node 1)."""

import re
import struct
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

DEMO = Path(__file__).resolve().parents[2] / "configs" / "demo.yaml"
IN_CONTACT = ("--set", "environment.side=above")  # the hand begins inside the wall: torque from the first cycle on

_LINE = re.compile(r"\((\d+)\.(\d{6})\) \S+ ([0-9A-F]{3})#([0-9A-F]*) ([TR])")


class Frame(NamedTuple):
    time: int  # [us]
    can_id: int
    data: bytes
    is_sent: bool  # by the master


class Command(NamedTuple):
    controlword: int
    target_torque: int  # 0x6071 [per mille]


class Report(NamedTuple):
    time: int  # [us]
    statusword: int
    torque: int  # 0x6074, held when the SYNC came [per mille]

    @property
    def is_enabled(self) -> bool:
        return self.statusword & 0x6F == 0x27


def read_log(path: Path) -> list[Frame]:
    """Every frame of a candump text; a line that is none fails the test."""
    frames = []
    for line in path.read_text(encoding="ascii").splitlines():
        match = _LINE.fullmatch(line)
        assert match is not None, line
        seconds, microseconds, can_id, data, direction = match.groups()
        time = int(seconds) * 1_000_000 + int(microseconds)
        frames.append(Frame(time, int(can_id, 16), bytes.fromhex(data), direction == "T"))
    return frames


def commands(frames: Sequence[Frame]) -> list[Command]:
    """What the master asked of the drive, in order."""
    return [Command(*struct.unpack("<Hh", f.data)) for f in frames if f.can_id == 0x201 and f.is_sent]


def reports(frames: Sequence[Frame]) -> list[Report]:
    """What the drive said of itself, in order."""
    found = [(f.time, struct.unpack("<Hih", f.data)) for f in frames if f.can_id == 0x181 and len(f.data) == 8]
    return [Report(time, status, torque) for time, (status, _position, torque) in found]


def assert_never_enabled(frames: Sequence[Frame]) -> None:
    """No frame asked for torque or for OPERATION ENABLED, and the drive reported neither."""
    assert all(command.target_torque == 0 and command.controlword & 0x0F != 0x0F for command in commands(frames))
    assert all(report.torque == 0 and not report.is_enabled for report in reports(frames))


def syncs_from_torque_to_zero(frames: Sequence[Frame]) -> int:
    """SYNCs between the last RPDO with a torque and the next RPDO: 1 when zero was sent in the very next cycle."""
    rpdos = [k for k, frame in enumerate(frames) if frame.can_id == 0x201 and frame.is_sent]
    last = max(n for n, k in enumerate(rpdos) if frames[k].data[2:] != b"\0\0")
    return sum(frame.can_id == 0x080 for frame in frames[rpdos[last] : rpdos[last + 1]])
