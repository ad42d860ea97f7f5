"""A rig that joins a bus whose drives are enabled already: for recordings that lack the start."""

from collections.abc import Callable, Sequence

from canhaptic import object_dictionary as od
from canhaptic.drive.fitness import agreed_rated_torque
from canhaptic.drive.link import Link
from canhaptic.drive.parameters import BusParameters
from canhaptic.drive.quirks import quirks_of
from canhaptic.drive.rig import Rig
from canhaptic.drive.scaling import axis_scaling
from canhaptic.drive.servo_drive import ServoDrive


class JoinedRig(Rig):
    """A rig whose `start` sends only SYNC 0. Never for real drives: nothing about them is confirmed.

    Args:
        links: The buses.
        drives: One per axis.
        bus: Rate, link policy and the rest.
        heartbeat_cycle: In which cycle, counted from 1, the master's first heartbeat is due; None when not known.
        arm: Called before SYNC 0; what is sent before is not meant for anybody.
    """

    def __init__(
        self,
        links: Sequence[Link],
        drives: Sequence[ServoDrive],
        bus: BusParameters,
        heartbeat_cycle: int | None,
        arm: Callable[[], None],
    ) -> None:
        super().__init__(links, drives, bus)
        self._heartbeat_cycle = heartbeat_cycle
        self._arm = arm

    def start(self) -> None:
        """Sends SYNC 0 and takes its TPDOs."""
        self._reset()
        for drive in self.drives:
            _suppose_enabled(drive)
        exchange = self._exchange
        exchange.begin()
        cycles = self.bus.heartbeat_cycles
        for _ in range(1 + max(0, cycles - (self._heartbeat_cycle or cycles))):  # brings the count of cycles in step
            exchange.beat()
        self._arm()
        exchange.sync()
        self.sync_index = 0
        self._is_running = True
        self._first_samples = [drive.sample(0) for drive in self.drives]
        for drive in self.drives:
            drive.watch_statusword()


def _suppose_enabled(drive: ServoDrive) -> None:
    """Sets what a start would have found out."""
    drive.reset()
    drive.answers = True
    drive.nmt_state = int(od.NmtState.OPERATIONAL)
    drive.controlword = int(od.Controlword.ENABLE_OPERATION)
    variable = drive.dictionary.get_variable(od.RATED_TORQUE, 0)
    stated = None if drive.axis.rated_torque or variable is None else variable.default
    rated_torque = agreed_rated_torque(drive.axis, stated, quirks_of(drive.axis.quirks).rated_torque_resolution)
    drive.scaling = axis_scaling(drive.axis, rated_torque)
