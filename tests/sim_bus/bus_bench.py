"""A faulty bus between two connections of a private virtual bus, on a clock that the test moves."""

import itertools
from collections.abc import Iterable
from typing import Any

import can

from canhaptic.drive.clock import VirtualClock
from canhaptic.sim.bus.faulty_bus import BusEffects, FaultyBus
from canhaptic.sim.drive.profile.timers import NEVER

_channels = itertools.count()
US, MS = 1_000, 1_000_000  # [ns]


def frame(can_id: int, data: bytes = b"") -> can.Message:
    return can.Message(arbitration_id=can_id, is_extended_id=False, data=data)


def virtual_bus(channel: str) -> can.BusABC:
    return can.Bus(interface="virtual", channel=channel, preserve_timestamps=True)


class Ear:
    """The far side: notes when each frame arrives, and answers SYNC when it is asked to."""

    def __init__(self, bus: can.BusABC, answer: bytes | None = None) -> None:
        self.bus, self.answer = bus, answer
        self.heard: list[tuple[int, int, bytes]] = []

    def process(self, now: int) -> None:
        while (message := self.bus.recv(0)) is not None:
            self.heard.append((now, message.arbitration_id, bytes(message.data)))
            if self.answer is not None and message.arbitration_id == 0x080:
                self.bus.send(frame(0x181, self.answer))

    def next_due(self) -> int:
        return NEVER


class Bench:
    """A master's connection with faults, its clock, and the ear at the other end."""

    def __init__(self, answer: bytes | None = None, *, bitrate: int = 1_000_000, seed: int = 0, **effects: Any) -> None:
        channel = f"sim-bus-{next(_channels)}"
        self.master = FaultyBus(virtual_bus(channel), BusEffects(**effects), bitrate=bitrate, seed=seed)
        self.ear = Ear(virtual_bus(channel), answer)
        self.clock = VirtualClock([self.master.around(self.ear)])
        self.master.use(self.clock)

    def __enter__(self) -> "Bench":
        return self

    def __exit__(self, *_: object) -> None:
        self.master.shutdown()
        self.ear.bus.shutdown()

    def sync(self) -> None:
        """Sends the first SYNC, with which the faults begin, and lets its own troubles pass."""
        self.master.send(frame(0x080))
        self.until(self.clock.now() + 100 * MS)
        self.ear.heard.clear()

    def until(self, time: int) -> list[tuple[int, int, bytes]]:
        """Receives until `time` [ns]; returns what reached the master, and when."""
        heard = []
        while (message := self.clock.receive(self.master, time)) is not None:
            heard.append((self.clock.now(), message.arbitration_id, bytes(message.data)))
        return heard

    def send_all(self, frames: Iterable[can.Message], period: int = MS) -> list[tuple[int, int, bytes]]:
        """Sends one frame a period, waits for stragglers, and returns what arrived at the far side and when."""
        for message in frames:
            self.master.send(message)
            self.until(self.clock.now() + period)
        self.until(self.clock.now() + 100 * MS)
        return self.ear.heard


def numbered(count: int, can_id: int = 0x201) -> list[can.Message]:
    """Frames that carry their number."""
    return [frame(can_id, n.to_bytes(4, "little")) for n in range(count)]


def numbers(heard: Iterable[tuple[int, int, bytes]]) -> list[int]:
    return [int.from_bytes(data, "little") for _, _, data in heard]
