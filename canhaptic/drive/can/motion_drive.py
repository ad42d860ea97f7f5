"""A CANopen drive in mode 8 or 9: its force comes in a TPDO, or in the frame of a sensor with its own node."""

from canhaptic.drive.can.servo_drive import ServoDrive
from canhaptic.drive.profile.motion_axis import MotionAxis


class CanMotionDrive(ServoDrive, MotionAxis):
    """A CANopen node that follows velocities and shows forces; the arguments are its base class's."""

    def write(self, torque_per_mille: int) -> None:
        """Send controlword and command as one image; in mode 8 the target position advances; raise LinkError."""
        self._send(super().write, torque_per_mille)
