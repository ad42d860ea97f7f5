"""A line of simulated EtherCAT drives on one cable, with faults of the frames on it.

A frame passes every drive in turn, at once in virtual time; propagation delays are seen by the clocks only. Without
faults every frame comes back.
"""

import random
import struct
from collections.abc import Callable, Sequence
from enum import Enum
from functools import partial
from typing import Annotated, Final, NamedTuple, Protocol

from canhaptic.sim.drive.ethercat.drive_node import EthercatDrive
from canhaptic.sim.drive.ethercat.esc import AL_STATUS, DL_STATUS, SYSTEM_TIME, SyncManager
from canhaptic.sim.drive.profile.timers import TimedDrives
from canhaptic.units import Parameters, quantity

_HOP_NS: Final = 600  # [ns] from one drive to the next
_DATAGRAM: Final = struct.Struct("<BBHHHH")  # command, index, address, offset, length, interrupts
_COUNTER: Final = struct.Struct("<H")
_ETHERTYPE: Final = b"\x88\xa4"
_FIRST, _HEAD, _TAIL = 16, 10, 2  # [bytes] to the first datagram; head and counter of a datagram
_SOURCE: Final = 6  # place of the source address
_LENGTH, _MORE = 0x7FF, 0x8000
_BRD, _LRD, _LWR, _LRW, _FRMW = 7, 10, 11, 12, 14
_BY_POSITION: Final = frozenset((1, 2, 3, 13))
_BY_STATION: Final = frozenset((4, 5, 6, 14))
_BROADCAST: Final = frozenset((7, 8, 9))
_READS: Final = frozenset((1, 3, 4, 6, 7, 9))
_WRITES: Final = {2: 1, 3: 2, 5: 1, 6: 2, 8: 1, 9: 2}  # command -> what a write adds to the working counter
_READ_MULTIPLE_WRITE: Final = frozenset((13, 14))
_COUNTED: Final = _BY_POSITION | _BROADCAST  # each drive adds one to the address
_SAFE_OP, _OP = 4, 8
_MOST_PLANS: Final = 64  # kept at a time
_LAST_DRIVE, _WITH_NEXT = 0x5611, 0x5A31  # DL status: port 0 alone, or ports 0 and 1 in use
_LATENESS: Final = 0.8  # part of the sample time by which a late frame leaves later: it misses its SYNC0

_Share = Annotated[float, quantity("1", ge=0.0, le=1.0)]
_Time = Annotated[float, quantity("s", ge=0.0, le=1e6)]


class _Clock(Protocol):
    """Clock of the master."""

    def now(self) -> int:
        """Return the time [ns]."""

    def wait_until(self, deadline: int) -> None:
        """Return when `deadline` [ns] has come."""


class Fault(Enum):
    """What happens to a frame."""

    NONE = 0
    LATE = 1
    LOST = 2
    ANSWER_LOST = 3
    LOW_COUNTER = 4


class CableEffects(Parameters):
    """Faults of the cycle's frames, from the first that finds every drive in OP. Shares are of these frames."""

    drift: Annotated[float, quantity("1", ge=-1e-3, le=1e-3)] = 0.0
    """Rate of the first drive's clock against this computer's; those of the others are random, up to it."""
    late: _Share = 0.0
    """Share that leaves late, after the SYNC0 for which it was meant."""
    lost: _Share = 0.0
    """Share that is lost before the drives."""
    answer_lost: _Share = 0.0
    """Share that passes the drives, and is lost on the way back."""
    low_counter: _Share = 0.0
    """Share that one of the drives lets pass unread."""
    falls_to_safe_op: _Time | None = None
    """Time at which a drive leaves OP by itself; None: never."""
    broken_at: _Time | None = None
    """Time at which the cable before the last drive breaks; None: never."""

    def draw(self, dice: random.Random) -> Fault:
        """Return what happens to the next frame."""
        left = dice.random()
        for fault, share in zip(list(Fault)[1:], (self.late, self.lost, self.answer_lost, self.low_counter),
                                strict=True):  # fmt: skip
            if left < share:
                return fault
            left -= share
        return Fault.NONE


