"""A thin EtherCAT master for simulated drives in this process: a `Segment` over one call that carries a frame.

It never goes onto a wire, for which there are masters that have started thousands of kinds of drives. It takes drives
from INIT to OP, reads and writes objects by the mailbox (CoE), and sends the frames of the cycle.
"""

import struct
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any, Final, NamedTuple, Protocol

from canhaptic.canopen.objects import SdoAbort
from canhaptic.drive.clock import Clock
from canhaptic.drive.ethercat.datagrams import FIRST, HEAD, TAIL, Command, Datagram, answers_of, frame_of
from canhaptic.drive.ethercat.segment import (
    AL_CONTROL,
    AL_STATUS,
    ERROR,
    AlState,
    Cycle,
    Emergency,
    FrameKind,
    Identity,
    ImageSlice,
    await_state,
    request_state,
    sdo_error,
)
from canhaptic.errors import LinkError

_STATION: Final = 0x0010
_FEATURES: Final = 0x0008
_EEPROM_OWNER: Final = 0x0500
_EEPROM: Final = 0x0502
_EEPROM_DATA: Final = 0x0508
_FMMUS: Final = 0x0600
_SYNC_MANAGERS: Final = 0x0800
_LATCH: Final = 0x0900
_SYSTEM_TIME: Final = 0x0910
_LATCHED: Final = 0x0918
_OFFSET: Final = 0x0920
_SYNC_ACTIVATION: Final = 0x0980
_HAS_CLOCK: Final = 0x04  # bit of the features
_FIRST_STATION: Final = 0x1001
_IDENTITY_WORD, _MAILBOX_WORD, _CATEGORIES_WORD = 0x08, 0x18, 0x40
_MANAGERS_CATEGORY, _LAST_CATEGORY = 41, 0xFFFF
_MOST_CATEGORIES: Final = 64  # of an EEPROM
_BUSY, _EIGHT_BYTES, _EEPROM_ERRORS = 0x8000, 0x0040, 0x7800
_ANSWER_NS: Final = 2_000_000  # within which a frame comes back
_POLL_NS: Final = 500_000  # between two looks at what is not there yet
_MAIL_NS: Final = 1_000_000_000  # within which a drive answers a mail
_TRIES: Final = 10  # of a frame that does not come back
_MAIL_HEAD: Final = struct.Struct("<HHBBH")  # length, address, channel, kind and counter, service
_COE: Final = 3
_EMERGENCY, _REQUEST, _RESPONSE = 1, 2, 3  # services
_SDO: Final = struct.Struct("<BHB")
_ABORT: Final = struct.Struct("<BHBI")
_TOGGLE: Final = 0x10
_REPEAT: Final = 0x02  # in the activation of a sync manager
_TRIGGERS_WATCHDOG: Final = 0x40  # in the control byte of a sync manager
_LARGEST_OBJECT: Final = 1 << 16  # [bytes]
_OUTPUTS, _INPUTS = 2, 3  # sync managers
_MASK32: Final = (1 << 32) - 1
_MASK64: Final = (1 << 64) - 1
_READ: Final = FrameKind.READ
_tuple: Final = tuple.__new__  # makes a record at half the cost of calling its class


class Line(Protocol):
    """What carries a frame along the drives."""

    def exchange(self, frame: bytes, deadline: int) -> bytes | None:
        """Return a frame as it comes back, or None where it does not until `deadline` [ns]."""


class _Region(NamedTuple):
    """Start, length and control byte of a sync manager."""

    start: int
    length: int
    control: int


_Frame = tuple[bytearray, int, Callable[[bytes], tuple[Any, ...]], tuple[int, int, int]]
"""A frame of the cycle, the end of its outputs, what reads its answer, and the counters of a whole one."""


class _Drive:
    """What the master knows of one drive."""

    def __init__(self, station: int, *, has_clock: bool) -> None:
        self.station, self.has_clock = station, has_clock
        self.managers: list[_Region] = []
        self.counter = self.repeat = 0  # of mails
        self.emergencies = deque[Emergency]()


