"""A line of simulated EtherCAT drives with a thin master, in virtual time: from INIT to OP, then two frames a cycle."""

import struct
from collections.abc import Iterator
from functools import lru_cache
from typing import Any

from canhaptic.canopen.eds import read_dictionary
from canhaptic.drive.clock import VirtualClock
from canhaptic.drive.ethercat.segment import AlState, Cycle, FrameKind
from canhaptic.drive.ethercat.thin_master import ThinMaster
from canhaptic.sim.drive import SimulatedDriveParameters
from canhaptic.sim.drive.ethercat.cable import Cable, CableEffects, Fault
from canhaptic.sim.drive.ethercat.drive_node import ClockParameters, EthercatDrive
from tests.sim_drive.drive_on_bus import TRAITS, Mass

PERIOD = 1_000_000  # [ns]
COMMANDS = {0x0250: 6, 0x0231: 7, 0x0218: 0x80}
EXACT = ClockParameters()
dictionary_of = lru_cache(read_dictionary)


def make_drive(clock: ClockParameters = EXACT, **parameters: Any) -> EthercatDrive:
    given = {"counts_per_unit": 1e4, "rated_torque": 100.0, **parameters}
    dictionary = dictionary_of(TRAITS / "ethercat_servo.eds", 1)
    return EthercatDrive(dictionary, Mass(), SimulatedDriveParameters(**given), PERIOD, clock)


class Line:
    """Drives, cable and master; `start` takes the drives to OP, `cycle` runs one sample time."""

    def __init__(self, *drives: EthercatDrive, effects: CableEffects | None = None, seed: int = 0) -> None:
        self.drives = drives or (make_drive(),)
        self.cable = Cable(self.drives, PERIOD, effects, seed)
        self.clock = VirtualClock((self.cable,), start=10_000_000)
        self.cable.use(self.clock)
        self.master = ThinMaster(self.cable, self.clock)
        self.words = [6] * len(self.drives)
        self.due, self.first, self.integral = 0, 0, 0.0
        self.hold: int | None = None  # in which the last frame that came back whole arrived
        self.missed = self.unanswered = self.twice = 0

    def configure(self, limit: int = 10_000) -> None:
        """From INIT to the end of the set-up in PRE-OP: objects, process data, clocks, SYNC0."""
        master = self.master
        master.scan()
        for n in range(len(self.drives)):
            master.request(n, AlState.PRE_OP)
            master.write(n, 0x6060, 0, b"\x0a")
            master.write(n, 0x10F1, 2, struct.pack("<H", limit))
        master.map([(4, 8)] * len(self.drives))
        master.align_clocks()
        now = int.from_bytes(master.register(0, 0x910, size=8), "little")
        self.first = (now // PERIOD + 20) * PERIOD
        for n in range(len(self.drives)):
            master.register(n, 0x990, struct.pack("<Q", self.first))
            master.register(n, 0x9A0, struct.pack("<I", PERIOD))
            master.register(n, 0x980, b"\x00\x03")
        self.due = self.clock.now() + self.first - now + PERIOD // 4

    def start(self, limit: int = 10_000) -> None:
        self.configure(limit)
        for n in range(len(self.drives)):
            self.master.request(n, AlState.SAFE_OP)
        for _ in range(60):
            self.cycle()
        for n in range(len(self.drives)):
            self.master.request(n, AlState.OP)
        for _ in range(20):
            self.cycle()
        self.missed = self.unanswered = self.twice = 0

    def cycle(self, *torques: int, follow: bool = True) -> list[tuple[int, int, int]] | None:
        """Read, compute, write; return (statusword, counts, demand) of each drive, None where they did not come."""
        self.clock.wait_until(self.due)
        end = self.due + PERIOD // 4
        seen = None
        answer = self.master.exchange(FrameKind.READ, end)
        if answer is not None and answer.is_whole:
            seen = list(struct.iter_unpack("<Hih", answer.inputs))
            if follow:
                self.words = [COMMANDS.get(word & 0x027F, 15) for word, _, _ in seen]
        for n, word in enumerate(self.words):
            torque = torques[n] if n < len(torques) else 0
            struct.pack_into("<Hh", self.master.outputs, 4 * n, word, torque)
        self.due += PERIOD
        self._judge(self.master.exchange(FrameKind.WRITE, end + PERIOD // 4))
        return seen

    def _judge(self, answer: Cycle | None) -> None:
        """Count the holds without a frame, and let the host follow the reference clock."""
        if answer is None or not answer.is_whole:
            self.unanswered += 1
            return
        hold, phase = divmod(answer.dc_time - self.first, PERIOD)
        if self.hold is not None:
            self.missed += max(0, hold - self.hold - 1)
            self.twice += hold == self.hold
        self.hold = hold
        error = phase - PERIOD // 4
        if abs(error) < PERIOD // 4:
            self.integral += 0.002 * error
            self.due -= round(0.1 * error + self.integral)

    def missed_by(self, n: int) -> int:
        entry = self.drives[n].store.find(0x1C32, 11)
        assert entry is not None
        return entry.number


def plan(faults: dict[int, Fault]) -> Iterator[Fault]:
    """Yield what happens to each frame of the cycle: cycle -> fault of its second frame."""
    k = 0
    while True:
        yield Fault.NONE
        yield faults.get(k, Fault.NONE)
        k += 1
