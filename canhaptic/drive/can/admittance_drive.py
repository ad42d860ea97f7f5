"""An admittance display on a CAN bus: force in the TPDO, velocity command in the RPDO.

It runs in the same cycle as a `ServoDrive`: its sample holds minus the hand's force in place of the torque of an
impedance display. Its start also sets the steepest ramps, zero offsets, and a quick stop that brakes.
"""

from collections.abc import Callable
from math import inf
from typing import TYPE_CHECKING, Final

from canopen import ObjectDictionary

from canhaptic.canopen import objects as od
from canhaptic.canopen.objects import is_writable
from canhaptic.drive.axis_parameters import AxisParameters, CanBusParameters
from canhaptic.drive.can.link import Link
from canhaptic.drive.can.sdo import SdoChannel
from canhaptic.drive.can.servo_drive import CanBringUp, ServoDrive
from canhaptic.drive.profile.admittance_parameters import AdmittanceParameters, ForceChannel
from canhaptic.drive.profile.bring_up import Confirmation
from canhaptic.drive.profile.fitness import RAMPS, largest_value
from canhaptic.drive.profile.scaling import AxisScaling
from canhaptic.drive.safety.limiter import TorqueLimiter
from canhaptic.drive.safety.link_policy import StopReason
from canhaptic.drive.safety.power_states import PowerState
from canhaptic.errors import ParameterError, SdoError
from canhaptic.signals import Sample

if TYPE_CHECKING:
    from canhaptic.canopen.attached_devices import ForceNode

_tuple: Final = tuple.__new__
_WRAP: Final = 1 << 32
_UNLIMITED_SPEED: Final = 1e9  # [m/s or rad/s] where the scene declares none, on the virtual bus only


