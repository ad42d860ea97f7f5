"""The start of a drive on an EtherCAT line, each step read back.

    scan, identity -> PRE-OP -> objects of the profile -> one RxPDO, one TxPDO -> watchdog
    all drives: images, clocks, SYNC0 -> phase lock -> SAFE-OP -> zero outputs -> OP

The steps of all drives together are taken by the first that is commanded to OP.
"""

import struct
from functools import partial
from typing import Final

from canhaptic.canopen.objects import is_writable
from canhaptic.drive.ethercat.image_map import write_image
from canhaptic.drive.ethercat.parameters import ASSIGN_ACTIVATE
from canhaptic.drive.ethercat.phase_lock import LOCK_RULE
from canhaptic.drive.ethercat.segment import AlError, AlState
from canhaptic.drive.ethercat.servo_drive import SYNC_ACTIVATION, SYSTEM_TIME, WATCHDOG, EthercatDrive
from canhaptic.drive.profile.bring_up import BringUp, Confirmation
from canhaptic.errors import SdoError
from canhaptic.host.stop_signal import require_none

_WATCHDOG_DIVIDER: Final = 0x0400
_SYNC_START: Final = 0x0990
_SYNC_CYCLE: Final = 0x09A0
_SYNC_TYPE, _LEAST_CYCLE, _SYNC_LIMIT = (0x1C32, 1), (0x1C32, 5), (0x10F1, 2)
_WITH_SYNC0: Final = (2, 3)  # values of 0x1C32:01
_AHEAD_NS: Final = 100_000_000  # from now to the first SYNC0: it must not have passed before all drives know it
_LOCK_SECONDS: Final = 5
_VALID_OUTPUTS: Final = 5  # cycles with zero outputs before OP is asked for
_TRIES: Final = 20
_BEFORE_SAFE_OP: Final = ("IP", "PS")  # transitions of the writes that a vendor wants at the start
_LARGEST_STARTUP: Final = 8  # [bytes] of an integer


