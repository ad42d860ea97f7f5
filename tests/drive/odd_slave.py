"""A CANopen drive written by hand from CiA 301 and CiA 402, frame by frame, with one odd habit at a time.

It shares no code with the simulated drive, so that a misreading of the standard in one does not hide in the other. It
runs in lock-step with the master by the virtual clock.
"""

import struct
from collections.abc import Callable
from dataclasses import dataclass, field

import can

NODE = 5
MILLISECOND = 1_000_000
_NEVER = 1 << 62
_ABSENT = bytes.fromhex("00 00 02 06")  # abort code: object does not exist
READ_ONLY = bytes.fromhex("02 00 01 06")

_OBJECTS = {  # object: its bytes, low byte first
    "1000.0": "92 01 02 00",
    "1006.0": "00 00 00 00",
    "1016.1": "00 00 00 00",
    "1017.0": "00 00",
    "1018.1": "0d f0 00 00",
    "1018.2": "01 00 00 00",
    "603f.0": "00 00",
    "6007.0": "00 00",
    "6040.0": "00 00",
    "6060.0": "00",
    "6061.0": "00",
    "6071.0": "00 00",
    "6072.0": "e8 03",
    "6076.0": "10 27 00 00",  # 10 N
    "60c2.1": "01",
    "60c2.2": "fd",
    "6502.0": "ff 03 00 00",
    "607a.0": "00 00 00 00",
    "60ff.0": "00 00 00 00",
    **{f"{index}.0": "ff ff ff 7f" for index in ("6083", "6084", "6085", "60c5", "60c6")},
    "605a.0": "02 00",
    "60b0.0": "00 00 00 00",
    "60b1.0": "00 00 00 00",
}
_PDOS = {f"14{n:02x}.1": f"0{n + 2:x} 00 00 80" for n in range(4)} | {f"18{n:02x}.1": "80 00 00 80" for n in range(4)}
_PDOS |= {f"{base}{n:02x}.{sub}": "00" for base in ("14", "18") for n in range(4) for sub in (2, 5)}
_PDOS |= {f"{base}{n:02x}.{sub}": "00 00 00 00" for base in ("16", "1a") for n in range(4) for sub in range(1, 9)}
_PDOS |= {f"{base}{n:02x}.0": "00" for base in ("16", "1a") for n in range(4)}
_PDOS |= {f"18{n:02x}.3": "00 00" for n in range(4)}
_PDOS |= {f"{base}{n:02x}.5": "00 00" for base in ("14", "18") for n in range(4)}

STATES = {"disabled": 0x40, "ready": 0x21, "on": 0x23, "enabled": 0x27, "quick stop": 0x07, "fault": 0x08}
_WALK = {("disabled", 0x06): "ready", ("ready", 0x07): "on", ("on", 0x0F): "enabled", ("ready", 0x0F): "enabled"}


def key(text: str) -> tuple[int, int]:
    index, sub = text.split(".")
    return int(index, 16), int(sub)


