"""An EtherCAT line on a wire, by the foreign master `pysoem` (SOEM): see `drive.ethercat.segment.Segment`.

It sends LRW only. A frame that reads therefore repeats the outputs that were sent last, which a drive takes for new
ones: 0x1C32:0B cannot show a late frame where a cycle has two, and the torque read back tells it instead.

States, registers and watchdogs go through two private methods of its drives, so the version is pinned.
"""

import struct
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any, Final

from canhaptic.canopen.objects import SdoAbort
from canhaptic.drive.clock import Clock
from canhaptic.drive.ethercat.segment import (
    AlState,
    Cycle,
    Emergency,
    FrameKind,
    Identity,
    ImageSlice,
    request_state,
    sdo_error,
)
from canhaptic.errors import InputError, LinkError, SdoError
from canhaptic.extras import install_hint
from canhaptic.host import capabilities

VERSION: Final = "1.1.13"
"""Version of pysoem whose private methods are known."""
_EEPROM_OWNER: Final = 0x0500
_FMMUS: Final = 0x0600
_MANAGERS: Final = 0x0810  # of the process data: 2 and 3
_SYNC_ACTIVATION: Final = 0x0980
_TRIGGERS_WATCHDOG: Final = 0x40  # in the control byte of a sync manager
_SERIAL_WORD: Final = 0x0E
_TO_THE_DRIVE: Final = b"\x01"  # who may read the EEPROM; some drives read it on their way to PRE-OP
_REGISTER_US: Final = 20_000  # within which SOEM sends a datagram again each 2 ms
_TRIES: Final = 3  # of a request whose frames are lost
_POLL_NS: Final = 1_000_000  # between two looks at a state
_LARGEST_OBJECT: Final = 4096  # [bytes]
_OP: Final = int(AlState.OP)
_READ: Final = FrameKind.READ
_tuple: Final = tuple.__new__  # makes a record at half the cost of calling its class


def load_pysoem() -> Any:
    """Return the module `pysoem`.

    Raises:
        InputError: It is not installed, or in another version.
    """
    try:
        import pysoem
    except ImportError as error:
        text = "an EtherCAT line on an interface needs pysoem, which is not installed"
        raise InputError(f"{text}; {install_hint('ethercat')}") from error
    if pysoem.__version__ != VERSION:
        text = f"pysoem: got version {pysoem.__version__}, expected {VERSION}, whose private methods are used"
        raise InputError(f"{text}; {install_hint('ethercat')}")
    return pysoem


