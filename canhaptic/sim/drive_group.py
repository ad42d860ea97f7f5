"""Several simulated drives on one connection to the bus: each frame is received, and copied, once."""

from collections.abc import Sequence

import can

from canhaptic.sim.drive_node import SimulatedDrive
from canhaptic.sim.timers import NEVER


class DriveGroup:
    """Drives that share a bus connection (a `FarSide`); they do not hear each other, as no drive needs to.

    Args:
        bus: The connection that the drives were made with.
        drives: Each with a node ID of its own.
    """

    def __init__(self, bus: can.BusABC, drives: Sequence[SimulatedDrive]) -> None:
        self._bus = bus
        self.drives = tuple(drives)

    def process(self, now: int) -> None:
        """Handles every frame waiting on the bus and every timer due up to `now` [ns]."""
        receive, drives = self._bus.recv, self.drives
        for drive in drives:
            drive.wake(now)
        while (message := receive(0)) is not None:
            for drive in drives:
                drive.take(message, now)
        for drive in drives:
            drive.run_timers(now)

    def next_due(self) -> int:
        """Returns when the next timer of any drive is due [ns]."""
        return min((drive.next_due() for drive in self.drives), default=NEVER)
