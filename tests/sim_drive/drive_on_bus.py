"""A simulated drive on a virtual bus, fed and read as literal bytes; no master of the package takes part."""

from functools import lru_cache
from pathlib import Path
from typing import Any

import can

from canhaptic.canopen.eds import read_dictionary
from canhaptic.signals import PlantEnergy
from canhaptic.sim.drive import SimulatedDriveParameters
from canhaptic.sim.drive.can.drive_node import DrivesOnBus, SimulatedDrive

NODE = 5
PERIOD = 1_000_000  # [ns]
ROOT = Path(__file__).resolve().parents[2]
SERVO_EDS = ROOT / "eds" / "cia402_servo.eds"
TRAITS = Path(__file__).parent / "eds"

Frame = tuple[int, str]

dictionary_of = lru_cache(read_dictionary)  # the drive only reads it


class Mass:
    """A free mass of 1 kg, exact for constant force."""

    def __init__(self) -> None:
        self.position, self.velocity, self.work = 0.0, 0.0, 0.0
        self.epoch: int | None = None
        self._now = 0

    def begin(self, now: int) -> None:
        assert self.epoch is None
        self.epoch = self._now = now

    def advance_to(self, now: int, torque: float) -> None:
        if self.epoch is None:
            return
        assert now >= self._now
        step, self._now = (now - self._now) * 1e-9, now
        moved = self.velocity * step + 0.5 * torque * step * step
        self.position += moved
        self.velocity += torque * step
        self.work += torque * moved

    def energy(self) -> PlantEnergy:
        return PlantEnergy(self.work, 0.0, 0.0, 0.5 * self.velocity**2)


class Rig:
    """The drive, its motor, and the far end of its bus."""

    def __init__(
        self, eds: Path = SERVO_EDS, node_id: int = NODE, motor: Mass | None = None, **parameters: Any
    ) -> None:
        channel: Any = object()
        self.bus = can.Bus(interface="virtual", channel=channel, preserve_timestamps=True)
        self._drive_bus = can.Bus(interface="virtual", channel=channel, preserve_timestamps=True)
        self.motor = motor or Mass()
        values = {"counts_per_unit": 1e6, "rated_torque": 1.0, **parameters}
        self.drive = SimulatedDrive(
            self._drive_bus,
            node_id,
            dictionary_of(eds, node_id),
            self.motor,
            SimulatedDriveParameters(**values),
            PERIOD,
        )
        self.group = DrivesOnBus(self._drive_bus, (self.drive,))
        self.now = 0

    def close(self) -> None:
        self.bus.shutdown()
        self._drive_bus.shutdown()

    def __enter__(self) -> "Rig":
        assert self.run() == [(0x700 + self.drive.node_id, "00")]
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def run(self, to: int | None = None) -> list[Frame]:
        """Lets the drive live until `to` [ns] (default: now), event by event; returns what it sent."""
        frames: list[Frame] = []
        to = self.now if to is None else to
        while True:
            self.group.process(self.now)
            while (message := self.bus.recv(0)) is not None:
                frames.append((message.arbitration_id, bytes(message.data).hex(" ")))
            if self.now >= to:
                return frames
            self.now = max(self.now, min(to, self.group.next_due()))

    def send(self, cob_id: int, content: str = "") -> list[Frame]:
        """Sends bytes in hexadecimal; returns what the drive sent in answer."""
        data = bytes.fromhex(content)
        self.bus.send(can.Message(arbitration_id=cob_id, data=data, is_extended_id=False, timestamp=self.now * 1e-9))
        return self.run()

    def sdo(self, content: str) -> str:
        """Sends an SDO request; returns the bytes of the one answer."""
        ((cob_id, answer),) = [f for f in self.send(0x600 + self.drive.node_id, content) if f[0] > 0x580]
        assert cob_id == 0x580 + self.drive.node_id
        return answer

    def write(self, index: int, subindex: int, value: int, size: int) -> str:
        """Writes by an expedited download; returns "ok" or the abort code in hexadecimal."""
        command = {1: "2f", 2: "2b", 3: "27", 4: "23"}[size]
        data = (value & (1 << 8 * size) - 1).to_bytes(size, "little").ljust(4, b"\0").hex()
        return self._result(self.sdo(f"{command}{index & 0xFF:02x}{index >> 8:02x}{subindex:02x}{data}"))

    def read(self, index: int, subindex: int = 0) -> str:
        """Reads by an expedited upload; returns the four data bytes or the abort code in hexadecimal."""
        answer = self.sdo(f"40{index & 0xFF:02x}{index >> 8:02x}{subindex:02x}00000000")
        return self._result(answer) if answer.startswith("80") else answer[12:]

    @staticmethod
    def _result(answer: str) -> str:
        content = bytes.fromhex(answer)
        return f"{int.from_bytes(content[4:], 'little'):08x}" if content[0] == 0x80 else "ok"

    def sync(self) -> list[Frame]:
        """Goes on by a period and sends a SYNC; returns what the drive sent meanwhile and in answer."""
        frames = self.run(self.now + PERIOD)
        return frames + self.send(0x080)

    def start(self) -> None:
        """Selects cyclic torque and NMT OPERATIONAL."""
        assert self.write(0x6060, 0, 10, 1) == "ok"
        self.send(0x000, f"01{self.drive.node_id:02x}")

    def enable(self) -> None:
        """Starts, and goes to OPERATION ENABLED with the default event-driven RPDO1 (controlword, target torque)."""
        self.start()
        for controlword in ("0600", "0700", "0f00"):
            self.send(0x200 + self.drive.node_id, controlword + "0000")
            self.sync()
