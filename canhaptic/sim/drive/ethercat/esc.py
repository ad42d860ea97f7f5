"""The EtherCAT slave controller of a simulated drive: registers, memory, sync managers, FMMUs and EEPROM access.

Registers and their meaning are those of ETG.1000.4 and of the data sheet of the ET1100. FMMUs map whole bytes. What
happens by a write - a state asked for, outputs, mail - goes to the `Application`, the drive itself.
"""

import struct
from typing import Final, NamedTuple, Protocol

from canhaptic.sim.drive.ethercat.distributed_clock import DistributedClock

STATION_ADDRESS: Final = 0x0010
DL_STATUS: Final = 0x0110
AL_CONTROL: Final = 0x0120
AL_STATUS: Final = 0x0130
AL_CODE: Final = 0x0134
_WATCHDOG_DIVIDER: Final = 0x0400
_WATCHDOG_OUTPUTS: Final = 0x0420
_WATCHDOG_STATUS: Final = 0x0440
_EEPROM_CONTROL: Final = 0x0502
_EEPROM_ADDRESS: Final = 0x0504
_EEPROM_DATA: Final = 0x0508
_FMMUS: Final = range(0x0600, 0x0640, 16)
_SYNC_MANAGERS: Final = range(0x0800, 0x0820, 8)
_LATCH: Final = 0x0900
SYSTEM_TIME: Final = 0x0910
_LATCHED: Final = 0x0918
_OFFSET: Final = 0x0920
_DELAY: Final = 0x0928
_DIFFERENCE: Final = 0x092C
_SPEED_START: Final = 0x0930
_ACTIVATION: Final = 0x0981
_START_TIME: Final = 0x0990
_SYNC0_CYCLE: Final = 0x09A0
_CLOCK: Final = range(_LATCH, 0x0940)
_CLOCK_WRITTEN: Final = range(_LATCH, 0x09B0)
_MEMORY: Final = 0x1000
_END: Final = 0x3000
_INFORMATION: Final = bytes((0x11, 0, 2, 0, len(_FMMUS), len(_SYNC_MANAGERS), 8, 0x0F, 0x0C))
_WRITABLE: Final = (
    (0x0010, 0x0012), (0x0100, 0x0104), (0x0120, 0x0122), (0x0200, 0x0202), (0x0300, 0x0314), (0x0400, 0x0402),
    (0x0410, 0x0412), (0x0420, 0x0422), (0x0500, 0x0510), (0x0600, 0x0640), (0x0800, 0x0805), (0x0806, 0x080D),
    (0x080E, 0x0815), (0x0816, 0x081D), (0x081E, 0x0820), (0x0900, 0x0904), (0x0920, 0x092C), (0x0930, 0x0936),
    (0x0980, 0x0982), (0x0990, 0x0998), (0x09A0, 0x09A8),
)  # fmt: skip
"""Registers that a master may write, with their ends; the system time apart."""
_MASK32: Final = (1 << 32) - 1
_FULL: Final = 0x08  # bit of the status of a mailbox
_MAILBOX: Final = 0x02  # bits of the control byte of a sync manager: one buffer, with a handshake
_FROM_MASTER: Final = 0x04
_TRIGGERS_WATCHDOG: Final = 0x40
_REPEAT: Final = 0x02  # bit of the activation of a sync manager


class Application(Protocol):
    """The drive behind its controller."""

    def control(self, request: int) -> None:
        """Act on a write to AL control."""

    def outputs_came(self) -> None:
        """Act on outputs that have arrived whole."""

    def mail_came(self, mail: bytes) -> None:
        """Act on a mail of the master."""

    def mail_taken(self) -> None:
        """Act on a mail of the drive that the master has read."""

    def clock_moved(self) -> None:
        """Act on a change of the clock, or of SYNC0."""

    def map_changed(self) -> None:
        """Act on a change of sync managers or FMMUs."""