class _Part(NamedTuple):
    """A part of a datagram that is memory of a sync manager."""

    place: int  # in the datagram
    size: int
    manager: SyncManager
    offset: int  # in its region


class _Access(NamedTuple):
    """What a datagram of the process image does with the memory of one drive."""

    drive: EthercatDrive
    reads: tuple["_Part", ...]
    writes: tuple["_Part", ...]


_Layout = tuple[Callable[[bytes], tuple[object, ...]], tuple[object, ...], list[tuple[int, int, int, int, int]]]
"""Reader of the heads in a frame of one length, the heads known, and the datagrams that they describe."""
_NO_LAYOUT: Final[_Layout] = (lambda _: ("unknown",), (), [])


class Cable(TimedDrives):
    """Drives in the order of the cable.

    Args:
        drives: The drives.
        sample_time_ns: Sample time of the cycle [ns].
        effects: Faults of frames; None: none.
        seed: Seed of the random faults.

    Attributes:
        drives: The drives.
        counts: Faults so far.
        draw: Returns what happens to the next frame of the cycle; None: no faults.
    """

    def __init__(
        self, drives: Sequence[EthercatDrive], sample_time_ns: int, effects: CableEffects | None = None, seed: int = 0
    ) -> None:
        self.drives: tuple[EthercatDrive, ...] = tuple(drives)
        self._reach = len(self.drives)
        self._sample_time, self._effects, self._dice = sample_time_ns, effects or CableEffects(), random.Random(seed)
        self.draw: Callable[[], Fault] | None = None if effects is None else partial(effects.draw, self._dice)
        self.counts = dict.fromkeys(Fault, 0)
        self._clock: _Clock | None = None
        self._epoch: int | None = None  # host time at which faults begin
        self._layouts: dict[int, _Layout] = {}
        self._plans: dict[tuple[int, int, int], tuple[_Access, ...]] = {}
        last = self._reach - 1
        for place, drive in enumerate(self.drives):
            drive.esc.arrives, drive.esc.returns = _HOP_NS * place, _HOP_NS * (2 * last - place)
            drive.map_changed = self._plans.clear  # type: ignore[method-assign]
        self._show_links()

    def _show_links(self) -> None:
        self._reached = self.drives[: self._reach]
        for place, drive in enumerate(self.drives):
            struct.pack_into("<H", drive.esc.registers, DL_STATUS,
                             _WITH_NEXT if place + 1 < self._reach else _LAST_DRIVE)  # fmt: skip

    def use(self, clock: _Clock) -> None:
        """Take the time from this clock."""
        self._clock = clock

    def totals(self) -> dict[str, int]:
        """Return the faults so far by name."""
        return {fault.name.lower(): count for fault, count in self.counts.items() if fault is not Fault.NONE}

    # --- time -----------------------------------------------------------------------------------------------------

    def process(self, now: int) -> None:
        """Run every drive up to `now` [ns]."""
        for drive in self.drives:
            drive.advance(now)

    # --- frames ---------------------------------------------------------------------------------------------------

    def exchange(self, frame: bytes, deadline: int) -> bytes | None:
        """Carry a frame now; return it as it comes back, or None where it does not until `deadline` [ns]."""
        clock = self._clock
        assert clock is not None, "call use(clock) first"  # noqa: S101
        if self.draw is None and self._reach:
            return self.carry(frame, clock.now())
        fault = self._fault(frame, clock.now())
        if fault is Fault.LATE:
            clock.wait_until(clock.now() + round(_LATENESS * self._sample_time))
        answer = None
        if fault is not Fault.LOST:
            left_out = self._dice.randrange(self._reach) if fault is Fault.LOW_COUNTER and self._reach else -1
            answer = self.carry(frame, clock.now(), left_out)
        if answer is None or fault is Fault.ANSWER_LOST:
            clock.wait_until(deadline)
            return None
        return answer

    def _fault(self, frame: bytes, now: int) -> Fault:
        """Return what happens to a frame: to those of the cycle, once every drive is in OP."""
        if self.draw is None or not self._is_cyclic(frame):
            return Fault.NONE
        if self._epoch is None:
            if any(drive.al_state != _OP for drive in self.drives):
                return Fault.NONE
            self._epoch = now
        self._strike((now - self._epoch) * 1e-9)
        fault = self.draw()
        self.counts[fault] += 1
        return fault

    def _is_cyclic(self, frame: bytes) -> bool:
        """Whether the last datagram of a frame is one of the process image."""
        at, end = _FIRST, len(frame)
        while at + _HEAD <= end:
            length = frame[at + 6] | frame[at + 7] << 8
            if not length & _MORE:
                return _LRD <= frame[at] <= _LRW
            at += _HEAD + (length & _LENGTH) + _TAIL
        return False

    def _strike(self, elapsed: float) -> None:
        """Let happen what happens once."""
        effects = self._effects
        if effects.falls_to_safe_op is not None and elapsed >= effects.falls_to_safe_op:
            self._effects = effects = effects.model_copy(update={"falls_to_safe_op": None})
            self.drives[self._dice.randrange(len(self.drives))].leave_op()
        if effects.broken_at is not None and elapsed >= effects.broken_at and self._reach == len(self.drives):
            self._reach -= 1
            self._plans.clear()
            self._show_links()

    def carry(self, frame: bytes, now: int, left_out: int = -1) -> bytes | None:
        """Return a frame as it comes back from the drives, all datagrams served; None where no drive is reached.

        Args:
            frame: The frame, of any content.
            now: Host time [ns].
            left_out: Place of a drive that lets it pass unread; -1: none does.
        """
        for drive in self.drives:
            if drive.servo.now != now or now >= drive.timers.earliest:
                drive.advance(now)
        if not self._reach:
            return None
        buffer, end = bytearray(frame), len(frame)
        if end < _FIRST + _HEAD + _TAIL or frame[12:14] != _ETHERTYPE:
            return frame
        buffer[_SOURCE] |= 2  # the mark of a frame that has passed a drive
        reached = self._reached
        if left_out >= 0:
            reached = reached[:left_out] + reached[left_out + 1 :]
        for command, address, offset, data, stop in self._layout(frame):
            if _LRD <= command <= _LRW:
                counted = self._serve_image(buffer, command, address | offset << 16, data, stop, left_out)
            elif command == _FRMW and offset == SYSTEM_TIME and stop - data == 8:
                counted = _spread_time(buffer, address, data, reached)
            else:
                counted = _serve_registers(buffer, command, address, offset, data, stop, reached)
                if command in _COUNTED:
                    address = (address + len(reached)) & 0xFFFF
                    buffer[data - 8], buffer[data - 7] = address & 0xFF, address >> 8
            counter = buffer[stop] + counted
            buffer[stop], buffer[stop + 1] = counter & 0xFF, buffer[stop + 1] + (counter >> 8) & 0xFF
        return bytes(buffer)

    def _layout(self, frame: bytes) -> "list[tuple[int, int, int, int, int]]":
        """Return command, address, offset, begin and end of the data of each datagram; the frames of a cycle repeat."""
        end = len(frame)
        unpack, known, layout = self._layouts.get(end, _NO_LAYOUT)
        if unpack(frame) == known:
            return layout
        layout, at, more, heads = [], _FIRST, _MORE, f"={_FIRST}x"
        while more and at + _HEAD + _TAIL <= end:
            command, _, address, offset, length, _ = _DATAGRAM.unpack_from(frame, at)
            more, data = length & _MORE, at + _HEAD
            stop = data + (length & _LENGTH)
            if stop + _TAIL > end:
                break
            heads += f"Bx6s{stop - at - 8 + _TAIL}x"  # all but the number of the frame
            layout.append((command, address, offset, data, stop))
            at = stop + _TAIL
        unpack = struct.Struct(f"{heads}{end - at}x").unpack
        self._layouts[end] = unpack, unpack(frame), layout
        return layout

    # --- process image --------------------------------------------------------------------------------------------

    def _serve_image(self, buffer: bytearray, command: int, logical: int, data: int, stop: int, left_out: int) -> int:
        """Serve a datagram of the process image; return what is added to its counter."""
        key = (command, logical, stop - data)
        plan = self._plans.get(key)
        if plan is None:
            if len(self._plans) >= _MOST_PLANS:
                self._plans.clear()
            plan = self._plans[key] = self._plan(*key)
        counted, passed = 0, None if left_out < 0 else self.drives[left_out]
        for drive, reads, writes in plan:
            if drive.al_state < _SAFE_OP or drive is passed:
                continue
            esc, wrote, read = drive.esc, False, False
            for place, size, manager, offset in writes:
                first = data + place
                wrote |= esc.write_part(manager, offset, bytes(buffer[first : first + size]))
            for place, size, manager, offset in reads:
                found = esc.read_part(manager, offset, size)
                if found is not None:
                    first = data + place
                    buffer[first : first + size] = found
                    read = True
            counted += read + wrote * (2 if command == _LRW else 1)
        return counted

    def _plan(self, command: int, logical: int, size: int) -> tuple[_Access, ...]:
        found = []
        for drive in self.drives[: self._reach]:
            reads, writes = list[_Part](), list[_Part]()
            for fmmu in drive.esc.fmmus:
                low, high = max(fmmu.logical, logical), min(fmmu.logical + fmmu.size, logical + size)
                at = fmmu.physical + low - fmmu.logical
                manager = drive.esc.manager_of(at, high - low) if low < high else None
                if manager is not None:
                    part = _Part(low - logical, high - low, manager, at - manager.start)
                    if fmmu.is_read and command != _LWR:
                        reads.append(part)
                    if fmmu.is_written and command != _LRD:
                        writes.append(part)
            if reads or writes:
                found.append(_Access(drive, tuple(reads), tuple(writes)))
        return tuple(found)


