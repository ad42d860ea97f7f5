"""Additions to the start of an admittance display: no ramps, no offsets, a quick stop that stops."""

from typing import Final

from canhaptic.canopen import objects as od
from canhaptic.canopen.dictionary import is_writable
from canhaptic.drive.can.can_bring_up import CanBringUp
from canhaptic.drive.can.display_drive import DisplayDrive
from canhaptic.drive.profile.bring_up import Confirmation
from canhaptic.drive.profile.fitness import RAMPS, largest_value

_SLOW_DOWN: Final = 2  # value of 0x605A: along the quick stop ramp, then switch on disabled
_NO_TARE: Final = "check power and node ID of the sensor, or leave admittance.force.node.tare out"
_NOT_AT_REST: Final = (
    "let go of the handle; then correct force.offset_counts (canhaptic commission measures it), tare the sensor, or "
    "raise force.error, which the account assumes"
)
_REMEDY: Final = "set the object with the vendor's tool, or correct its limits in the dictionary"


class DisplayBringUp(CanBringUp):
    """Configures one drive that follows velocities."""

    _drive: DisplayDrive

    def __init__(self, drive: DisplayDrive) -> None:
        super().__init__(drive)
        self._remedies = {
            **self._remedies,
            "ramps": _REMEDY,
            "quick stop": _REMEDY,
            "tare": _NO_TARE,
            "force at rest": _NOT_AT_REST,
        }

    def _zero_torque(self) -> None:
        """Write a target at rest, the steepest ramps of the drive, zero offsets, and the quick stop."""
        target = od.TARGET_VELOCITY
        if self._drive.display.mode == "position":
            with self.step("zero torque"):
                position = self._sdo.read(od.POSITION_ACTUAL)
            self._write_confirmed("zero torque", od.TARGET_POSITION, 0, position)
        else:
            self._write_confirmed("zero torque", target, 0, 0)
        dictionary = self._drive.dictionary
        for index in RAMPS:  # a ramp inside the drive changes the command behind the certificate's back
            if is_writable(dictionary, index, 0):
                self._write_confirmed("ramps", index, 0, largest_value(dictionary, index))
        self._zero_offsets()
        if is_writable(dictionary, od.QUICK_STOP_DECELERATION, 0):
            steepest = largest_value(dictionary, od.QUICK_STOP_DECELERATION)
            self._write_confirmed("quick stop", od.QUICK_STOP_DECELERATION, 0, steepest)
        if is_writable(dictionary, od.QUICK_STOP_OPTION, 0):
            self._write_confirmed("quick stop", od.QUICK_STOP_OPTION, 0, _SLOW_DOWN)

    def command_operational(self) -> None:
        """Send NMT start to the drive and to a sensor with a node of its own, tared where asked; raise StartError."""
        with self.step("tare"):
            self._drive.tare()
        super().command_operational()
        with self.step("bus"):
            self._drive.command_sensor(od.NmtCommand.START)

    def check_rest(self) -> None:
        """Refuse a sensor that shows a force while nothing pushes: an offset would move the handle by itself."""
        drive = self._drive
        if not drive.checks_rest:
            return
        force, declared = drive.force, drive.display.force
        shown, unit = force.of(drive.reported_per_mille), "N" if drive.axis.unit == "m" else "N*m"
        if not -declared.error <= shown <= declared.error:
            raise self.refusal(
                "force at rest", f"{shown:.4g} {unit} before the drive is enabled",
                f"at most force.error ({declared.error:g} {unit}), with no hand on the handle",
            )  # fmt: skip

    def process_data(self) -> Confirmation:
        """Confirmation by every TPDO after a SYNC, and the frame of the sensor."""
        wanted, node = super().process_data(), self._drive.display.force.node
        if node is None:
            return wanted
        return wanted._replace(expected=f"{wanted.expected}, and frame {node.frame_id:#05x} of the force sensor")