class EthercatBringUp(BringUp):
    """Configures one drive, step by step."""

    _drive: EthercatDrive

    def identify(self) -> None:
        """Find out which drive this is; raise StartError.

        The scan takes every drive of the line to INIT, without which none of them can be asked.
        """
        drive, line = self._drive, self._drive.line
        with self.step("presence"):
            if not line.identities:
                line.identities = list(line.segment.scan())
        found, place = line.identities, drive.axis.position
        if place >= len(found):
            raise self.refusal("presence", f"{len(found)} drives on the line", f"one at position {place}")
        for name, seen, wanted in zip(("vendor", "product"), found[place], self._expected(), strict=False):
            if wanted is not None and seen != wanted:
                raise self.refusal("identity", f"{name} {seen:#x} in its EEPROM", f"{wanted:#x}")
        self.request(AlState.PRE_OP)
        super().identify()

    def _expected(self) -> tuple[int | None, int | None]:
        """Return vendor and product: of the scene, else of the ESI."""
        axis = self._drive.axis
        vendor, product = getattr(self._drive.dictionary, "identity", (None, None, None))[:2]
        return axis.vendor_id or vendor, axis.product_code or product

    def request(self, state: AlState) -> None:
        """Ask the drive for a state of the application layer; raise StartError."""
        with self.step("EtherCAT state"):
            try:
                self._drive.line.segment.request(self._drive.axis.position, state)
            except AlError as error:
                remedy, seen = error.remedy, str(error).split("got ", 1)[-1].split(", expected", 1)[0]
                raise self.refusal("EtherCAT state", seen, state.name, remedy) from error
        self._drive.read_al_status()

    # --- one drive --------------------------------------------------------------------------------------------------

    def _command_pre_operational(self) -> None:
        self.request(AlState.PRE_OP)

    def _monitor(self) -> None:
        """Do nothing: every frame carries the states of all drives."""

    def _await_pre_operational(self) -> None:
        """Confirm PRE-OP: another drive's start may have taken long."""
        self._drive.read_al_status()
        self.expect("EtherCAT state", "AL status", self._drive.al_status, AlState.PRE_OP)

    def _arm(self) -> None:
        """Leave the watchdog to `_map`, which also switches it off."""

    def _map(self) -> None:
        drive = self._drive
        self._confirm_hold()
        expect = partial(self.expect, "process data map")
        with self.step("process data map"):
            for item in getattr(drive.dictionary, "startup", ()):
                if item.transition in _BEFORE_SAFE_OP and 0 < len(item.data) <= _LARGEST_STARTUP:
                    drive.sdo.write(item.place[0], item.place[1], int.from_bytes(item.data, "little"), len(item.data))
            for pdo in (drive.map.outputs, drive.map.inputs):
                write_image(drive.sdo, pdo, expect)
        if is_writable(drive.dictionary, *_SYNC_LIMIT):  # the link policy and the watchdog end the run before
            self._write_confirmed("watchdog", *_SYNC_LIMIT, 4 * max(drive.bus.stop_cycles, self._watchdog_cycles()))
        self._set_watchdog()
        self._check_period()

    def _watchdog_cycles(self) -> int:
        return -(-self._drive.bus.master_silence_ns // self._drive.sample_time_ns)

    def _set_watchdog(self) -> None:
        """Set the watchdog of the sync manager in units of 100 us; 0 switches it off."""
        drive = self._drive
        units = round(drive.bus.watchdog * 1e4) if drive.axis.watchdog else 0
        for register, value in ((_WATCHDOG_DIVIDER, 2498), (WATCHDOG, units)):
            self.set_register("watchdog", register, value.to_bytes(2, "little"))

    def set_register(self, name: str, register: int, data: bytes) -> None:
        """Write registers, and read them back."""
        drive = self._drive
        with self.step(name):
            drive.line.segment.register(drive.axis.position, register, data)
            seen = drive.line.segment.register(drive.axis.position, register, size=len(data))
        number = int.from_bytes(seen, "little")
        self.expect(name, f"register {register:#06x}", number, int.from_bytes(data, "little"))

    def read_object(self, name: str, place: tuple[int, int]) -> int | None:
        """Return the value of an object that the dictionary lists; None where it or the drive has none."""
        drive = self._drive
        if drive.dictionary.get_variable(*place) is None:
            return None
        with self.step(name):
            try:
                return drive.sdo.read(*place)
            except SdoError as error:
                if error.code is None:
                    raise
                return None

    def _check_period(self) -> None:
        least, period = self.read_object("cycle time", _LEAST_CYCLE), self._drive.sample_time_ns
        if least and period < least:
            remedy = f"lower bus.rate to {1e9 / least:.6g} Hz"
            raise self.refusal("cycle time", f"bus.rate {1e9 / period:g} Hz ({period} ns)",
                               f"at least {least} ns (0x1C32:05)", remedy)  # fmt: skip

    # --- all drives together ----------------------------------------------------------------------------------------

    def command_operational(self) -> None:
        """Take all drives of the line to OP, the first time; raise StartError."""
        line = self._drive.line
        if line.is_running:
            return
        others = [EthercatBringUp(drive) for drive in line.drives]
        self._map_images()
        self._start_sync0(others)
        self._lock_phase()
        for one in others:
            one.enter_safe_op()
            line.idle()
        line.idle(_VALID_OUTPUTS)
        for one in others:
            one.request(AlState.OP)
            line.idle()
        for _ in range(_TRIES):  # counting begins with a frame that came back: before it, the host knows no hold
            line.held.begin()
            line.idle()
            if line.held.hold is not None:
                break
        if line.segment.repeats_outputs and line.bus.frames == 2:
            return  # the drive takes what is repeated for new outputs, so that its count shows no late frame
        with self.step("SYNC0"):
            for drive in line.drives if line.held.hold is not None else ():
                drive.begin_counts()

    def _map_images(self) -> None:
        line = self._drive.line
        sizes = [(0, 0)] * len(line.identities)
        for drive in line.drives:
            sizes[drive.axis.position] = drive.sizes
        with self.step("process data map"):
            slices = line.segment.map(sizes)
            line.segment.align_clocks()
        for drive in line.drives:
            drive.place(slices[drive.axis.position])
        line.is_running = True

    def _start_sync0(self, drives: "list[EthercatBringUp]") -> None:
        line, period = self._drive.line, self._drive.sample_time_ns
        with self.step("SYNC0"):
            now = int.from_bytes(line.segment.register(self._drive.axis.position, SYSTEM_TIME, size=8), "little")
        first = ((now + _AHEAD_NS) // period + 1) * period
        for one in drives:
            one.set_register("SYNC0", _SYNC_CYCLE, struct.pack("<I", period))
            one.set_register("SYNC0", _SYNC_START, struct.pack("<Q", first))
            one.set_register("SYNC0", SYNC_ACTIVATION, one.activation().to_bytes(2, "little"))
        line.lock.begin(first)

    def activation(self) -> int:
        """Return AssignActivate: of the scene, else of the ESI."""
        stated = self._drive.bus.assign_activate
        of_file: int | None = getattr(self._drive.dictionary, "assign_activate", None)
        return next((value for value in (stated, of_file) if value is not None), ASSIGN_ACTIVATE)

    def _lock_phase(self) -> None:
        """Run cycles until the deadlines are locked on SYNC0, see `PhaseLock`, and the clock of every drive follows."""
        line = self._drive.line
        end, apart = line.clock.now() + _LOCK_SECONDS * 1_000_000_000, ""
        while not line.lock.is_locked or (apart := self._apart()):
            require_none()
            if line.clock.now() >= end:
                share = 100.0 * line.lock.error / self._drive.sample_time_ns
                seen = (
                    apart
                    or f"{line.lock.missing} frames short of it after {_LOCK_SECONDS} s, the last {share:.3g} % off"
                )
                raise self.refusal("phase lock", seen, LOCK_RULE)
            line.idle()

    def _apart(self) -> str:
        """Return which clock does not follow the reference clock yet, in words; "" where every one does."""
        with self.step("phase lock"):
            found = {drive.axis.name: drive.clock_objection() for drive in self._drive.line.drives}
        return "; ".join(f"{name}: {text}" for name, text in found.items() if text)

    def enter_safe_op(self) -> None:
        """Take the drive to SAFE-OP, and check that it runs on SYNC0; raise StartError."""
        self.request(AlState.SAFE_OP)
        kind = self.read_object("SYNC0", _SYNC_TYPE)
        if kind is not None and kind not in _WITH_SYNC0:
            raise self.refusal("SYNC0", f"0x1C32:01 = {kind}: the drive does not run on SYNC0", "2 or 3")

    def operational(self) -> Confirmation:
        """Confirmation that the drive is in OP."""
        drive = self._drive
        return Confirmation("EtherCAT state", "OP", lambda: drive.is_operational, lambda: drive.state_text,
                            drive.read_al_status)  # fmt: skip

    def process_data(self) -> Confirmation:
        """Confirmation that the inputs come with each frame."""
        drive = self._drive
        seen = lambda: drive.culprit or "no frame"  # noqa: E731
        return Confirmation("PDO exchange", "inputs in every frame", lambda: drive.is_complete, seen, lambda: None)