def _serve_registers(
    buffer: bytearray, command: int, address: int, offset: int, data: int, stop: int, drives: Sequence[EthercatDrive]
) -> int:
    """Serve a datagram of registers or memory, that of the cycle first; return what is added to its counter."""
    if command == _BRD and offset == AL_STATUS and stop - data == 2:
        for drive in drives:
            buffer[data] |= drive.esc.registers[AL_STATUS]
        return len(drives)
    serve = _spread if command in _READ_MULTIPLE_WRITE else _serve
    return serve(buffer, command, address, offset, data, stop, drives)


def _serve(
    buffer: bytearray, command: int, address: int, offset: int, data: int, stop: int, drives: Sequence[EthercatDrive]
) -> int:
    """Serve a datagram of registers or memory; return what is added to its counter."""
    counted, size = 0, stop - data
    for drive in _addressed(command, address, drives):
        found = drive.esc.read(offset, size) if command in _READS else None
        if command in _WRITES:
            counted += _WRITES[command] * drive.esc.write(offset, bytes(buffer[data:stop]))
        if found is None:
            continue
        counted += 1
        if command in _BROADCAST:
            found = (int.from_bytes(buffer[data:stop], "little") | int.from_bytes(found, "little")).to_bytes(
                size, "little"
            )
        buffer[data:stop] = found
    return counted