class SyncManager:
    """A region of the memory that master and drive share: three buffers of which one is whole, or a mailbox.

    An access begins at the first byte, and ends with the last: only then a buffer changes hands.

    Attributes:
        start, length: Region [bytes].
        is_enabled: Whether it is active.
        from_master: Whether the master writes it.
        is_mailbox: Whether it is a mailbox.
        triggers_watchdog: Whether a whole write restarts the watchdog of the outputs.
        is_fresh: Whether the writer has completed a buffer that the reader has not seen.
    """

    def __init__(self) -> None:
        self._settings = bytes(8)
        self.start = self.length = 0
        self.is_enabled = self.from_master = self.is_mailbox = self.triggers_watchdog = False
        self._reset()

    def _reset(self) -> None:
        self._whole = bytes(self.length)
        self._filling, self._reading = bytearray(self.length), self._whole
        self._is_open = self.is_fresh = False

    def configure(self, settings: bytes) -> None:
        """Apply the eight bytes of its registers."""
        own = settings[:5] + bytes((settings[6] & 1,))  # its status is the controller's, its repetition the mailbox's
        if own == self._settings:
            return
        self._settings = own
        self.start, self.length, control = struct.unpack_from("<HHB", own)
        self.is_enabled = bool(own[5]) and self.length > 0 and _MEMORY <= self.start <= _END - self.length
        self.from_master, self.is_mailbox = bool(control & _FROM_MASTER), control & 3 == _MAILBOX
        self.triggers_watchdog = bool(control & _TRIGGERS_WATCHDOG)
        if self.is_enabled:
            self._reset()

    def write(self, offset: int, content: bytes) -> bool:
        """Write from the bus; return whether it was accepted."""
        if not self.from_master or (self.is_mailbox and self.is_fresh):
            return False
        end = offset + len(content)
        if end == self.length and not offset:
            self._whole, self.is_fresh = content, True
            return True
        if offset == 0:
            self._is_open = True
        elif not self._is_open:
            return False
        self._filling[offset:end] = content
        if end == self.length:
            self._whole, self._is_open, self.is_fresh = bytes(self._filling), False, True
        return True

    def read(self, offset: int, size: int) -> bytes | None:
        """Read from the bus; return None where there is nothing to read."""
        if self.from_master or (self.is_mailbox and not self.is_fresh):
            return None
        if offset == 0:
            self._is_open, self._reading = True, self._whole
        elif not self._is_open:
            return None
        if offset + size == self.length:
            self._is_open = self.is_fresh = False
        return self._reading[offset : offset + size]

    def put(self, content: bytes) -> None:
        """Write the whole buffer from the drive."""
        self._whole, self.is_fresh = content.ljust(self.length, b"\0"), True

    def take(self) -> bytes:
        """Read the whole buffer from the drive."""
        self.is_fresh = False
        return self._whole


class Fmmu(NamedTuple):
    """A part of the logical image that is memory of this drive."""

    logical: int
    size: int
    physical: int
    is_read: bool
    is_written: bool


