"""What a rig asks of one EtherCAT line: scan, single objects, states, and the frames of the cycle.

A drive is named by its position on the line, from 0. What serves the protocol is a master (thin, of this package, or a
foreign one); the order of the start, the phase lock and the judgement of lost frames lie above it.
"""

import struct
import tomllib
from collections.abc import Sequence
from enum import IntEnum
from pathlib import Path
from typing import Final, NamedTuple, Protocol

from canhaptic.canopen.code_texts import sdo_abort_text
from canhaptic.drive.clock import Clock
from canhaptic.errors import RigError, SdoError

AL_CONTROL: Final = 0x0120
AL_STATUS: Final = 0x0130
ERROR: Final = 0x10
"""Bit of AL status: the drive refused, or left its state by itself; in AL control it acknowledges."""
_TEXTS: Final[dict[str, dict[int, str]]] = {
    kind: {int(code, 16): text for code, text in texts.items()}
    for kind, texts in tomllib.loads(Path(__file__).with_name("al_codes.toml").read_text(encoding="utf-8")).items()
}
_NO_REMEDY: Final = "see the drive's manual for this AL status code"
_SILENT: Final = "the drive waits for something that it does not name, usually SYNC0 or valid outputs"


class AlState(IntEnum):
    """State of the application layer of a drive (ETG.1000.6); AL status adds 0x10 for an error."""

    INIT = 1
    PRE_OP = 2
    BOOT = 3
    SAFE_OP = 4
    OP = 8


class FrameKind(IntEnum):
    """What a frame of the cycle does with the process image; the value is its EtherCAT command."""

    READ = 10  # LRD: the inputs come back
    WRITE = 11  # LWR: the outputs go out
    BOTH = 12  # LRW: outputs go out, and inputs latched before them come back


class Identity(NamedTuple):
    """A drive as its EEPROM tells it (SII words 8 to 15)."""

    vendor: int
    product: int
    revision: int
    serial: int


def sdo_error(place: tuple[int, int, int], code: int | None, what: str = "") -> SdoError:
    """Return the error of a transfer that failed.

    Args:
        place: Drive, index and subindex of the object.
        code: Abort code of CoE; None: none.
        what: What happened; by default the words of the code.
    """
    drive, index, subindex = place
    what = what or f"{sdo_abort_text(code or 0)} (abort {code:#010x})"
    return SdoError(f"drive {drive}: object {index:#06x}:{subindex:02x}: {what}", index, subindex, code)


class ImageSlice(NamedTuple):
    """Place of one drive in the images: outputs[output:output + output_size], inputs likewise [bytes]."""

    output: int
    output_size: int
    input: int
    input_size: int


class Emergency(NamedTuple):
    """An emergency from the mailbox (ETG.1000.6, 5.6.4)."""

    code: int
    register: int
    vendor: bytes


class Cycle(NamedTuple):
    """Answer to one frame of the cycle.

    Attributes:
        is_whole: Whether every working counter of the frame is the expected one.
        counter, expected: Working counter of the datagram of the process image, and of a line of which nothing is lost.
        dc_time: System time of the reference clock when the frame passed it [ns].
        inputs: Image of all inputs; not to be used unless `is_whole`. Empty after WRITE.
        states: AL status registers (0x0130, low byte) of all drives, OR-ed: `AlState.OP` where all are in OP.
    """

    is_whole: bool
    counter: int
    expected: int
    dc_time: int
    inputs: bytes
    states: int


class AlError(RigError):
    """A drive refused a state of the application layer, or left it by itself.

    Attributes:
        drive: Position of the drive.
        status: AL status (0x0130).
        code: AL status code (0x0134).
    """

    def __init__(self, drive: int, wanted: AlState, status: int, code: int) -> None:
        self.drive, self.status, self.code = drive, status, code
        self.remedy = al_remedy(code) if status & ERROR else _SILENT
        seen = f"AL status {status:#04x} ({state_name(status)})"
        reason = f", code {code:#06x}: {al_text(code)}" if status & ERROR else ""
        super().__init__(f"drive {drive}: got {seen}{reason}, expected {wanted.name}; {self.remedy}")


