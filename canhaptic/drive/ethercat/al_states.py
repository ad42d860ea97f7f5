"""States of the application layer of a drive, asked for by its registers: the same on every kind of line."""

import struct
from typing import Final, Protocol

from canhaptic.drive.clock import Clock
from canhaptic.drive.ethercat.segment import AlError, AlState

AL_CONTROL: Final = 0x0120
AL_STATUS: Final = 0x0130
ERROR: Final = 0x10  # bit of AL status; in AL control it acknowledges


class Registers(Protocol):
    """Registers of the drives of a line."""

    def __call__(self, drive: int, address: int, data: bytes | None = None, size: int = 0) -> bytes:
        """See `canhaptic.drive.ethercat.segment.Segment.register`."""
        ...


def request_state(register: Registers, clock: Clock, drive: int, state: AlState, timeout_ns: int, poll_ns: int) -> None:
    """Acknowledge an error, ask for a state, and return once the drive is there.

    Args:
        register: Registers of the line.
        clock: Clock of the line.
        drive: Position of the drive.
        state: State to reach.
        timeout_ns: Time for it [ns].
        poll_ns: Time between two looks [ns].

    Raises:
        AlError: The drive refuses the state, or is not there in time.
    """
    status, _ = al_status(register, drive)
    if status & ERROR:
        register(drive, AL_CONTROL, struct.pack("<H", status))  # acknowledges: the error bit is the same
    register(drive, AL_CONTROL, struct.pack("<H", state))
    await_state(register, clock, drive, state, timeout_ns, poll_ns)


def await_state(register: Registers, clock: Clock, drive: int, state: AlState, timeout_ns: int, poll_ns: int) -> None:
    """Return once a drive is in a state that it was asked for; arguments and errors as in `request_state`."""
    end = clock.now() + timeout_ns
    while True:
        status, code = al_status(register, drive)
        if status == state:
            return
        if status & ERROR or clock.now() >= end:
            raise AlError(drive, state, status, code)
        clock.wait_until(min(end, clock.now() + poll_ns))


def al_status(register: Registers, drive: int) -> tuple[int, int]:
    """Return the AL status of a drive, of which bits 0 to 4 are used, and its AL status code."""
    status, _, code = struct.unpack("<HHH", register(drive, AL_STATUS, size=6))
    return status & 0x1F, code