class AdmittanceDrive(ServoDrive):
    """A drive that follows velocities and reports forces.

    Attributes:
        checks_rest: Whether the start refuses a sensor that shows more than `force.error` before the drive is enabled.

    Raises:
        DictionaryError: The dictionary is not fit for an admittance display.
        ParameterError: The axis is not an admittance display.
    """

    stop_word = od.Controlword.QUICK_STOP

    def __init__(self, link: Link, axis: AxisParameters, dictionary: ObjectDictionary, bus: CanBusParameters) -> None:
        display = axis.admittance
        if display is None:
            raise ParameterError(f"{axis.name}: has no `admittance`; expected an admittance display")
        self.display: AdmittanceParameters = display
        self.force = ForceChannel(display.force, bus.sample_time)
        self.checks_rest = display.force.sampling != "impulse"  # a sum does not show the present force
        self._is_position = display.mode == "position"
        self.command_quantum = speed_quantum(axis, bus)
        super().__init__(link, axis, dictionary, bus)
        self.stop_time = round(display.stop_time * 1e9)
        self.limiter = TorqueLimiter(axis.speed_limit or _UNLIMITED_SPEED, bus.sample_time, display.acceleration_limit)
        # A handle overshoots its command, and the hand moves it besides
        self._largest_step = 2.0 * (axis.speed_limit or _UNLIMITED_SPEED) * bus.sample_time
        counts = axis.counts_per_unit
        # `AxisScaling` takes per mille, and here counts of the command
        self.command_scaling = AxisScaling(counts, self.command_quantum * 1000.0, axis.direction)
        self._low = -inf if display.position_low is None else display.position_low
        self._high = inf if display.position_high is None else display.position_high
        self._sensor = display.force.node
        if self._sensor is not None:
            link.subscribe(self._sensor.frame_id, self._force_handler(self._sensor))
        if self._is_position:
            self.rest_text = "the position of the axis"

    def bring_up(self) -> "AdmittanceBringUp":
        """Return the steps that start an admittance display."""
        return AdmittanceBringUp(self)

    @property
    def quantum(self) -> float:
        """Step of the force in its process data [N or N*m]."""
        return abs(self.display.force.per_count)

    def _force_handler(self, node: "ForceNode") -> Callable[[bytearray], None]:
        """Return the handler of a sensor with its own node, whose frame is one more part of the sample."""
        bit = self._all_tpdos + 1
        self._all_tpdos |= bit
        length, value_in = node.frame_length, node.value_in

        def take(data: bytearray) -> None:
            if len(data) != length:
                self._statistics.short += 1
                return
            if not self._pending & bit:
                self._take_surplus(bit, (2,), (value_in(data),))
                return
            self._stage[2] = value_in(data)
            self._take_part(bit)

        return take

    def part(self, bits: int) -> str:
        """Return the names of the frames of a sample whose bits are set; the last bit is the sensor's frame."""
        sensor, frames = self._sensor, super().part(bits)
        if sensor is None or not bits >> len(self.map.tpdos):
            return frames
        return f"{frames}, ".lstrip(", ") + f"frame {sensor.frame_id:#05x} of the force sensor"

    def command_sensor(self, command: od.NmtCommand) -> None:
        """Send an NMT command to a sensor that is its own CANopen node.

        Raises:
            LinkError: It could not be sent.
        """
        if self._sensor is not None and self._sensor.node_id is not None:
            self.link.send(od.NMT_COB_ID, bytes([command, self._sensor.node_id]))

    def sensor_sdo(self) -> SdoChannel | None:
        """Return the SDO channel of a sensor that is a CANopen node; None for any other."""
        if self._sensor is None or self._sensor.node_id is None:
            return None
        timeout, name = round(self.axis.sdo_timeout * 1e9), f"force sensor of {self.axis.name}"
        return SdoChannel(self.link, self._sensor.node_id, self.dictionary, name, timeout)

    def leave_operational(self) -> None:
        """Command NMT pre-operational to drive and sensor; raise LinkError."""
        self.command_sensor(od.NmtCommand.PRE_OPERATIONAL)
        super().leave_operational()

    def reset(self) -> None:
        """Clear everything received and commanded."""
        super().reset()
        self.force.reset()
        self._target = 0
        self._rest_targets: tuple[int, ...] = ()  # the last two that were sent while the drive was not enabled

    def sample(self, sync_index: int, periods: int = 1, *, is_whole: bool = True) -> Sample:
        """Return the sample of the SYNC just answered, else the last one, marked as old; see `TorqueAxis.sample`."""
        if not (self.is_complete and is_whole):
            return super().sample(sync_index, periods, is_whole=is_whole)
        self._periods += periods
        self._is_late = periods > 1
        self.longest_gap = max(self.longest_gap, periods)
        self.policy.on_tpdo()
        statusword, counts, shown = self._values
        position, last = self.scaling.position(counts), self._last
        periods, self._periods = self._periods, 0
        if last.sync_index >= 0:
            self._step = (position - last.position) / periods
            self.longest_hold = max(self.longest_hold, periods)
            if self._contest is not None:
                self._settle_contest(self._contest, abs(position - last.position), abs(self.force.of(shown)))
        force = self.force.take(shown, periods)
        self._last = sample = _tuple(Sample, (sync_index, position, -force, statusword, True))
        return sample

    def fault(self, now: int) -> StopReason:
        """Return why the rig must stop because of this drive; NONE without a reason."""
        if self.force.is_wrong:
            return StopReason.FORCE_RANGE if self.force.is_beyond_range else StopReason.FORCE_FROZEN
        return super().fault(now)

    def command_per_mille(self, torque: float) -> int:
        """Command in counts for a requested velocity [m/s or rad/s]; limited like a torque.

        At a position limit no velocity leads further towards it.

        Raises:
            ControlError: The velocity is not finite.
        """
        policy, limiter, position = self.policy, self.limiter, self._last.position
        if (policy.missed or self._is_late) and torque - torque == 0.0:
            held = limiter.last if not policy.missed else self._held if policy.is_held else 0.0
            torque = max(min(held, 0.0), min(max(held, 0.0), torque))
        if (position >= self._high and torque > 0.0) or (position <= self._low and torque < 0.0):
            torque = 0.0
        torque = limiter.limit(torque, 0.0)
        return self.command_scaling.torque_per_mille(torque, limiter.low, limiter.high)

    def write(self, torque_per_mille: int) -> None:
        """Send controlword and command as one image; in mode 8 the target position advances by the command.

        Raises:
            LinkError: It could not be sent.
        """
        if not self._is_position:
            return super().write(torque_per_mille)
        rests = self.state is not PowerState.OPERATION_ENABLED
        begin = self.position_counts if rests else self._target
        target = (begin + torque_per_mille + _WRAP // 2) % _WRAP - _WRAP // 2
        super().write(target)
        if rests:
            self._rest_targets = (self._target, begin)
        self._target = target  # only what was sent: the next command adds to it

    def rests_at(self, target: int) -> bool:
        """Whether a target read from the drive is consistent with rest."""
        if not self._is_position:
            return target == 0
        if target in self._rest_targets:  # a hand may move the axis meanwhile
            return True
        # A handle may move by so much between two readings of its position
        return abs((target - self.position_counts + _WRAP // 2) % _WRAP - _WRAP // 2) <= (1 << 10)


def speed_quantum(axis: AxisParameters, bus: CanBusParameters) -> float:
    """Return the smallest step of the velocity that can be commanded [m/s or rad/s]."""
    display = axis.admittance
    if display is None or display.mode == "position":
        return 1.0 / (axis.counts_per_unit * bus.sample_time)
    return 1.0 / (display.velocity_counts or axis.counts_per_unit)


class AdmittanceBringUp(CanBringUp):
    """Configures one drive that follows velocities."""

    _drive: AdmittanceDrive

    def identify(self) -> None:
        """Read which drive and which sensor these are, and write nothing to them; raise StartError."""
        super().identify()
        node, channel = self._drive.display.force.node, self._drive.sensor_sdo()
        if channel is not None and node is not None:
            self._identify_sensor(channel, node.device_type)

    def _zero_torque(self) -> None:
        """Write a target at rest, the steepest ramps of the drive, zero offsets, and the quick stop."""
        with self.step("zero torque"):
            rest = self._sdo.read(od.POSITION_ACTUAL) if self._drive.display.mode == "position" else 0
        self._write_confirmed("zero torque", self._drive.axis.target, 0, rest)
        for index in RAMPS:  # a ramp inside the drive changes the command behind the certificate's back
            self._write_unless_asked("ramps", index, largest_value(self._drive.dictionary, index))
        self._zero_offsets()
        steepest = largest_value(self._drive.dictionary, od.QUICK_STOP_DECELERATION)
        self._write_unless_asked("quick stop", od.QUICK_STOP_DECELERATION, steepest)
        self._write_unless_asked("quick stop", od.QUICK_STOP_OPTION, 2)  # along its ramp, then disabled

    def _write_unless_asked(self, step: str, index: int, value: int) -> None:
        """Write an object if the drive has it and the scene does not set it."""
        drive = self._drive
        if is_writable(drive.dictionary, index, 0) and (index, 0) not in drive.axis.written_objects:
            self._write_confirmed(step, index, 0, value)

    def command_operational(self) -> None:
        """Send NMT start to the drive and to a sensor with its own node, tared if configured; raise StartError."""
        node, channel = self._drive.display.force.node, self._drive.sensor_sdo()
        if channel is not None and node is not None:
            if self._drive.restores:  # an older master left the sensor alone
                if not self._drive.identifies:
                    self._identify_sensor(channel, node.device_type)
                self._configure_sensor(channel)
            if node.tare:
                tare = (od.AUTOZERO, od.ZERO_SIGNATURE) if node.tare == "autozero" else (od.AUTOTARE, od.TARE_SIGNATURE)
                with self.step("tare"):
                    channel.write(tare[0], 1, tare[1], 4)
        super().command_operational()
        with self.step("bus"):
            self._drive.command_sensor(od.NmtCommand.START)

    def _identify_sensor(self, sensor: SdoChannel, device_type: int | None) -> None:
        """Compare the sensor's 0x1000; raise StartError."""
        step = "force sensor"
        with self.step(step):
            try:
                seen = sensor.read(od.DEVICE_TYPE) & 0xFFFF
            except SdoError as error:
                if error.code is not None:
                    raise
                self._drive.command_sensor(od.NmtCommand.PRE_OPERATIONAL)  # in NMT STOPPED it takes no SDO
                seen = sensor.read(od.DEVICE_TYPE) & 0xFFFF
        if seen == od.CIA402_PROFILE if device_type is None else seen != device_type:
            raise self.refusal(step, f"0x1000 has the low word {seen}", str(device_type or "any but a drive's"))

    def _configure_sensor(self, sensor: SdoChannel) -> None:
        """Make the sensor's TPDO 1 answer each SYNC; raise StartError."""
        step, place = "force sensor", (od.TPDO_COMMUNICATION, 2)
        with self.step(step):
            before = sensor.read(*place)
            if before != od.SYNCHRONOUS_EVERY_SYNC:
                sensor.write(*place, od.SYNCHRONOUS_EVERY_SYNC, 1)
                self.expect(step, "0x1800:02 read back", sensor.read(*place), od.SYNCHRONOUS_EVERY_SYNC)
        self._drive.elsewhere = [f"force sensor: 0x1800:02 = 1, {before} before"] if before != 1 else []

    def check_rest(self) -> None:
        """Refuse a sensor that shows a force while nothing pushes: an offset alone would move the handle."""
        drive = self._drive
        if not drive.checks_rest:
            return
        force, declared = drive.force, drive.display.force
        shown, unit = force.of(drive.reported_per_mille), "N" if drive.axis.unit == "m" else "N*m"
        if not -declared.error <= shown <= declared.error:
            wanted = f"at most force.error ({declared.error:g} {unit}), with no hand on the handle"
            raise self.refusal("force at rest", f"{shown:.4g} {unit} before the drive is enabled", wanted)

    def process_data(self) -> Confirmation:
        """Confirmation that every TPDO and the frame of the sensor arrive after a SYNC."""
        wanted, node = super().process_data(), self._drive.display.force.node
        if node is None:
            return wanted
        return wanted._replace(expected=f"{wanted.expected}, and frame {node.frame_id:#05x} of the force sensor")