class PysoemSegment:
    """A line on an interface; `close` gives it back.

    Args:
        interface: Name of the network interface, such as eth1.
        clock: Clock of every wait: a wall clock.

    Attributes:
        outputs: Image of all outputs, sent with the next frame that writes; made by `map`, and empty before.

    Raises:
        InputError: pysoem is not installed.
        LinkError: The interface cannot be opened: there is none, it is down, or the capabilities are missing.
    """

    repeats_outputs = True

    def __init__(self, interface: str, clock: Clock) -> None:
        self._soem, self._clock, self._interface = load_pysoem(), clock, interface
        self._master: Any = self._soem.Master()
        with capabilities.raised():
            try:
                self._master.open(interface)
            except ConnectionError as error:
                raise LinkError(capabilities.opening_objection(interface)) from error
        self._master.manual_state_change = 1  # else SAFE-OP is asked for before SYNC0 runs
        self.outputs = bytearray()
        self._slices: list[ImageSlice] = []
        self._mails: list[deque[Emergency]] = []
        self._expected = self._states = 0

    def close(self) -> None:
        """Close the interface."""
        self._master.close()

    # --- who is there ---------------------------------------------------------------------------------------------

    def scan(self) -> Sequence[Identity]:
        """Take all drives to INIT, switch SYNC0 off (0x0981 = 0), set addresses and mailboxes; return who they are."""
        master = self._master
        self.outputs, self._slices, self._mails, self._expected = bytearray(), [], [], 0
        count = master.config_init()
        if count <= 0:
            return []
        if len(master.slaves) != count:
            raise LinkError(
                f"{self._interface}: got {len(master.slaves)} drives, but {count} answered; check cable and power"
            )
        found = []
        for place, drive in enumerate(master.slaves):
            drive._disable_complete_access()  # noqa: SLF001  # some drives claim it, and fail at it
            mails = deque[Emergency]()
            self._mails.append(mails)
            drive.add_emergency_callback(lambda of, mails=mails: mails.append(_emergency(of)))
            self.request(place, AlState.INIT)
            self._write(place, _SYNC_ACTIVATION, bytes(2), is_needed=False)  # not every drive has a clock
            serial = int.from_bytes(drive.eeprom_read(_SERIAL_WORD)[:4], "little")
            self._write(place, _EEPROM_OWNER, _TO_THE_DRIVE)
            found.append(Identity(drive.man, drive.id, drive.rev, serial))
        return found

    # --- registers and states -------------------------------------------------------------------------------------

    def register(self, drive: int, address: int, data: bytes | None = None, size: int = 0) -> bytes:
        """Write `data` to registers of a drive, or with None read `size` bytes; return what was read or written."""
        if data is not None:
            self._write(drive, address, data)
            return data
        try:
            content: bytes = self._master.slaves[drive]._fprd(address, size, _REGISTER_US)  # noqa: SLF001
        except self._soem.WkcError as error:
            raise self._lost(drive, address) from error
        return content

    def _write(self, drive: int, address: int, data: bytes, *, is_needed: bool = True) -> None:
        try:
            self._master.slaves[drive]._fpwr(address, data, _REGISTER_US)  # noqa: SLF001
        except self._soem.WkcError as error:
            if is_needed:
                raise self._lost(drive, address) from error

    def _lost(self, drive: int, address: int) -> LinkError:
        return LinkError(
            f"{self._interface}: register {address:#06x} of drive {drive}: got no answer within "
            f"{_REGISTER_US / 1000:g} ms, expected one; a drive was lost, or refuses the access: check cable and power"
        )

    def request(self, drive: int, state: AlState, timeout_ns: int = 1_000_000_000) -> None:
        """Ask a drive for a state and return once it is there; raise AlError where it refuses or stays away."""
        request_state(self, self._clock, drive, state, timeout_ns, _POLL_NS)

    # --- process image and clocks ---------------------------------------------------------------------------------

    def map(self, sizes: Sequence[tuple[int, int]]) -> Sequence[ImageSlice]:
        """Set sync managers 2 and 3 and the FMMUs for the bytes of outputs and inputs of each drive.

        SOEM reads the lengths from each drive (0x1C12, 0x1C13); they must be those of `sizes`. The image of outputs is
        zero afterwards.
        """
        slaves = self._master.slaves
        try:
            self._master.config_map()
        except self._soem.ConfigMapError as error:
            seen = "; ".join(str(of) or type(of).__name__ for of in error.error_list)
            raise LinkError(f"{self._interface}: maps cannot be read ({seen}); read 0x1C12 and 0x1C13 again") from error
        slices, output, into = list[ImageSlice](), 0, 0
        for place, (drive, wanted) in enumerate(zip(slaves, sizes, strict=True)):
            if wanted == (0, 0):  # no axis of the scene: it takes no part
                self._write(place, _FMMUS, bytes(64), is_needed=False)
                self._write(place, _MANAGERS, bytes(16), is_needed=False)
            elif (found := (len(drive.output), len(drive.input))) != tuple(wanted):
                raise LinkError(
                    f"drive {place}: got {found[0]} bytes of outputs and {found[1]} of inputs from 0x1C12 and 0x1C13, "
                    f"expected {wanted[0]} and {wanted[1]}; it did not take the map that was written"
                )
            else:
                self._watch_outputs(place)
            slices.append(ImageSlice(output, wanted[0], into, wanted[1]))
            output, into = output + wanted[0], into + wanted[1]
        self.outputs, self._slices = bytearray(output), slices
        self._expected = sum(2 * (of.output_size > 0) + (of.input_size > 0) for of in slices)
        self._put_outputs()
        return slices

    def _watch_outputs(self, place: int) -> None:
        """Let the outputs restart the watchdog: some EEPROMs leave it out."""
        control = self.register(place, _MANAGERS + 4, size=1)[0]
        if not control & _TRIGGERS_WATCHDOG:
            settings = bytearray(self.register(place, _MANAGERS, size=8))
            settings[4] |= _TRIGGERS_WATCHDOG
            self._write(place, _MANAGERS + 6, b"\0")  # it is changed while it is off
            self._write(place, _MANAGERS, bytes(settings[:5]))
            self._write(place, _MANAGERS + 6, bytes(settings[6:7]))

    def align_clocks(self) -> None:
        """Measure the propagation delays and set the offsets: the first drive with a clock leads the others."""
        if not self._master.config_dc():
            raise LinkError(f"{self._interface}: got no drive with a distributed clock, expected one to lead the cycle")

    # --- cycle ----------------------------------------------------------------------------------------------------

    def exchange(self, kind: FrameKind, deadline: int) -> Cycle | None:
        """Send one frame of the cycle; return its answer, or None where none came until `deadline` [ns].

        A frame that reads sends the outputs of the last one that wrote. The states are read with it, in a frame of
        their own. An answer to an older frame is dropped: SOEM numbers them.
        """
        master, clock = self._master, self._clock
        if kind is not _READ:
            self._put_outputs()
        master.send_processdata()
        counter = master.receive_processdata(max(1, (deadline - clock.now()) // 1000))
        if counter < 0:
            return None
        is_whole, inputs = counter == self._expected, b""
        if kind is not FrameKind.WRITE:
            parts = [drive.input for drive, of in zip(master.slaves, self._slices, strict=True) if of.input_size]
            inputs = parts[0] if len(parts) == 1 else b"".join(parts)
            self._states = self._read_states()
        return _tuple(Cycle, (is_whole, counter, self._expected, master.dc_time, inputs, self._states))

    def _put_outputs(self) -> None:
        outputs = self.outputs
        for drive, (at, size, _, _) in zip(self._master.slaves, self._slices, strict=True):
            if size:
                drive.output = bytes(outputs[at : at + size])

    def _read_states(self) -> int:
        """Return the AL status of all drives of the scene, OR-ed."""
        master, states = self._master, 0
        if master.read_state() == _OP:  # the lowest of all
            states = _OP
        for drive, of in zip(master.slaves, self._slices, strict=True):
            if of.input_size:
                states |= drive.state
        return states

    def mail(self, drive: int) -> Emergency | None:
        """Return the emergency that waits in the mailbox of a drive; None without one."""
        waiting = self._mails[drive]
        if not waiting:
            with suppress(self._soem.SdoError, self._soem.MailboxError, self._soem.PacketError):
                self._master.slaves[drive].mbx_receive()
        return waiting.popleft() if waiting else None

    # --- objects --------------------------------------------------------------------------------------------------

    def read(self, drive: int, index: int, subindex: int) -> bytes:
        """Return the value of an object; raise SdoError."""
        ask = self._master.slaves[drive].sdo_read
        content: bytes = self._transfer((drive, index, subindex), lambda: ask(index, subindex, _LARGEST_OBJECT))
        return content

    def write(self, drive: int, index: int, subindex: int, data: bytes) -> None:
        """Write an object; raise SdoError."""
        ask = self._master.slaves[drive].sdo_write
        self._transfer((drive, index, subindex), lambda: ask(index, subindex, data))

    def _transfer(self, place: tuple[int, int, int], ask: Callable[[], Any]) -> Any:
        """Return what `ask` returns; ask again where a frame was lost on the way. Raise SdoError."""
        soem, tries = self._soem, _TRIES
        while True:
            tries -= 1
            try:
                return ask()
            except (soem.WkcError, soem.PacketError) as error:
                if not tries:
                    raise self._sdo_error(place, error) from error
            except (soem.SdoError, soem.MailboxError) as error:
                raise self._sdo_error(place, error) from error

    def _sdo_error(self, place: tuple[int, int, int], error: Any) -> SdoError:
        if isinstance(error, self._soem.SdoError):
            return sdo_error(place, error.abort_code & 0xFFFFFFFF)
        if isinstance(error, self._soem.WkcError):
            return sdo_error(place, SdoAbort.TIMEOUT, f"no answer to {_TRIES} requests")
        return sdo_error(place, None, f"{error.desc} (error {error.error_code:#x} of the mailbox)")


def _emergency(of: Any) -> Emergency:
    vendor = bytes((of.b1 & 0xFF,)) + struct.pack("<HH", of.w1 & 0xFFFF, of.w2 & 0xFFFF)
    return Emergency(of.error_code, of.error_reg, vendor)
