"""An admittance display on a CAN bus: its force comes in a TPDO, or in the frame of a sensor with its own node."""

from collections.abc import Callable
from typing import TYPE_CHECKING

from canopen import ObjectDictionary

from canhaptic.canopen import objects as od
from canhaptic.drive.axis_parameters import AxisParameters, CanBusParameters
from canhaptic.drive.can.link import Link
from canhaptic.drive.can.sdo import SdoChannel
from canhaptic.drive.can.servo_drive import CanBringUp, ServoDrive
from canhaptic.drive.profile.bring_up import Confirmation
from canhaptic.drive.profile.display_axis import DisplayAxis, DisplayBringUp
from canhaptic.errors import SdoError

if TYPE_CHECKING:
    from canhaptic.canopen.attached_devices import ForceNode


class AdmittanceDrive(ServoDrive, DisplayAxis):
    """A CANopen node that follows velocities and reports forces.

    Raises:
        DictionaryError: The dictionary is not fit for an admittance display.
        ParameterError: The axis is not an admittance display.
    """

    def __init__(self, link: Link, axis: AxisParameters, dictionary: ObjectDictionary, bus: CanBusParameters) -> None:
        super().__init__(link, axis, dictionary, bus)
        self._sensor = self.display.force.node
        if self._sensor is not None:
            link.subscribe(self._sensor.frame_id, self._force_handler(self._sensor))

    def bring_up(self) -> "AdmittanceBringUp":
        """Return the steps that start an admittance display."""
        return AdmittanceBringUp(self)

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

    def write(self, torque_per_mille: int) -> None:
        """Send controlword and command as one image; in mode 8 the target position advances; raise LinkError."""
        self._send(super().write, torque_per_mille)


class AdmittanceBringUp(CanBringUp, DisplayBringUp):
    """Configures one CANopen node that follows velocities."""

    _drive: AdmittanceDrive

    def identify(self) -> None:
        """Read which drive and which sensor these are, and write nothing to them; raise StartError."""
        super().identify()
        node, channel = self._drive.display.force.node, self._drive.sensor_sdo()
        if channel is not None and node is not None:
            self._identify_sensor(channel, node.device_type)

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

    def process_data(self) -> Confirmation:
        """Confirmation that every TPDO and the frame of the sensor arrive after a SYNC."""
        wanted, node = super().process_data(), self._drive.display.force.node
        if node is None:
            return wanted
        return wanted._replace(expected=f"{wanted.expected}, and frame {node.frame_id:#05x} of the force sensor")
