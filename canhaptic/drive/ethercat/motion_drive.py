"""A drive on an EtherCAT line in mode 8 or 9: its force is an object in the inputs of its drive."""

from canhaptic.drive.ethercat.servo_drive import EthercatDrive
from canhaptic.drive.profile.motion_axis import MotionAxis


class EthercatMotionDrive(EthercatDrive, MotionAxis):
    """A drive on an EtherCAT line that follows velocities and shows forces; the arguments are its base class's."""

    def write(self, torque_per_mille: int) -> None:
        """Put controlword and command into the image; in mode 8 the target position advances; raise LinkError."""
        self._send(super().write, torque_per_mille)
