"""The fail-closed start of one drive by its objects: every step confirmed or refused.

The steps follow CiA 402. A derived class adds the fieldbus: its states, watchdog and process data.
"""

import tomllib
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Final, NamedTuple

from canhaptic.canopen import objects as od
from canhaptic.canopen.objects import Controlword, is_writable
from canhaptic.drive.profile.fitness import (
    MODES,
    agreed_rated_torque,
    decimal_period,
    largest_value,
    written_max_torque,
)
from canhaptic.drive.profile.scaling import axis_scaling, torque_limit_per_mille
from canhaptic.drive.profile.torque_axis import TorqueAxis
from canhaptic.drive.safety.power_states import FAULTED, TORQUE_FREE, PowerState, drive_state
from canhaptic.errors import DictionaryError, LinkError, SdoError, StartError
from canhaptic.host.stop_signal import require_none

_REMEDIES: Final = tomllib.loads(Path(__file__).parents[1].joinpath("remedies.toml").read_text(encoding="utf-8"))

_LEVEL: Final = 20_000_000  # [ns] that the controlword keeps a level of bit 7
_POWERED: Final = (PowerState.SWITCHED_ON, PowerState.OPERATION_ENABLED, PowerState.QUICK_STOP_ACTIVE)


class Confirmation(NamedTuple):
    """Confirmation that a drive must give while the cycle runs with zero torque."""

    step: str
    expected: str
    is_given: Callable[[], bool]
    seen: Callable[[], str]
    ask: Callable[[], None]  # once more, where the drive has not confirmed for a while