@dataclass
class OddSlave:
    """One node. Habits are set from outside, on these attributes."""

    bus: can.BusABC
    node: int = NODE
    # --- habits ---
    boots_at: int = -1  # [ns] before which it hears nothing; it then sends its boot-up
    answers: int = 1  # to each SDO request
    answer_after: int = 300_000  # [ns]
    answer_length: int = 8  # with less, only the bytes needed, but for the statusword
    reset_gap: int = 0  # [ns] for which the controlword must be 0 before the edge of a fault reset
    reset_edges: int = 1  # that a fault reset needs
    emcy_of_rpdo: int = 0  # at each RPDO
    shows_mode_when_enabled: bool = False
    lost_requests: int = 0  # each n-th is lost
    is_deaf_to_sdo: bool = False
    aborts: dict[tuple[int, int], bytes] = field(default_factory=dict)  # abort code of writes
    no_read: dict[tuple[int, int], bytes] = field(default_factory=dict)  # abort code of reads
    frozen: set[tuple[int, int]] = field(default_factory=set)  # objects that confirm a write and keep their value
    hears: Callable[[can.Message], bool] = lambda message: True
    tpdo_after: int = 200_000  # [ns] after SYNC
    tpdo_every: int = 1
    tpdo_length: int = 8
    tpdo_copies: int = 1
    has_heartbeat: bool = True
    needs_period: bool = False  # faults where 0x1006 is 0
    period_fault: int = 0x8700
    needs_counter: bool = False  # a SYNC without a counter is none
    sto: bool = False
    segments: bool = False  # answers no SDO expedited
    is_stuck: bool = False  # keeps its torque
    beat_bits: int = 0  # in every heartbeat
    refuses_mode: bool = False
    statusword: int = 0x1210  # its bits beyond the state: voltage, remote, follows
    clears_emcy: bool = False
    script: dict[int, Callable[["OddSlave"], None]] = field(default_factory=dict)  # by SYNC since it was enabled
    speed: int = 0  # counts per SYNC at which a hand moves it
    is_pushed_until: str = ""  # state at which the hand lets go
    is_position_drive: bool = False
    unconfigured: bool = False  # LSS: no node ID
    # --- state ---
    state: str = "disabled"
    nmt: int = 0x7F
    position: int = 1000
    held: int = 0  # per mille: acts while enabled
    segment: bytes = b""
    image: bytes = b""  # target in the last RPDO
    target: int = 0
    force: int = 0
    now: int = 0
    enabled_syncs: int = 0
    last_word: int = 0
    word_at: int = 0
    sent_at: int = -_NEVER  # the last TPDO

    def __post_init__(self) -> None:
        self.objects = {key(name): bytes.fromhex(text) for name, text in (_PDOS | _OBJECTS).items()}
        if self.is_position_drive:
            self.objects[0x60B2, 0] = bytes(2)
        self.timers: list[tuple[int, int, bytes]] = []  # (time, COB-ID, data) to be sent
        self.beat_at = _NEVER
        self.requests = self.syncs = 0
        self.was_enabled = False
        self.sensor: OddSensor | None = None

    # --- the clock ---

    def next_due(self) -> int:
        due = [time for time, _, _ in self.timers]
        if self.boots_at > 0:
            due.append(self.boots_at)
        return min([*due, self.beat_at, self.sensor.due if self.sensor else _NEVER])

    def process(self, now: int) -> None:
        self.now = now
        while (message := self.bus.recv(0.0)) is not None:
            if self.boots_at <= now and not self.unconfigured and self.hears(message):
                self.take(message)
            elif self.unconfigured:
                self.take_lss(message)
            if self.sensor:
                self.sensor.take(self, message)
        if 0 < self.boots_at <= now:
            self.boots_at = -1
            self.send(0x700 + self.node, b"\0")
        for timer in sorted(timer for timer in self.timers if timer[0] <= now):
            self.timers.remove(timer)
            self.send(timer[1], timer[2])
        if now >= self.beat_at:
            self.beat_at += self.period()
            if self.has_heartbeat:
                self.send(0x700 + self.node, bytes([self.nmt | self.beat_bits]))
        if self.sensor:
            self.sensor.act(self, now)

    def period(self) -> int:
        return int.from_bytes(self.objects[0x1017, 0], "little") * MILLISECOND or _NEVER

    def send(self, can_id: int, data: bytes) -> None:
        frame = can.Message(arbitration_id=can_id, data=data, is_extended_id=False, timestamp=self.now * 1e-9)
        self.bus.send(frame)

    def later(self, delay: int, can_id: int, data: bytes) -> None:
        self.timers.append((self.now + delay, can_id, data))

    # --- what it takes ---

    def take(self, message: can.Message) -> None:
        if message.is_remote_frame or message.is_extended_id:
            return
        can_id, data = message.arbitration_id, bytes(message.data)
        if can_id == 0x000 and data[1] in (0, self.node):
            self.nmt = {0x01: 0x05, 0x02: 0x04, 0x80: 0x7F}.get(data[0], self.nmt)
        elif can_id == 0x080 and self.nmt == 0x05 and (data or not self.needs_counter):
            self.take_sync()
        elif can_id == 0x600 + self.node and self.nmt != 0x04 and not self.is_deaf_to_sdo:
            self.requests += 1
            if not (self.lost_requests and self.requests % self.lost_requests == 0):
                answer = self.sdo(data)
                if self.answer_length < 8 and answer and answer[0] & 0xE3 == 0x43 and answer[1:3] != b"\x41\x60":
                    answer = answer[: 8 - (answer[0] >> 2 & 3)]
                for _ in range(self.answers if answer else 0):
                    self.later(self.answer_after, 0x580 + self.node, answer)
        elif can_id == 0x200 + self.node and self.nmt == 0x05:
            self.image = data[2:]
            if self.emcy_of_rpdo:
                self.emcy(self.emcy_of_rpdo)
            self.control(int.from_bytes(data[:2], "little"))

    def take_lss(self, message: can.Message) -> None:
        if message.arbitration_id == 0x7E5 and message.data[0] == 0x4C:  # identify non-configured nodes
            self.later(300_000, 0x7E4, bytes.fromhex("50 00 00 00 00 00 00 00"))

    def sdo(self, request: bytes) -> bytes:
        if request[0] & 0xE0 == 0x60:  # the next segment: the only one
            return bytes([7 - len(self.segment) << 1 | 1]) + self.segment.ljust(7, b"\0")
        index, sub = int.from_bytes(request[1:3], "little"), request[3]
        place, head = (index, sub), request[1:4]
        if place == (0x6041, 0):
            value: bytes | None = self.word().to_bytes(2, "little")
        elif place == (0x6064, 0):
            value = (self.position % (1 << 32)).to_bytes(4, "little")
        elif place == (0x6061, 0) and self.shows_mode_when_enabled and self.state != "enabled":
            value = b"\0"
        else:
            value = self.objects.get(place)
        if value is None:
            return b"\x80" + head + _ABSENT
        return self.read(place, value) if request[0] == 0x40 else self.download(place, request)

    def read(self, place: tuple[int, int], value: bytes) -> bytes:
        head = place[0].to_bytes(2, "little") + bytes([place[1]])
        if place in self.no_read:
            return b"\x80" + head + self.no_read[place]
        if self.segments:
            self.segment = value
            return b"\x41" + head + len(value).to_bytes(4, "little")
        return bytes([0x43 | 4 - len(value) << 2]) + head + value.ljust(4, b"\0")

    def download(self, place: tuple[int, int], request: bytes) -> bytes:
        head = request[1:4]
        if request[0] & 0xE0 != 0x20:
            return b""
        if place in self.aborts:
            return b"\x80" + head + self.aborts[place]
        if place not in self.frozen:
            self.write(place, request[4 : 8 - (request[0] >> 2 & 3)])
        return b"\x60" + head + bytes(4)

    def write(self, place: tuple[int, int], data: bytes) -> None:
        self.objects[place] = data
        if place == (0x1017, 0):
            self.beat_at = self.now + self.period()
        elif place == (0x6060, 0) and not self.refuses_mode:
            self.objects[0x6061, 0] = data
        elif place == (0x6040, 0):
            self.control(int.from_bytes(data, "little"))

    def control(self, word: int) -> None:
        if self.state == "fault":
            is_edge = word & 0x80 and not self.last_word & 0x80 and self.now - self.word_at >= self.reset_gap
            self.reset_edges -= bool(is_edge)
            if is_edge and self.reset_edges <= 0:
                self.state = "disabled"
            self.last_word, self.word_at = word, self.now
            return
        if not word & 0x02 or (word & 0x0F == 0x02 and self.state == "enabled"):
            self.state = "disabled"
        elif not (self.sto and word == 0x07):
            self.state = _WALK.get((self.state, word & 0x0F), self.state)
        if self.state == "enabled" and not self.was_enabled:
            self.was_enabled = True
            if self.needs_period and not any(self.objects[0x1006, 0]):
                self.fault(self.period_fault)

    def fault(self, code: int) -> None:
        self.state = "fault"
        self.objects[0x603F, 0] = code.to_bytes(2, "little")
        self.emcy(code)

    def emcy(self, code: int) -> None:
        self.send(0x080 + self.node, code.to_bytes(2, "little") + b"\x01" + bytes(5))

    def answers_stale(self) -> None:
        """An SDO answer without a request."""
        self.send(0x580 + self.node, bytes.fromhex("43 00 10 00 92 01 02 00"))

    def word(self) -> int:
        return STATES[self.state] | self.statusword

    def take_sync(self) -> None:
        self.syncs += 1
        if self.image:  # a synchronous RPDO acts now
            self.target = int.from_bytes(self.image, "little", signed=True)
            self.objects[0x607A if self.is_position_drive else 0x6071, 0] = self.image
        demand = self.force if self.is_position_drive else self.torque
        if self.state == self.is_pushed_until:
            self.speed = 0
        self.position += self.speed
        if self.state == "enabled":
            self.enabled_syncs += 1
            if act := self.script.get(self.enabled_syncs):
                act(self)
        if self.syncs % self.tpdo_every == 0 and self.has_tpdo():
            image = self.word().to_bytes(2, "little") + (self.position % (1 << 32)).to_bytes(4, "little")
            image += demand.to_bytes(2, "little", signed=True)
            for _ in range(self.tpdo_copies):
                self.later(self.tpdo_after, 0x180 + self.node, image[: 6 if self.sensor else self.tpdo_length])
        offset = int.from_bytes(self.objects.get((0x60B2, 0), b""), "little", signed=True)
        if not self.is_stuck:
            self.held = self.target + offset if self.state == "enabled" else 0

    @property
    def torque(self) -> int:
        """Torque that acts [per mille]."""
        return self.held if self.state == "enabled" else 0

    def has_tpdo(self) -> bool:
        inhibit = 100_000 * int.from_bytes(self.objects[0x1800, 3], "little")
        if self.objects[0x1800, 1][3] & 0x80 or self.now - self.sent_at < inhibit:
            return False
        self.sent_at = self.now
        return True


