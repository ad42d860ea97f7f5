"""A servo drive on an EtherCAT line: a slice of the images of all drives, its AL state and its mailbox."""

import zlib
from contextlib import suppress
from operator import itemgetter
from typing import Any, Final

from canhaptic.canopen import objects as od
from canhaptic.canopen.objects import Dictionary
from canhaptic.drive.ethercat.bus_cycle import EthercatBusCycle
from canhaptic.drive.ethercat.coe import CoeAccess
from canhaptic.drive.ethercat.held_torques import SM_EVENT_MISSED, Reading
from canhaptic.drive.ethercat.image_map import ImageMap, choose_image
from canhaptic.drive.ethercat.parameters import EthercatAxisParameters
from canhaptic.drive.ethercat.segment import AL_STATUS, AlState, ImageSlice, al_remedy, al_text, state_name
from canhaptic.drive.profile.torque_axis import CycleRules, TorqueAxis
from canhaptic.drive.safety.link_policy import StopReason
from canhaptic.drive.safety.power_states import PowerState
from canhaptic.errors import LinkError, RigError, SdoError
from canhaptic.registry import load
from canhaptic.signals import Sample

SYSTEM_TIME: Final = 0x0910
SYNC_ACTIVATION: Final = 0x0980
WATCHDOG: Final = 0x0420
_DIFFERENCE: Final = 0x092C
"""Register of the difference between a drive's system time and the reference clock; bit 31: the drive is behind."""
_MAGNITUDE: Final = 0x7FFF_FFFF
_LOOKS: Final = 5  # in a row: a frame that passes the reference clock unread spreads a false time
_REACTION_NS: Final = 100_000_000
_POLL_NS: Final = 1_000_000
_SLOTS: Final = (od.STATUSWORD, od.POSITION_ACTUAL)