class BringUp(ABC):
    """Configures one drive, step by step.

    Args:
        drive: Drive to be configured.
    """

    def __init__(self, drive: TorqueAxis) -> None:
        self._drive, self._sdo = drive, drive.sdo

    def identify(self) -> None:
        """Read which drive this is, and write nothing to it.

        Raises:
            StartError: The drive does not answer, or is not the one of the configuration.
        """
        self._presence()
        self._identity()

    def call(self) -> None:
        """Take the drive from any state to pre-operational and request its state reports; `configure` follows.

        A drive that another run left enabled is disabled once its brake holds.

        Raises:
            StartError: A step was refused.
        """
        drive = self._drive
        if drive.identifies:
            self._set_brake()
        self._disable_if_powered()
        with self.step("bus"):
            self._command_pre_operational()
        if not drive.identifies:
            self._presence()
        self._monitor()

    def configure(self) -> None:
        """After `call`, bring the drive to: identified, limited, mapped, in mode 10, disabled.

        Raises:
            StartError: A step was refused or not confirmed.
        """
        self._await_pre_operational()
        if not self._drive.identifies:
            self._identity()
        self._drive_modes()
        self._drive_state()
        self._settings()
        self._zero_torque()
        self._rated_torque()
        self._note_settings()
        self._torque_limit()
        self._drive_objects()
        self._watchdog()
        self._interpolation_period()
        self._map()
        self._mode()

    # --- what a fieldbus supplies -----------------------------------------------------------------------------------

    @abstractmethod
    def _command_pre_operational(self) -> None:
        """Command the state for configuring a drive; raise LinkError."""

    def _wake(self) -> None:
        """Make a drive answer that is silent because of its communication state; raise LinkError."""
        return

    def _explain_absence(self) -> None:
        """Look for the cause why the drive does not answer; raise StartError if one is found."""
        return

    @abstractmethod
    def _monitor(self) -> None:
        """Request reports of the drive's communication state."""

    @abstractmethod
    def _await_pre_operational(self) -> None:
        """Confirm the state for configuring a drive."""

    @abstractmethod
    def _arm(self) -> None:
        """Arm the drive's watchdog of the master."""

    @abstractmethod
    def _map(self) -> None:
        """Write the mapping of the process data, read it back and compare."""

    @abstractmethod
    def command_operational(self) -> None:
        """Command the state for exchanging process data."""

    @abstractmethod
    def operational(self) -> Confirmation:
        """Confirmation that the drive is in the state for exchanging process data."""

    @abstractmethod
    def process_data(self) -> Confirmation:
        """Confirmation that the drive sends its process data."""

    def check_rest(self) -> None:
        """Check the drive's report before it is enabled; raise StartError where it must not be enabled."""
        if (objection := self._drive.rest_objection()) is not None:
            raise self.refusal("force at rest", *objection)

    # --- the tools ------------------------------------------------------------------------------------------------

    @contextmanager
    def step(self, name: str, expected: str = "the drive to accept it") -> Iterator[None]:
        """Context of one step of the start, in which an error becomes a StartError with the name of the step.

        It is not entered once a signal asks for the end: StartStoppedError.
        """
        require_none()
        try:
            yield
        except (SdoError, DictionaryError, LinkError) as error:
            if isinstance(error, SdoError):
                expected = expected if error.code is not None else ""  # the text says that no answer came
            elif isinstance(error, LinkError):
                expected = "a working bus"
            seen = str(error).removeprefix(f"{self._drive.axis.name}: ").removesuffix(f"; {_REMEDIES[name]}")
            raise self.refusal(name, seen, expected) from error

    def refusal(self, name: str, seen: str, expected: str, remedy: str = "") -> StartError:
        """Return the error of a step, by default with the remedy of that step."""
        return StartError(self._drive.axis.name, name, seen, expected, remedy or _REMEDIES[name])

    def overdue(self, name: str, seen: str, expected: str, patience: float | None = None) -> StartError:
        """Return the error of a step that took longer than `patience` [s], by default step_timeout."""
        limit = self._drive.axis.step_timeout if patience is None else patience
        key = "step_timeout" if limit == self._drive.axis.step_timeout else "enable_time of its quirks"
        return self.refusal(name, seen, f"{expected} within {limit:g} s ({key})")

    def expect(self, name: str, item: str, seen: int, expected: int) -> None:
        """Compare a value read back; raise StartError where it differs."""
        if seen != expected:
            raise self.refusal(name, f"{item} = {seen:#x}", f"{expected:#x} (as written)")

    def _write_confirmed(self, name: str, index: int, subindex: int, value: int) -> None:
        with self.step(name):
            self._sdo.write(index, subindex, value)
            seen = self._sdo.read(index, subindex)
            self.expect(name, f"{self._sdo.describe(index, subindex)} read back", seen, value)

    def _await(self, read: Callable[[], bool]) -> bool:
        """Poll until `read()` holds; return False when the drive takes too long."""
        deadline = self._drive.now() + round(self._drive.axis.step_timeout * 1e9)
        while not read():
            require_none()
            if self._drive.now() >= deadline:
                return False
            self._drive.pump(self._drive.now() + 2_000_000)  # [ns]
        return True

    # --- the steps --------------------------------------------------------------------------------------------------

    def _presence(self) -> None:
        """Read 0x1000, again and again where the drive may not have booted yet; compare its profile."""
        drive, is_woken = self._drive, False
        deadline = drive.now() + round(drive.axis.start_timeout * 1e9)
        while True:
            try:
                device_type = self._sdo.read(od.DEVICE_TYPE)
                break
            except SdoError as error:
                is_silent = error.code is None and not isinstance(error.__cause__, LinkError)
                if is_silent and (drive.now() < deadline or not is_woken):
                    with self.step("bus"):
                        self._wake()
                    is_woken = True
                    continue
                with self.step("presence"):
                    self._explain_absence()
                    raise
        if device_type & 0xFFFF != od.CIA402_PROFILE:
            seen = f"0x1000 = {device_type:#010x}"
            raise self.refusal("device type", seen, f"low word {od.CIA402_PROFILE:#06x}")

    def _disable_if_powered(self) -> None:
        """Disable a drive that another run left enabled: leaving OPERATIONAL with power on would be a fault to it.

        A torque that it holds stays until a brake of the axis holds. This step confirms nothing; later ones do.
        """
        brake, drive = self._drive.axis.brake, self._drive
        try:
            state = drive_state(self._sdo.probe(od.STATUSWORD))
            if state not in _POWERED:
                return
            if brake is not None and brake.by == "drive" and state is PowerState.OPERATION_ENABLED:
                self._sdo.write(od.CONTROLWORD, 0, Controlword.SWITCH_ON)  # it holds until its brake does
            if brake is not None:
                drive.pump(drive.now() + round(brake.set_time * 1e9))
            self._sdo.write(od.CONTROLWORD, 0, Controlword.DISABLE_VOLTAGE)
        except SdoError:
            return

    def _identity(self) -> None:
        axis = self._drive.axis
        for subindex, wanted in ((1, axis.vendor_id), (2, axis.product_code)):
            if wanted is not None:
                with self.step("identity"):
                    self.expect("identity", f"0x1018:{subindex:02x}", self._sdo.read(od.IDENTITY, subindex), wanted)

    def _drive_modes(self) -> None:
        if od.SUPPORTED_DRIVE_MODES not in self._drive.dictionary:
            return  # then 0x6061 alone must confirm the mode
        with self.step("drive modes"):
            modes = self._sdo.read(od.SUPPORTED_DRIVE_MODES)
        bit = self._drive.mode_code - 1
        if not modes >> bit & 1:
            name = "homing" if bit == od.HOMING - 1 else f"cyclic synchronous {MODES[bit + 1]}"
            raise self.refusal("drive modes", f"0x6502 = {modes:#x}", f"bit {bit} ({name}) set")

    def _drive_state(self) -> None:
        """Leave the drive without torque; a fault is reset only if the configuration says so."""
        with self.step("drive state"):
            if self._drive.read_state() in FAULTED:
                if not self._drive.axis.reset_fault:
                    raise self.refusal("drive state", self.fault_text(), "a drive without fault")
                self.reset_fault()
            if self._drive.read_state() in _POWERED:
                self._sdo.write(od.CONTROLWORD, 0, Controlword.DISABLE_VOLTAGE)
            if not self._await(lambda: self._drive.read_state() in TORQUE_FREE):
                raise self.overdue("drive state", self._drive.read_state().value, "a state without torque")

    def _settings(self) -> None:
        """Compare scale, sign and limits with those of commissioning, before anything but the state is written."""
        drive = self._drive
        if drive.axis.settings_checked is None:
            return
        from canhaptic.drive.profile.drive_objects import settings_of, settings_text
        from canhaptic.drive.profile.drive_settings import changed_settings

        wanted = settings_of(drive.axis.settings_checked) | settings_of(drive.axis.settings_accepted)
        with self.step("settings"):
            changed, now = changed_settings(drive, wanted)
        if changed:
            accepted = f", or accept what was meant: settings_accepted: {settings_text(now)}" if now else ""
            remedy = f"{_REMEDIES['settings']}{accepted}"
            raise self.refusal("settings", "; ".join(changed), "the settings of commissioning", remedy)

    def _note_settings(self) -> None:
        """Note a polarity, and limits below `torque_limit`, of a drive whose settings no commissioning has kept."""
        drive = self._drive
        limit = torque_limit_per_mille(drive.axis.torque_limit, drive.scaling.rated_torque)
        for index in (od.POLARITY, od.POSITIVE_TORQUE_LIMIT, od.NEGATIVE_TORQUE_LIMIT):
            listed = drive.dictionary.get_variable(index)
            if drive.axis.settings_checked or index in drive.left_out or listed is None or not listed.readable:
                continue
            with self.step("settings"):
                seen = self._read_if_there(index)
            usual = listed.default if isinstance(listed.default, int) else 0
            text = f"{self._sdo.describe(index)} = {seen}"
            if index == od.POLARITY and seen not in (None, usual):
                drive.remarks.append(
                    f"{text}, {usual} in the dictionary: it turns signs; {_REMEDIES['settings_unknown']}"
                )
            elif index != od.POLARITY and seen is not None and seen < limit:
                drive.remarks.append(f"{text}, below torque_limit ({limit}): the drive cuts what is sent")

    def reset_fault(self) -> None:
        """Reset a fault by the rising edge of bit 7 and leave the drive disabled; never enables it.

        Raises:
            StartError: The fault stays.
        """
        with self.step("drive state"):
            if self._drive.read_state() not in FAULTED:
                return
            gone = self._reset_edge() or self._reset_edge()  # some drives take the first for the end of a reaction
        if not gone:
            raise self.overdue("drive state", f"{self.fault_text()} after two fault resets", "the fault gone")
        self._drive.emergency = None

    def _reset_edge(self) -> bool:
        """Give one rising edge of bit 7; return whether the fault has gone. Both levels last: a slow loop sees them."""
        drive = self._drive
        self._sdo.write(od.CONTROLWORD, 0, Controlword.DISABLE_VOLTAGE)
        drive.pump(drive.now() + _LEVEL)
        self._await(lambda: drive.read_state() is PowerState.FAULT)
        self._sdo.write(od.CONTROLWORD, 0, Controlword.FAULT_RESET)
        drive.pump(drive.now() + _LEVEL)
        gone = self._await(lambda: drive.read_state() is not PowerState.FAULT)
        self._sdo.write(od.CONTROLWORD, 0, Controlword.DISABLE_VOLTAGE)
        return gone

    def fault_text(self) -> str:
        """Return the state with the drive's own error code, if there is one."""
        text = self._drive.read_state().value
        if od.ERROR_CODE in self._drive.dictionary:
            try:
                text += f" with error code 0x603F = {self._sdo.read(od.ERROR_CODE):#06x}"
            except SdoError:
                text += " (0x603F cannot be read)"
        return text + (f", {self._drive.emergency}" if self._drive.emergency else "")

    def _zero_torque(self) -> None:
        """Write a target at rest, the steepest ramps of the drive, zero offsets, and the quick stop."""
        mode = self._drive.axis.causality
        with self.step("zero torque"):
            rest = self._drive.rest_target()
        self._write_confirmed("zero torque", mode.target, 0, rest)
        self._write_unless_asked("ramps", mode.ramps)
        self._zero_offsets()
        self._write_unless_asked("quick stop", mode.quick_stop)

    def _write_unless_asked(self, step: str, values: Mapping[int, int | None]) -> None:
        """Write the objects that the drive has and the scene does not set; None: the largest value."""
        dictionary, asked = self._drive.dictionary, self._drive.axis.written_objects
        for index, value in values.items():
            if is_writable(dictionary, index, 0) and (index, 0) not in asked:
                self._write_confirmed(step, index, 0, largest_value(dictionary, index) if value is None else value)

    def _zero_offsets(self) -> None:
        """Zero the drive's offsets to its target: the account does not include a torque set elsewhere."""
        drive = self._drive
        for index in drive.axis.causality.offsets:
            variable = drive.dictionary.get_variable(index)
            if index in drive.left_out:
                continue
            if variable is not None and variable.writable:
                self._write_confirmed("offsets", index, 0, 0)
            elif variable is None or variable.readable:
                with self.step("offsets"):
                    seen = self._read_if_there(index)
                if seen:
                    why = "not in the dictionary" if variable is None else "read-only"
                    raise self.refusal("offsets", f"{self._sdo.describe(index)} = {seen}, {why}", "0")

    def _read_if_there(self, index: int) -> int | None:
        """Return the value of an object that the drive need not have; None where it has none; raise SdoError."""
        try:
            return self._sdo.read(index)
        except SdoError as error:
            if error.code is None:
                raise
            return None

    def _rated_torque(self) -> None:
        drive = self._drive
        counts: int | None = None
        with self.step("rated torque", "a rated torque on which drive and configuration agree"):
            if drive.quirks.reads_rated_torque and od.RATED_TORQUE in drive.dictionary:
                counts = self._sdo.read(od.RATED_TORQUE) or self._write_rated_torque()
            rated_torque = agreed_rated_torque(drive.axis, counts, drive.quirks.rated_torque_resolution)
        drive.scaling = axis_scaling(drive.axis, rated_torque)

    def _write_rated_torque(self) -> int:
        """Write rated_torque to a 0x6076 that is 0, if the drive needs that; return its value then."""
        drive, rated_torque = self._drive, self._drive.axis.rated_torque
        if not drive.quirks.writes_rated_torque or rated_torque is None:
            return 0
        counts = round(rated_torque / drive.axis.transmission / drive.quirks.rated_torque_resolution)
        self._write_confirmed("rated torque", od.RATED_TORQUE, 0, counts)
        return counts

    def _torque_limit(self) -> None:
        drive = self._drive
        limit = drive.axis.torque_limit
        if limit > drive.scaling.largest_torque:
            expected = f"at most {drive.scaling.largest_torque:g} (32767 counts of 0x6071)"
            raise self.refusal("torque limit", f"torque_limit {limit:g}", expected)
        if drive.quirks.writes_max_torque and is_writable(drive.dictionary, od.MAX_TORQUE, 0):
            per_mille = torque_limit_per_mille(limit, drive.scaling.rated_torque)
            in_drive = written_max_torque(drive.dictionary, drive.axis, per_mille)
            self._write_confirmed("torque limit", od.MAX_TORQUE, 0, in_drive)

    def _drive_objects(self) -> None:
        for place, value in self._drive.axis.written_objects.items():
            self._write_confirmed("drive objects", *place, value)

    def _set_brake(self) -> None:
        """Set a brake that the host operates, and enable writing of its output: the first write to the drive."""
        drive, index, brake = self._drive, od.DIGITAL_OUTPUTS, self._drive.axis.brake
        if brake is None or brake.output is None:
            return
        with self.step("brake"):
            drive.outputs = self._sdo.probe(index, 1)
        self._write_confirmed("brake", index, 1, brake.outputs(drive.outputs, is_open=False))
        if is_writable(drive.dictionary, index, 2):
            with self.step("brake"):
                mask = self._sdo.read(index, 2)
            self._write_confirmed("brake", index, 2, mask | 1 << brake.output)

    def _watchdog(self) -> None:
        """Make the drive detect a dead master: 0x6007 selects its reaction, the fieldbus arms it."""
        drive = self._drive
        if not drive.axis.watchdog:
            return
        if is_writable(drive.dictionary, od.ABORT_CONNECTION_OPTION, 0):
            self._write_confirmed("watchdog", od.ABORT_CONNECTION_OPTION, 0, drive.quirks.abort_connection_option)
        self._arm()

    def _confirm_hold(self) -> None:
        """Note that a test has confirmed the hold of this drive, with this map and rate; raise StartError."""
        drive = self._drive
        if drive.axis.hold_checked:
            with self.step("identity"):
                if drive.axis.hold_checked == drive.signature():
                    drive.hold = f"checked at {'this start' if drive.axis.check_hold else 'commissioning'}"

    def _interpolation_period(self) -> None:
        drive = self._drive
        index = od.INTERPOLATION_PERIOD
        if not (drive.quirks.writes_interpolation_period and is_writable(drive.dictionary, index, 1)):
            return
        period = decimal_period(drive.sample_time_ns)
        if period is not None:
            if is_writable(drive.dictionary, index, 2):
                self._write_confirmed("interpolation period", index, 2, period[1])
            self._write_confirmed("interpolation period", index, 1, period[0])

    def _mode(self) -> None:
        with self.step("mode of operation"):
            mode = self._drive.mode_code
            self._sdo.write(od.MODES_OF_OPERATION, 0, mode)
            if self._drive.quirks.shows_mode_when_enabled:
                return  # the start confirms it then
            if not self._await(lambda: self._sdo.read(od.MODES_OF_OPERATION_DISPLAY) == mode):
                seen = self._sdo.read(od.MODES_OF_OPERATION_DISPLAY)
                raise self.overdue("mode of operation", f"0x6061 = {seen}", f"{mode}")