def _spread(
    buffer: bytearray, command: int, address: int, offset: int, data: int, stop: int, drives: Sequence[EthercatDrive]
) -> int:
    """Serve a datagram that is read from one drive and written to the others; return what is added to its counter."""
    counted, source = 0, _addressed(command, address, drives)
    for drive in drives:
        if not source or drive is not source[0]:
            counted += drive.esc.write(offset, bytes(buffer[data:stop]))
        elif (found := drive.esc.read(offset, stop - data)) is not None:
            buffer[data:stop] = found
            counted += 1
    return counted


def _spread_time(buffer: bytearray, address: int, data: int, drives: Sequence[EthercatDrive]) -> int:
    """Serve the datagram that spreads the time of the reference clock; return what is added to its counter."""
    time = None
    for drive in drives:
        if drive.esc.station == address:
            time = drive.esc.system_time()
            buffer[data : data + 8] = time.to_bytes(8, "little")
        else:
            drive.esc.follow(int.from_bytes(buffer[data : data + 8], "little") if time is None else time)
    return len(drives)


def _addressed(command: int, address: int, drives: Sequence[EthercatDrive]) -> Sequence[EthercatDrive]:
    if command in _BROADCAST:
        return drives
    if command in _BY_POSITION:
        place = -address & 0xFFFF
        return drives[place : place + 1]
    return [drive for drive in drives if drive.esc.station == address] if command in _BY_STATION else ()