class ThinMaster:
    """A line of simulated drives; see `drive.ethercat.segment.Segment`.

    Args:
        line: What carries the frames.
        clock: Clock of every wait.

    Attributes:
        outputs: Image of all outputs, sent with the next frame that writes; made by `map`, and empty before.
    """

    repeats_outputs = False

    def __init__(self, line: Line, clock: Clock) -> None:
        self._exchange, self._clock = line.exchange, clock
        self._index = 0
        self._drives: list[_Drive] = []
        self._reference: _Drive | None = None
        self._sizes: Sequence[tuple[int, int]] = ()
        self.outputs = bytearray()
        self._frames: dict[int, _Frame] = {}  # by command

    # --- frames ---------------------------------------------------------------------------------------------------

    def _send(self, *datagrams: Datagram) -> list[Datagram]:
        """Send datagrams until they come back, and return them; raise LinkError."""
        for _ in range(_TRIES):
            self._index = (self._index + 1) & 0xFF
            frame = frame_of(self._index, datagrams)
            answer = self._exchange(frame, self._clock.now() + _ANSWER_NS)
            if answer is not None and (found := answers_of(answer, self._index, datagrams)) is not None:
                return found
        raise LinkError(
            f"no answer to {_TRIES} frames: got none back, expected each within {_ANSWER_NS / 1e6:g} ms; "
            "check cable and power of the drives"
        )

    def _one(self, command: Command, address: int, offset: int, data: bytes, expected: int | None = None) -> Datagram:
        """Send one datagram; raise LinkError where its working counter is not as expected."""
        found = self._send(Datagram(command, address, offset, data))[0]
        if expected is not None and found.counter != expected:
            raise LinkError(
                f"register {offset:#06x} at {address:#06x}: got working counter {found.counter}, expected {expected}; "
                "a drive was lost, or refuses the access: check cable and power"
            )
        return found

    def register(self, drive: int, address: int, data: bytes | None = None, size: int = 0) -> bytes:
        """Write `data` to registers of a drive, or with None read `size` bytes; return what was read or written."""
        station = self._drives[drive].station
        if data is None:
            return self._one(Command.READ, station, address, bytes(size), 1).data
        return self._one(Command.WRITE, station, address, data, 1).data

    # --- who is there ---------------------------------------------------------------------------------------------

    def scan(self) -> Sequence[Identity]:
        """Take all drives to INIT, switch SYNC0 off, set addresses and mailboxes; return who they are."""
        self._drives, self._reference, self._sizes, self.outputs = [], None, (), bytearray()
        count = self._one(Command.READ_ALL, 0, 0, bytes(1)).counter
        self._one(Command.WRITE_ALL, 0, AL_CONTROL, bytes((AlState.INIT | ERROR, 0)), count)
        self._one(Command.WRITE_ALL, 0, _SYNC_ACTIVATION, bytes(2))  # without counter: not every drive has a clock
        self._one(Command.WRITE_ALL, 0, _FMMUS, bytes(64), count)
        self._one(Command.WRITE_ALL, 0, _SYNC_MANAGERS, bytes(32), count)
        for place in range(count):
            station = _FIRST_STATION + place
            self._one(Command.WRITE_AT, -place & 0xFFFF, _STATION, struct.pack("<H", station), 1)
            features = self._one(Command.READ, station, _FEATURES, bytes(1), 1).data[0]
            self._drives.append(_Drive(station, has_clock=bool(features & _HAS_CLOCK)))
            await_state(self, self._clock, place, AlState.INIT, _MAIL_NS, _POLL_NS)
        return [self._identify(place) for place in range(count)]

    def _identify(self, place: int) -> Identity:
        """Read the EEPROM of a drive, and set its mailboxes."""
        drive = self._drives[place]
        self.register(place, _EEPROM_OWNER, bytes(2))
        head = self._eeprom(place, _IDENTITY_WORD, 16)
        out, out_size, into, into_size = struct.unpack("<HHHH", self._eeprom(place, _MAILBOX_WORD, 8))
        drive.managers = self._managers(place) or [
            _Region(out, out_size, 0x26), _Region(into, into_size, 0x22), _Region(0x1100, 0, 0x64),
            _Region(0x1400, 0, 0x20),
        ]  # fmt: skip
        for number, (start, size) in enumerate(((out, out_size), (into, into_size))):
            region = drive.managers[number]
            drive.managers[number] = region = region._replace(start=start, length=size)
            self._set_manager(place, number, region)
        return Identity(*struct.unpack("<IIII", head))

    def _managers(self, place: int) -> list[_Region]:
        """Return the sync managers that the EEPROM of a drive lists; none where it lists fewer than four."""
        word = _CATEGORIES_WORD
        for _ in range(_MOST_CATEGORIES):
            kind, words = struct.unpack("<HH", self._eeprom(place, word, 4))
            if kind == _LAST_CATEGORY:
                break
            if kind == _MANAGERS_CATEGORY:
                rows = struct.iter_unpack("<HHBBBB", self._eeprom(place, word + 2, words * 2 // 8 * 8))
                found = [_Region(start, size, control) for start, size, control, _, _, _ in rows]
                return found if len(found) > _INPUTS else []
            word += 2 + words
        return []

    def _eeprom(self, place: int, word: int, size: int) -> bytes:
        """Return `size` bytes of the EEPROM of a drive; raise LinkError."""
        content = b""
        while len(content) < size:
            at = word + len(content) // 2
            self.register(place, _EEPROM, struct.pack("<HI", 0x0100, at))
            end = self._clock.now() + _MAIL_NS
            while (status := int.from_bytes(self.register(place, _EEPROM, size=2), "little")) & _BUSY:
                self._wait(end, f"drive {place}: its EEPROM is busy")
            if status & _EEPROM_ERRORS:
                raise LinkError(
                    f"drive {place}: word {at:#06x} of the EEPROM: got status {status:#06x}, expected no error; "
                    "write the EEPROM again with the vendor's tool"
                )
            content += self.register(place, _EEPROM_DATA, size=8 if status & _EIGHT_BYTES else 4)
        return content[:size]

    def _wait(self, end: int, what: str) -> None:
        """Wait for a short time; raise LinkError where `end` [ns] has come."""
        now = self._clock.now()
        if now >= end:
            raise LinkError(f"{what} for too long; power the drive off and on")
        self._clock.wait_until(now + _POLL_NS)

    def _set_manager(self, place: int, number: int, region: _Region) -> None:
        settings = struct.pack("<HHBBBB", *region, 0, region.length > 0, 0)
        self.register(place, _SYNC_MANAGERS + 8 * number, settings[:5])
        self.register(place, _SYNC_MANAGERS + 8 * number + 6, settings[6:])

    # --- states ---------------------------------------------------------------------------------------------------

    def request(self, drive: int, state: AlState, timeout_ns: int = 1_000_000_000) -> None:
        """Ask a drive for a state and return once it is there; raise AlError where it refuses or stays away."""
        request_state(self, self._clock, drive, state, timeout_ns, _POLL_NS)

    # --- process image and clocks ---------------------------------------------------------------------------------

    def map(self, sizes: Sequence[tuple[int, int]]) -> Sequence[ImageSlice]:
        """Set sync managers 2 and 3 and the FMMUs for the bytes of outputs and inputs of each drive.

        The image of outputs is zero afterwards.
        """
        outputs = sum(size[0] for size in sizes)
        slices, output, into = list[ImageSlice](), 0, 0
        for place, (output_size, input_size) in enumerate(sizes):
            rows = ((_OUTPUTS, output, output_size, 2), (_INPUTS, outputs + into, input_size, 1))
            for unit, (number, logical, size, kind) in enumerate(rows):
                start, _, control = self._drives[place].managers[number]
                watch = _TRIGGERS_WATCHDOG if number == _OUTPUTS else 0  # some EEPROMs leave it out
                region = _Region(start, size, control | watch)
                self._set_manager(place, number, region)
                fmmu = struct.pack("<IHBBHBBBxxx", logical, size, 0, 7, region.start, 0, kind, size > 0)
                self.register(place, _FMMUS + 16 * unit, fmmu)
            slices.append(ImageSlice(output, output_size, into, input_size))
            output, into = output + output_size, into + input_size
        self.outputs = bytearray(outputs)
        self._sizes = sizes
        self._make_frames()
        return slices

    def _make_frames(self) -> None:
        """Make the frames of the cycle: time of the reference clock, AL status of all, and the image."""
        outputs, inputs = (sum(size[n] for size in self._sizes) for n in (0, 1))
        writers, readers = (sum(size[n] > 0 for size in self._sizes) for n in (0, 1))
        reference = self._reference
        clocks = sum(drive.has_clock for drive in self._drives)
        station = 0 if reference is None else reference.station
        count = len(self._drives)
        for kind, logical, size, expected in (
            (FrameKind.READ, outputs, inputs, readers),
            (FrameKind.WRITE, 0, outputs, writers),
            (FrameKind.BOTH, 0, outputs + inputs, 2 * writers + readers),
        ):
            parts = (
                Datagram(Command.SPREAD, station, _SYSTEM_TIME, bytes(8)),
                Datagram(Command.READ_ALL, 0, AL_STATUS, bytes(2)),
                Datagram(kind, logical & 0xFFFF, logical >> 16, bytes(size)),
            )
            frame = bytearray(frame_of(0, parts))
            sent = 0 if kind is _READ else outputs
            answer = struct.Struct(f"<{FIRST + HEAD}xQH{HEAD}xBxH{HEAD}x{sent}x{size - sent}sH")
            counters = 0 if reference is None else clocks, count, expected
            self._frames[kind.value] = frame, _IMAGE + HEAD + sent, answer.unpack_from, counters

    def align_clocks(self) -> None:
        """Measure the propagation delays and set the offsets: the first drive with a clock leads the others."""
        self._one(Command.WRITE_ALL, 0, _LATCH, bytes(4))
        latched = []
        for place, drive in enumerate(self._drives):
            if drive.has_clock:
                ports = struct.unpack("<II", self.register(place, _LATCH, size=8))
                local = int.from_bytes(self.register(place, _LATCHED, size=8), "little")
                latched.append((place, drive, (ports[1] - ports[0]) & _MASK32, local))
        for place, drive, behind, local in latched:
            if self._reference is None:
                self._reference, reference = drive, (behind, local)
            delay = (reference[0] - behind) // 2  # half of the way there and back between them
            offset = reference[1] + delay - local
            self.register(place, _OFFSET, struct.pack("<QI", offset & _MASK64, delay & _MASK32))
        self._make_frames()

    # --- cycle ----------------------------------------------------------------------------------------------------

    def exchange(self, kind: FrameKind, deadline: int) -> Cycle | None:
        """Send one frame of the cycle; return its answer, or None where none came until `deadline` [ns].

        An answer to an older frame is dropped: it is never taken for that of this one.
        """
        frame, end, unpack, expected = self._frames[kind.value]
        self._index = index = (self._index + 1) & 0xFF
        frame[FIRST + 1] = frame[_STATES + 1] = frame[_IMAGE + 1] = index
        if kind is not _READ:
            frame[_IMAGE + HEAD : end] = self.outputs
        answer = self._exchange(bytes(frame), deadline)
        if answer is None or len(answer) != len(frame):
            return None
        if answer[FIRST + 1] != index or answer[_IMAGE + 1] != index or answer[_IMAGE] != frame[_IMAGE]:
            return None
        dc_time, clocks, states, count, inputs, counter = unpack(answer)
        is_whole = (clocks, count, counter) == expected
        return _tuple(Cycle, (is_whole, counter, expected[2], dc_time, inputs, states))

    def mail(self, drive: int) -> Emergency | None:
        """Return the emergency that waits in the mailbox of a drive; None without one."""
        waiting = self._drives[drive].emergencies
        if not waiting:
            self._read_mail(drive)
        return waiting.popleft() if waiting else None

    # --- objects --------------------------------------------------------------------------------------------------

    def read(self, drive: int, index: int, subindex: int) -> bytes:
        """Return the value of an object; raise SdoError."""
        place = drive, index, subindex
        answer = self._transfer(place, _SDO.pack(0x40, index, subindex) + bytes(4))
        command = answer[0]
        if command >> 5 != 2:
            raise sdo_error(place, None, f"got answer {command:#04x}, expected an upload")
        if command & 2:
            return answer[4 : 8 - (command >> 2 & 3 if command & 1 else 0)]
        size, content, toggle = int.from_bytes(answer[4:8], "little"), answer[8:], 0
        while len(content) < min(size, _LARGEST_OBJECT):
            answer = self._transfer(place, bytes((0x60 | toggle,)) + bytes(7), is_segment=True)
            if answer[0] & 0xE0 or answer[0] & _TOGGLE != toggle:
                raise sdo_error(place, None, f"got answer {answer[0]:#04x}, expected the next segment")
            part = answer[1 : 8 - (answer[0] >> 1 & 7)] if len(answer) <= 8 else answer[1:]
            content += part
            toggle ^= _TOGGLE
            if answer[0] & 1 or not part:
                break
        if len(content) != size:
            raise sdo_error(place, None, f"got {len(content)} bytes, expected the {size} that it announced")
        return content

    def write(self, drive: int, index: int, subindex: int, data: bytes) -> None:
        """Write an object; raise SdoError."""
        place = drive, index, subindex
        if 1 <= len(data) <= 4:
            request = _SDO.pack(0x23 | (4 - len(data)) << 2, index, subindex) + data.ljust(4, b"\0")
            rest, room = b"", 0
        else:
            room = self._drives[drive].managers[0].length - _MAIL_HEAD.size - 8
            request = _SDO.pack(0x21, index, subindex) + struct.pack("<I", len(data)) + data[:room]
            rest = data[room:]
        answer, toggle = self._transfer(place, request), 0
        if answer[0] >> 5 != 3:
            raise sdo_error(place, None, f"got answer {answer[0]:#04x}, expected a download")
        while rest:
            part, rest = rest[: room + 7], rest[room + 7 :]
            head = toggle | max(0, 7 - len(part)) << 1 | (not rest)
            answer = self._transfer(place, bytes((head,)) + part.ljust(7, b"\0"), is_segment=True)
            if answer[0] != 0x20 | toggle:
                raise sdo_error(place, None, f"got answer {answer[0]:#04x}, expected the segment to be confirmed")
            toggle ^= _TOGGLE

    def _transfer(self, place: tuple[int, int, int], request: bytes, *, is_segment: bool = False) -> bytes:
        """Send one SDO request and return its answer; raise SdoError for an abort, or where none comes."""
        drive, index, subindex = place
        self._post(drive, request)
        end = self._clock.now() + _MAIL_NS
        while self._clock.now() < end:
            body = self._read_mail(drive)
            if body is None:
                self._clock.wait_until(self._clock.now() + _POLL_NS)
                continue
            if body[0] == 0x80:
                code = _ABORT.unpack_from(body)[3]
                raise sdo_error(place, code)
            if is_segment or _SDO.unpack_from(body)[1:] == (index, subindex):
                return body
        raise sdo_error(place, SdoAbort.TIMEOUT, f"no answer within {_MAIL_NS / 1e9:g} s")

    def _post(self, drive: int, request: bytes) -> None:
        """Put a request into the mailbox of a drive; raise LinkError where the mailbox stays full."""
        known = self._drives[drive]
        known.counter = known.counter % 7 + 1
        region = known.managers[0]
        mail = _MAIL_HEAD.pack(len(request) + 2, 0, 0, _COE | known.counter << 4, _REQUEST << 12) + request
        end = self._clock.now() + _MAIL_NS
        while not self._one(Command.WRITE, known.station, region.start, mail.ljust(region.length, b"\0")).counter:
            self._read_mail(drive)  # it may wait for room for an answer
            self._wait(end, f"drive {drive}: its mailbox is full")

    def _read_mail(self, drive: int) -> bytes | None:
        """Read the mail that waits: keep emergencies; return the content of an SDO answer, None where none waits."""
        known = self._drives[drive]
        region = known.managers[1]
        datagram = Datagram(Command.READ, known.station, region.start, bytes(region.length))
        self._index = (self._index + 1) & 0xFF
        answer = self._exchange(frame_of(self._index, (datagram,)), self._clock.now() + _ANSWER_NS)
        found = None if answer is None else answers_of(answer, self._index, (datagram,))
        if found is None:  # it may have been read, and lost on the way
            known.repeat ^= _REPEAT
            self.register(drive, _SYNC_MANAGERS + 8 + 6, bytes((1 | known.repeat,)))
            return None
        return self._sort(known, found[0].data) if found[0].counter else None

    def _sort(self, known: _Drive, mail: bytes) -> bytes | None:
        length, _, _, kind, service = _MAIL_HEAD.unpack_from(mail)
        body = mail[_MAIL_HEAD.size : 6 + length]
        if kind & 0x0F != _COE or len(body) < 8:
            return None
        if service >> 12 == _EMERGENCY:
            code, register = struct.unpack_from("<HB", body)
            known.emergencies.append(Emergency(code, register, bytes(body[3:8])))
            return None
        return body if service >> 12 in (_REQUEST, _RESPONSE) else None


_STATES: Final = FIRST + HEAD + 8 + TAIL  # places of the datagrams in a frame of the cycle
_IMAGE: Final = _STATES + HEAD + 2 + TAIL
