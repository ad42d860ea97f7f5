"""A rig that joins a bus whose drives are enabled already: for recordings that lack the start."""

from canhaptic.canopen import objects as od
from canhaptic.drive.can.servo_drive import ServoDrive
from canhaptic.drive.profile.fitness import agreed_rated_torque
from canhaptic.drive.profile.quirks import quirks_of
from canhaptic.drive.profile.scaling import axis_scaling
from canhaptic.drive.rig import Rig


class JoinedRig(Rig):
    """A rig whose `start` sends only SYNC 0. Never for real drives: nothing about them is confirmed."""

    def start(self) -> None:
        """Send SYNC 0 and take its TPDOs."""
        self._reset()
        for drive in self.drives:
            _suppose_enabled(drive)
        exchange = self._exchange
        exchange.begin()
        exchange.sync()
        self.sync_index = 0
        self._is_running = True
        self._first_samples = [drive.sample(0) for drive in self.drives]
        for drive in self.drives:
            drive.watch_statusword()


def _suppose_enabled(drive: ServoDrive) -> None:
    """Set the values that a start would have found."""
    drive.reset()
    drive.answers = True
    drive.nmt_state = int(od.NmtState.OPERATIONAL)
    drive.controlword = int(od.Controlword.ENABLE_OPERATION)
    variable = drive.dictionary.get_variable(od.RATED_TORQUE, 0)
    stated = None if drive.axis.rated_torque or variable is None else variable.default
    rated_torque = agreed_rated_torque(drive.axis, stated, quirks_of(drive.axis.quirks).rated_torque_resolution)
    drive.scaling = axis_scaling(drive.axis, rated_torque)
