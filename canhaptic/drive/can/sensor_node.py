"""A force sensor that is its own CANopen node: its state, and the steps with which the start of its drive starts it."""

from typing import TYPE_CHECKING, cast

from canhaptic.canopen import objects as od
from canhaptic.drive.can.sdo import SdoChannel
from canhaptic.errors import SdoError

if TYPE_CHECKING:
    from canopen import ObjectDictionary

    from canhaptic.canopen.attached_devices import ForceNode
    from canhaptic.drive.can.link import Link
    from canhaptic.drive.profile.bring_up import BringUp
    from canhaptic.drive.profile.torque_axis import TorqueAxis

_STEP = "force sensor"


class SensorNode:
    """A sensor that is a CANopen node.

    Args:
        link: Link to its bus.
        drive: Drive whose samples have its force.
        node: Its frame.
        node_id: Its node ID.
    """

    def __init__(self, link: "Link", drive: "TorqueAxis", node: "ForceNode", node_id: int) -> None:
        self._link, self._drive, self._node, self._node_id = link, drive, node, node_id

    def command(self, command: od.NmtCommand) -> None:
        """Send an NMT command to the sensor; raise LinkError."""
        self._link.send(od.NMT_COB_ID, bytes([command, self._node_id]))

    def sdo(self) -> SdoChannel:
        """Return its SDO channel."""
        axis = self._drive.axis
        timeout, name = round(axis.sdo_timeout * 1e9), f"force sensor of {axis.name}"
        return SdoChannel(self._link, self._node_id, cast("ObjectDictionary", self._drive.dictionary), name, timeout)

    def identify(self, start: "BringUp") -> None:
        """Compare the sensor's 0x1000, and write nothing to it; raise StartError."""
        sensor, device_type = self.sdo(), self._node.device_type
        with start.step(_STEP):
            try:
                seen = sensor.read(od.DEVICE_TYPE) & 0xFFFF
            except SdoError as error:
                if error.code is not None:
                    raise
                self.command(od.NmtCommand.PRE_OPERATIONAL)  # in NMT STOPPED it takes no SDO
                seen = sensor.read(od.DEVICE_TYPE) & 0xFFFF
        if seen == od.CIA402_PROFILE if device_type is None else seen != device_type:
            raise start.refusal(_STEP, f"0x1000 has the low word {seen}", str(device_type or "any but a drive's"))

    def configure(self, start: "BringUp") -> None:
        """Prepare the sensor for NMT start, tared if configured; raise StartError."""
        channel, node = self.sdo(), self._node
        if self._drive.restores:  # an older master left the sensor alone
            if not self._drive.identifies:
                self.identify(start)
            self._answer_sync(channel, start)
        if node.tare:
            tare = (od.AUTOZERO, od.ZERO_SIGNATURE) if node.tare == "autozero" else (od.AUTOTARE, od.TARE_SIGNATURE)
            with start.step("tare"):
                channel.write(tare[0], 1, tare[1], 4)

    def _answer_sync(self, sensor: SdoChannel, start: "BringUp") -> None:
        """Make the sensor's TPDO 1 answer each SYNC; raise StartError."""
        place = od.TPDO_COMMUNICATION, 2
        with start.step(_STEP):
            before = sensor.read(*place)
            if before != od.SYNCHRONOUS_EVERY_SYNC:
                sensor.write(*place, od.SYNCHRONOUS_EVERY_SYNC, 1)
                start.expect(_STEP, "0x1800:02 read back", sensor.read(*place), od.SYNCHRONOUS_EVERY_SYNC)
        self._drive.elsewhere = [f"force sensor: 0x1800:02 = 1, {before} before"] if before != 1 else []