class Esc:
    """The controller of one drive.

    Args:
        application: The drive behind it.
        clock: Its clock.
        eeprom: Content of its EEPROM.

    Attributes:
        registers: The registers, 0x0000 to 0x0FFF.
        managers: Sync managers 0 to 3.
        fmmus: FMMUs that are active.
        station: Station address; 0: none yet.
        watchdog_ns: Longest silence of the outputs [ns]; 0: not watched.
        now: Host time at which the present frame left the master [ns].
        arrives, returns: Time after that at which it passes this drive, and passes it again on the way back [ns].
    """

    def __init__(self, application: Application, clock: DistributedClock, eeprom: bytes) -> None:
        self._application, self.clock, self.eeprom = application, clock, eeprom
        self.registers = bytearray(_MEMORY)
        self.registers[: len(_INFORMATION)] = _INFORMATION
        self.registers[_WATCHDOG_STATUS] = 1
        struct.pack_into("<H", self.registers, _WATCHDOG_DIVIDER, 2498)  # 100 us
        struct.pack_into("<H", self.registers, _WATCHDOG_OUTPUTS, 1000)
        self._memory = bytearray(_END - _MEMORY)
        self.managers = tuple(SyncManager() for _ in _SYNC_MANAGERS)
        self.fmmus: tuple[Fmmu, ...] = ()
        self.now = self.arrives = self.returns = self.station = self.watchdog_ns = 0
        self._repeats = bytes(len(_SYNC_MANAGERS))
        self._sent = b""

    # --- what the drive asks and tells ----------------------------------------------------------------------------

    def set_al(self, status: int, code: int) -> None:
        """Show AL status and code."""
        self.registers[AL_STATUS] = status
        struct.pack_into("<H", self.registers, AL_CODE, code)

    def _read_watchdog(self) -> None:
        ticks = self._number(_WATCHDOG_OUTPUTS, 2) if self.managers[2].triggers_watchdog else 0
        self.watchdog_ns = ticks * (self._number(_WATCHDOG_DIVIDER, 2) + 2) * 40

    def show_watchdog(self, *, has_expired: bool) -> None:
        """Show whether the watchdog of the outputs has expired."""
        self.registers[_WATCHDOG_STATUS] = not has_expired
        if has_expired:
            self.registers[0x442] = min(0xFF, self.registers[0x442] + 1)

    @property
    def is_clocked(self) -> bool:
        """Whether the master has activated SYNC0 (0x0981)."""
        return self.registers[_ACTIVATION] & 3 == 3

    def send(self, mail: bytes) -> None:
        """Put a mail where the master reads it."""
        self._sent = mail
        self.managers[1].put(mail)

    def _number(self, address: int, size: int) -> int:
        return int.from_bytes(self.registers[address : address + size], "little")

    # --- what the bus reads and writes ----------------------------------------------------------------------------

    def read(self, address: int, size: int) -> bytes | None:
        """Return what a datagram reads; None where it may not."""
        end = address + size
        if address >= _MEMORY:
            return self._read_memory(address, size)
        if end > _MEMORY:
            return None
        if end > _LATCH and address < _CLOCK.stop:
            self._show_clock()
        elif end > _SYNC_MANAGERS.start and address < _SYNC_MANAGERS.stop:
            for at, manager in zip(_SYNC_MANAGERS, self.managers, strict=True):
                self.registers[at + 5] = _FULL if manager.is_mailbox and manager.is_fresh else 0
        return bytes(self.registers[address:end])

    def write(self, address: int, content: bytes) -> bool:
        """Write what a datagram brings; return whether any of it was accepted."""
        end = address + len(content)
        if address >= _MEMORY:
            return self._write_memory(address, content)
        if address == SYSTEM_TIME and len(content) in (4, 8):
            received = int.from_bytes(content, "little")
            if len(content) == 4:
                received |= self.system_time() & ~_MASK32
            self.follow(received)
            return True
        is_written = False
        for first, stop in _WRITABLE:
            low, high = max(address, first), min(end, stop)
            if low < high:
                self.registers[low:high] = content[low - address : high - address]
                is_written = True
        if is_written:
            self._act(address, end)
        return is_written

    def _act(self, address: int, end: int) -> None:
        if address < STATION_ADDRESS + 2 and end > STATION_ADDRESS:
            self.station = self._number(STATION_ADDRESS, 2)
        if address <= AL_CONTROL < end:
            self._application.control(self.registers[AL_CONTROL])
        if address < _WATCHDOG_STATUS and end > _WATCHDOG_DIVIDER:
            self._read_watchdog()
        if address <= _EEPROM_CONTROL < end:
            self._serve_eeprom()
        if address < _FMMUS.stop and end > _FMMUS.start:
            self.fmmus = tuple(found for at in _FMMUS if (found := self._fmmu(at)) is not None)
            self._application.map_changed()
        if address < _SYNC_MANAGERS.stop and end > _SYNC_MANAGERS.start:
            self._configure_managers()
        if address < _CLOCK_WRITTEN.stop and end > _CLOCK_WRITTEN.start:
            self._act_on_clock(address, end)

    def _act_on_clock(self, address: int, end: int) -> None:
        if address <= _LATCH < end:
            self._latch()
        if address < _DIFFERENCE and end > _OFFSET:
            self.clock.shift(struct.unpack_from("<q", self.registers, _OFFSET)[0], self.now)
            self.clock.delay = self._number(_DELAY, 4)
            self._application.clock_moved()
        if address < _SPEED_START + 2 and end > _SPEED_START:
            self.clock.difference = 0  # as the data sheet says; SOEM sets the system time to 0 before
        if address <= _ACTIVATION < end:
            self.clock.period = self._number(_SYNC0_CYCLE, 4)
            if self.is_clocked:
                self.clock.start(self._number(_START_TIME, 8), self.now)
            else:
                self.clock.next_sync = None
            self._application.clock_moved()

    def _fmmu(self, at: int) -> Fmmu | None:
        logical, size, first_bit, last_bit, physical, bit, kind, active = struct.unpack_from(
            "<IHBBHBBB", self.registers, at
        )
        is_whole = first_bit == bit == 0 and last_bit == 7 and size > 0
        return Fmmu(logical, size, physical, bool(kind & 1), bool(kind & 2)) if active & 1 and is_whole else None

    def _configure_managers(self) -> None:
        for at, manager in zip(_SYNC_MANAGERS, self.managers, strict=True):
            manager.configure(bytes(self.registers[at : at + 8]))
        self._read_watchdog()
        asked = self.registers[_SYNC_MANAGERS[1] + 6] & _REPEAT
        if asked != self.registers[_SYNC_MANAGERS[1] + 7] & _REPEAT:  # the master lost the answer: once more
            self.registers[_SYNC_MANAGERS[1] + 7] = asked
            if self._sent and self.managers[1].is_enabled:
                self.managers[1].put(self._sent)
        self._application.map_changed()

    def _serve_eeprom(self) -> None:
        command, at = self._number(_EEPROM_CONTROL, 2), 2 * self._number(_EEPROM_ADDRESS, 4)
        status = 0x0040  # reads eight bytes at a time
        if command & 0x0100:
            self.registers[_EEPROM_DATA : _EEPROM_DATA + 8] = self.eeprom[at : at + 8].ljust(8, b"\xff")
        elif command & 0x0600:
            status |= 0x2000  # it is neither written nor reloaded
        struct.pack_into("<H", self.registers, _EEPROM_CONTROL, status)

    # --- clock ----------------------------------------------------------------------------------------------------

    def _latch(self) -> None:
        local, now = self.clock.local, self.now
        there, back = local(now + self.arrives) & _MASK32, local(now + self.returns) & _MASK32
        struct.pack_into("<IIII", self.registers, _LATCH, there, back, 0, 0)
        struct.pack_into("<Q", self.registers, _LATCHED, local(now + self.arrives) & (_MASK32 << 32 | _MASK32))

    def _show_clock(self) -> None:
        system = self.system_time()
        struct.pack_into("<Q", self.registers, SYSTEM_TIME, system)
        struct.pack_into("<I", self.registers, _DIFFERENCE, self.clock.difference)

    def system_time(self) -> int:
        """Return the system time at which the present frame passes [ns]."""
        return self.clock.system(self.now + self.arrives)

    def follow(self, received: int) -> None:
        """Follow the system time of the reference clock [ns]."""
        clock = self.clock
        before = clock.offset
        clock.follow(received, self.now + self.arrives)
        if clock.offset != before:
            self._application.clock_moved()

    # --- memory ---------------------------------------------------------------------------------------------------

    def manager_of(self, address: int, size: int) -> SyncManager | None:
        """Return the sync manager that owns a part of the memory, or all of it."""
        for manager in self.managers:
            if manager.is_enabled and address < manager.start + manager.length and address + size > manager.start:
                return manager
        return None

    def _read_memory(self, address: int, size: int) -> bytes | None:
        manager, end = self.manager_of(address, size), address + size
        if manager is not None:
            return self.read_part(manager, address - manager.start, size)
        return bytes(self._memory[address - _MEMORY : end - _MEMORY]) if end <= _END else None

    def _write_memory(self, address: int, content: bytes) -> bool:
        manager, end = self.manager_of(address, len(content)), address + len(content)
        if manager is not None:
            return self.write_part(manager, address - manager.start, content)
        if end > _END:
            return False
        self._memory[address - _MEMORY : end - _MEMORY] = content
        return True

    def read_part(self, manager: SyncManager, offset: int, size: int) -> bytes | None:
        """Read a part of a sync manager's region; None where it may not be read, or reaches beyond it."""
        if offset < 0 or offset + size > manager.length:
            return None
        found = manager.read(offset, size)
        if found is not None and manager is self.managers[1] and manager.is_mailbox and not manager.is_fresh:
            self._application.mail_taken()
        return found

    def write_part(self, manager: SyncManager, offset: int, content: bytes) -> bool:
        """Write a part of a sync manager's region; return whether it was accepted."""
        end = offset + len(content)
        if offset < 0 or end > manager.length or not manager.write(offset, content):
            return False
        if end == manager.length:
            if manager is self.managers[2]:
                self._application.outputs_came()
            elif manager is self.managers[0] and manager.is_mailbox:
                self._application.mail_came(manager.take())
        return True
