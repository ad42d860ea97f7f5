"""The LSS side of a node, written by hand from CiA 305: it shares no code with the master."""

from dataclasses import dataclass, field

import can

NO_NODE_ID = 255


@dataclass
class LssSlave:
    """One node. A node with a node ID takes LSS in NMT stopped alone."""

    bus: can.BusABC
    identity: tuple[int, int, int, int]
    node_id: int = NO_NODE_ID  # active
    refuses: dict[int, int] = field(default_factory=dict)  # service: error code
    is_stopped: bool = False
    is_configuring: bool = False
    pending: int = NO_NODE_ID
    stored: int = NO_NODE_ID
    matched: int = 0  # parts of the identity in a row
    answers: list[tuple[int, int, bytes]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.pending = self.stored = self.node_id

    def next_due(self) -> int:
        return min([time for time, _, _ in self.answers], default=1 << 62)

    def process(self, now: int) -> None:
        while (message := self.bus.recv(0.0)) is not None:
            data = bytes(message.data)
            if message.arbitration_id == 0x000 and data[1] in (0, self.node_id):
                self.take_nmt(data[0], now)
            elif message.arbitration_id == 0x7E5 and (self.is_stopped or self.node_id == NO_NODE_ID):
                assert len(data) == 8
                answer = self.take(data[0], data[1:])
                if answer:
                    self.answers.append((now + 1_000_000, 0x7E4, answer.ljust(8, b"\0")))
        for due in [one for one in self.answers if one[0] <= now]:
            self.answers.remove(due)
            self.bus.send(can.Message(arbitration_id=due[1], data=due[2], is_extended_id=False))

    def take_nmt(self, command: int, now: int) -> None:
        self.is_stopped = command == 0x02
        if command == 0x82:
            self.node_id = self.pending
            if self.node_id != NO_NODE_ID:
                self.answers.append((now + 2_000_000, 0x700 + self.node_id, b"\0"))

    def take(self, service: int, data: bytes) -> bytes:
        number = int.from_bytes(data[:4], "little")
        if service == 0x04:
            self.is_configuring = data[0] == 1
        elif 0x40 <= service <= 0x43:
            return self.select(service - 0x40, number)
        elif service == 0x4C and self.node_id == NO_NODE_ID:
            return b"\x50"
        elif self.is_configuring:
            return self.configure(service, data[0])
        return b""

    def select(self, part: int, number: int) -> bytes:
        self.matched = self.matched + 1 if part == self.matched and self.identity[part] == number else 0
        if self.matched < 4:
            return b""
        self.matched, self.is_configuring = 0, True
        return b"\x44"

    def configure(self, service: int, value: int) -> bytes:
        if 0x5A <= service <= 0x5D:
            return bytes([service]) + self.identity[service - 0x5A].to_bytes(4, "little")
        if service == 0x5E:
            return bytes([service, self.node_id])
        code = self.refuses.get(service, 0)
        if service == 0x11 and not code:
            self.pending = value
        elif service == 0x17 and not code:
            self.stored = self.pending
        return bytes([service, code, 0])