@dataclass
class OddSensor:
    """A force sensor of its own, node 0x21: four bytes in frame 0x1A1, in answer to a SYNC or by itself."""

    every: int = 0  # [ns] by itself; 0: it answers the SYNC
    inhibit: int = 0  # [ns] between two frames
    delay: int = 200_000  # [ns] after SYNC
    length: int = 4
    is_absent: bool = False
    counts: int = 0
    ignores_tare: bool = False
    is_real: bool = False  # its value is a REAL32
    refuses: tuple[int, ...] = ()  # writes
    objects: dict[tuple[int, int], bytes] = field(
        default_factory=lambda: {
            (0x1000, 0): bytes.fromhex("94 01 02 00"),
            (0x1800, 2): b"\xff",
            (0x6125, 1): bytes(4),
            (0x6139, 1): bytes(4),
        }
    )
    due: int = _NEVER
    last: int = -_NEVER

    def sdo(self, request: bytes) -> bytes:
        place, head = (int.from_bytes(request[1:3], "little"), request[3]), request[1:4]
        if place not in self.objects:
            return b"\x80" + head + _ABSENT
        value = self.objects[place]
        if request[0] == 0x40:
            return bytes([0x43 | 4 - len(value) << 2]) + head + value.ljust(4, b"\0")
        if place[0] in self.refuses:
            return b"\x80" + head + READ_ONLY
        self.objects[place] = request[4 : 4 + len(value)]
        if place[0] in (0x6125, 0x6139) and not self.ignores_tare:
            self.counts = 0
        return b"\x60" + head + bytes(4)

    def take(self, slave: OddSlave, message: can.Message) -> None:
        if message.arbitration_id == 0x621 and not self.is_absent:
            slave.later(300_000, 0x5A1, self.sdo(bytes(message.data)))
        if message.arbitration_id == 0x000 and message.data[0] == 1 and self.every and self.due == _NEVER:
            self.due = slave.now + self.every
        answers = not self.every and self.objects[0x1800, 2] == b"\x01"
        if message.arbitration_id == 0x080 and answers and slave.now - self.last >= self.inhibit:
            self.last = slave.now
            self.show(slave, self.delay)

    def act(self, slave: OddSlave, now: int) -> None:
        if now >= self.due:
            self.due += self.every
            self.show(slave, 0)

    def show(self, slave: OddSlave, delay: int) -> None:
        if not self.is_absent:
            value = self.counts.to_bytes(4, "little", signed=True)
            slave.later(delay, 0x1A1, (struct.pack("<f", self.counts) if self.is_real else value)[: self.length])