def state_name(status: int) -> str:
    """Return the name of the state in an AL status; of several OR-ed ones, their bits."""
    state = status & 0x0F
    return AlState(state).name if state in AlState.__members__.values() else f"{state:#x}"


def al_text(code: int) -> str:
    """Return the text of an AL status code."""
    return _TEXTS["text"].get(code, "code of the vendor" if code >= 0x8000 else "unknown code")


def al_remedy(code: int) -> str:
    """Return what to do about an AL status code."""
    return _TEXTS["remedy"].get(code, _NO_REMEDY)


class Segment(Protocol):
    """One EtherCAT line. Every method but `exchange` raises LinkError where no frame comes back or a counter is low.

    Attributes:
        outputs: Image of all outputs, sent with the next frame that writes; made by `map`, and empty before.
        repeats_outputs: Whether a frame that reads sends the outputs of the last one that wrote, once more.
    """

    outputs: bytearray
    repeats_outputs: bool

    def scan(self) -> Sequence[Identity]:
        """Take all drives to INIT, switch SYNC0 off (0x0981 = 0), set addresses and mailboxes; return who they are."""

    def read(self, drive: int, index: int, subindex: int) -> bytes:
        """Return the value of an object; raise SdoError."""

    def write(self, drive: int, index: int, subindex: int, data: bytes) -> None:
        """Write an object; raise SdoError."""

    def register(self, drive: int, address: int, data: bytes | None = None, size: int = 0) -> bytes:
        """Write `data` to registers of a drive, or with None read `size` bytes; return what was read or written."""

    def request(self, drive: int, state: AlState, timeout_ns: int = 1_000_000_000) -> None:
        """Ask a drive for a state and return once it is there; raise AlError where it refuses or stays away."""

    def map(self, sizes: Sequence[tuple[int, int]]) -> Sequence[ImageSlice]:
        """Set sync managers 2 and 3 and the FMMUs for the bytes of outputs and inputs of each drive.

        The image of outputs is zero afterwards.
        """

    def align_clocks(self) -> None:
        """Measure the propagation delays and set the offsets: the first drive with a clock leads the others."""

    def exchange(self, kind: FrameKind, deadline: int) -> Cycle | None:
        """Send one frame of the cycle; return its answer, or None where none came until `deadline` [ns].

        An answer to an older frame is dropped: it is never taken for that of this one.
        """

    def mail(self, drive: int) -> Emergency | None:
        """Return the emergency that waits in the mailbox of a drive; None without one."""


def request_state(line: Segment, clock: Clock, drive: int, state: AlState, timeout_ns: int, poll_ns: int) -> None:
    """Acknowledge an error, ask for a state, and return once the drive is there.

    Args:
        line: Segment of the line.
        clock: Clock of the line.
        drive: Position of the drive.
        state: State to reach.
        timeout_ns: Time for it [ns].
        poll_ns: Time between two looks [ns].

    Raises:
        AlError: The drive refuses the state, or is not there in time.
    """
    status, _ = al_status(line, drive)
    if status & ERROR:
        line.register(drive, AL_CONTROL, struct.pack("<H", status))  # acknowledges: the error bit is the same
    line.register(drive, AL_CONTROL, struct.pack("<H", state))
    await_state(line, clock, drive, state, timeout_ns, poll_ns)


def await_state(line: Segment, clock: Clock, drive: int, state: AlState, timeout_ns: int, poll_ns: int) -> None:
    """Return once a drive is in a state that it was asked for; arguments and errors as in `request_state`."""
    end = clock.now() + timeout_ns
    while True:
        status, code = al_status(line, drive)
        if status == state:
            return
        if status & ERROR or clock.now() >= end:
            raise AlError(drive, state, status, code)
        clock.wait_until(min(end, clock.now() + poll_ns))


def al_status(line: Segment, drive: int) -> tuple[int, int]:
    """Return the AL status of a drive, of which bits 0 to 4 are used, and its AL status code."""
    status, _, code = struct.unpack("<HHH", line.register(drive, AL_STATUS, size=6))
    return status & 0x1F, code