class EthercatDrive(TorqueAxis):
    """A drive on an EtherCAT line.

    Args:
        line: Its line.
        axis: Parameters of the axis.
        dictionary: Object dictionary of the drive.
        dry_run: Whether every frame carries a target torque of 0.
        lateness: Longest time from a hold's begin until its torque has settled [s].

    Attributes:
        line: Its line.
        map: Its process data.
        al_status, al_code: Registers 0x0130 and 0x0134 as read last.
        counts_before: Counts of held torques with which the run began; None where the drive has none.

    Raises:
        DictionaryError: The dictionary is not fit for cyclic torque.
    """

    axis: EthercatAxisParameters

    def __init__(
        self, line: EthercatBusCycle, axis: EthercatAxisParameters, dictionary: Dictionary, *,
        dry_run: bool = False, lateness: float = 0.0,
    ) -> None:  # fmt: skip
        self.line, self.bus = line, line.bus
        bus = line.bus
        self.map: ImageMap = choose_image(dictionary, axis)
        sdo = CoeAccess(line.segment, axis.position, dictionary, axis.name)
        cycles, losses = (bus.hold_cycles, bus.stop_cycles), (bus.loss_limit, lateness)
        times = bus.sample_time_ns, bus.sample_time
        rules = CycleRules(*times, *cycles, True, bus.drive_silence_ns, *losses, more_holds=bus.delay - 1)
        super().__init__(axis, dictionary, sdo, rules, self.map.read_back, dry_run)
        outputs, inputs = self.map.outputs, self.map.inputs
        self._pack_into, self._unpack_from = outputs.codec.pack_into, inputs.codec.unpack_from
        self._has_word_first = outputs.entries[0].index == od.CONTROLWORD
        indices = [entry.index for entry in inputs.entries]
        torque = [place for place, index in enumerate(indices) if index not in _SLOTS]
        places = (*(indices.index(index) for index in _SLOTS), *torque)
        self._ordered = None if places == (0, 1, 2) else itemgetter(*places)
        self._output = self._input = 0
        self._bit = 1 << len(line.drives)
        self.al_status = self.al_code = 0
        line.add(self)
        self.reset()

    def reset(self) -> None:
        """Clear everything received and commanded."""
        super().reset()
        self.al_status = self.al_code = 0
        self.counts_before: Reading | None = None
        self._looks_apart = 0

    def bring_up(self) -> Any:
        """Return the steps that start the drive in its mode: an `EthercatBringUp`."""
        return load({"": "canhaptic.drive.ethercat.bring_up:EthercatBringUp"}, "", "start")(self)

    def signature(self) -> str:
        """Return a text that identifies drive, process data and rate: a hold test is valid for it only."""
        identity = self.line.identities[self.axis.position]
        pdos = (self.map.outputs, self.map.inputs)
        mapped = repr([(pdo.index, [entry.mapping for entry in pdo.entries]) for pdo in pdos])
        cycle = f"{self.bus.rate:g}Hz-{self.bus.frames}frames-{self.quirks.syncs_late}"
        return "-".join([*(f"{part:x}" for part in identity), f"{zlib.crc32(mapped.encode()):x}", cycle])

    @property
    def sizes(self) -> tuple[int, int]:
        """Bytes of its outputs and inputs."""
        return self.map.outputs.codec.size, self.map.inputs.codec.size

    def place(self, image: ImageSlice) -> None:
        """Set the place of the drive in the images."""
        self._output, self._input = image.output, image.input

    # --- in ---------------------------------------------------------------------------------------------------------

    def now(self) -> int:
        """Return the time of the line's clock [ns]."""
        return self.line.clock.now()

    def pump(self, deadline: int) -> None:
        """Wait until `deadline` [ns]; where the line runs, its frames go on."""
        line = self.line
        while line.is_running and line.clock.now() < deadline:
            line.idle()
        line.clock.wait_until(deadline)

    def sample(self, sync_index: int, periods: int = 1, *, is_whole: bool = True) -> Sample:
        """Return the sample of the SYNC0 just answered, else the last one, marked as old; see `TorqueAxis.sample`."""
        return super().sample(sync_index, periods + self.line.slip, is_whole=is_whole)

    def take(self, inputs: bytes, now: int) -> None:
        """Take the inputs of a whole frame.

        Args:
            inputs: Image of all inputs.
            now: Time [ns].
        """
        values = self._unpack_from(inputs, self._input)
        self._values = values if self._ordered is None else _three(self._ordered(values))
        self.statusword = self._values[0]
        self.is_complete, self.alive_at = True, now

    def read_al_status(self) -> None:
        """Read the state of the application layer; one that is not OP ends the run."""
        data = self.line.segment.register(self.axis.position, AL_STATUS, size=6)
        self.al_status, self.al_code = data[0], int.from_bytes(data[4:6], "little")
        self.is_operational = self.al_status == AlState.OP

    def clock_objection(self) -> str:
        """Return how far the clock of the drive is from the reference clock, in words; "" where it follows it.

        Raises:
            LinkError: The frame was lost.
        """
        apart = int.from_bytes(self.line.segment.register(self.axis.position, _DIFFERENCE, size=4), "little")
        apart, most = apart & _MAGNITUDE, self.line.lock.close_ns
        text = f"its clock is {apart / 1e3:g} us from the reference clock (0x092C), limit {most / 1e3:g} us"
        return text if apart > most else ""

    def look_at_clock(self) -> None:
        """End the run where the clock of the drive has not followed the reference clock for long; raise LinkError."""
        found = self.clock_objection()
        self._looks_apart = self._looks_apart + 1 if found else 0
        if self._looks_apart >= _LOOKS:
            self.disagreement, self._distrust = found, StopReason.HOLDS_CONTRADICTED

    def read_state(self) -> PowerState:
        """Ask the drive for its power state, after a fault reaction that is under way; raise SdoError."""
        end = self.now() + _REACTION_NS
        while (state := super().read_state()) is PowerState.FAULT_REACTION_ACTIVE and self.now() < end:
            self.pump(self.now() + _POLL_NS)
        return state

    @property
    def state_text(self) -> str:
        """State of the communication, in words."""
        code = f", code {self.al_code:#06x}: {al_text(self.al_code)}" if self.al_code else ""
        return f"AL status {self.al_status:#04x} ({state_name(self.al_status)}){code}"

    def emergency_remedy(self, skipped: int) -> str:
        """Return the remedy for the state that the drive left; "" for its manual's."""
        return al_remedy(self.al_code) if self.al_code else ""

    # --- out --------------------------------------------------------------------------------------------------------

    def write(self, torque_per_mille: int) -> None:
        """Put controlword and target torque into the image; the last drive of the line sends it; raise LinkError."""
        self._commanded = torque_per_mille
        line = self.line
        if not line.is_running:
            return
        target = 0 if self.dry_run else torque_per_mille
        values = (self.controlword, target) if self._has_word_first else (target, self.controlword)
        self._pack_into(line.segment.outputs, self._output, *values)
        line.written(self._bit)

    def disable_unconfirmed(self) -> None:
        """Send the controlword of a stop and zero torque in a frame of its own; raise LinkError."""
        self.controlword = int(self.stop_word)
        self.write(0)
        self.line.flush()

    def command_brake(self, *, is_open: bool) -> None:
        """Open or set a brake operated by the host; raise LinkError."""
        brake = self.axis.brake
        if brake is None or self.outputs is None:
            return
        try:
            self.sdo.write(od.DIGITAL_OUTPUTS, 1, brake.outputs(self.outputs, is_open=is_open), 4)
        except SdoError as error:
            raise LinkError(str(error)) from error

    def leave_operational(self) -> None:
        """Take the drive to SAFE-OP, where it gives no torque, and compare the counts of held torques."""
        begin, self.counts_before, least = self.counts_before, None, 0
        if begin is not None:
            self.read_al_status()
            if self.al_status == AlState.OP:
                least = self._held_by_host()
            else:
                begin = None  # a drive that has left OP by itself counts no longer
        self._request(AlState.SAFE_OP)
        self.is_operational = False
        if begin is not None and (end := self._counts(least)) is not None:
            self.disagreement = self.disagreement or self.line.held.objection(begin, end)

    def begin_counts(self) -> None:
        """Read the count of held torques with which the run begins; raise LinkError."""
        self.counts_before = self._counts()

    def _counts(self, least: int | None = None) -> Reading | None:
        """Return the count of the drive and that of the host, `least` before (None: now); None where it has none."""
        if self.dictionary.get_variable(*SM_EVENT_MISSED) is None:
            return None
        least = self._held_by_host() if least is None else least
        with suppress(SdoError):  # a drive that fails to tell is no contradiction
            return Reading(self.sdo.read(*SM_EVENT_MISSED), least, self._held_by_host())
        return None

    def _held_by_host(self) -> int:
        time = self.line.segment.register(self.axis.position, SYSTEM_TIME, size=8)
        return self.line.held.until(int.from_bytes(time, "little"))

    def await_pre_operational(self) -> None:
        """Take the drive to PRE-OP, and switch its SYNC0 off."""
        self._request(AlState.PRE_OP)
        self.line.segment.register(self.axis.position, SYNC_ACTIVATION, bytes(2))
        self.line.is_running = any(drive.is_operational for drive in self.line.drives)

    def _request(self, state: AlState) -> None:
        try:
            self.line.segment.request(self.axis.position, state)
        except LinkError:
            raise
        except RigError as error:
            raise LinkError(f"{self.axis.name}: {error}") from error

    def disarm(self) -> None:
        """Do nothing: the watchdog of the sync manager is off outside OP."""


def _three(values: tuple[int, ...]) -> tuple[int, ...]:
    """Return statusword, position and torque, 0 where none is mapped."""
    return values if len(values) == 3 else (*values, 0)
