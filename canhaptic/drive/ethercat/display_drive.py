"""An admittance display on an EtherCAT line: its force is an object in the inputs of its drive."""

from canhaptic.drive.ethercat.bring_up import EthercatBringUp
from canhaptic.drive.ethercat.servo_drive import EthercatDrive
from canhaptic.drive.profile.display_axis import DisplayAxis, DisplayBringUp


class EthercatDisplay(EthercatDrive, DisplayAxis):
    """A drive on an EtherCAT line that follows velocities and reports forces; the arguments are its base class's."""

    def bring_up(self) -> "DisplayBringUpOnLine":
        """Return the steps that start an admittance display."""
        return DisplayBringUpOnLine(self)

    def write(self, torque_per_mille: int) -> None:
        """Put controlword and command into the image; in mode 8 the target position advances; raise LinkError."""
        self._send(super().write, torque_per_mille)


class DisplayBringUpOnLine(EthercatBringUp, DisplayBringUp):
    """Configures one drive on an EtherCAT line that follows velocities."""

    _drive: EthercatDisplay
