"""A rig on a line of simulated EtherCAT drives, in virtual time."""

from collections.abc import Sequence
from typing import Any

from canhaptic.drive.clock import VirtualClock
from canhaptic.drive.ethercat.bus_cycle import EthercatBusCycle
from canhaptic.drive.ethercat.parameters import EthercatAxisParameters, EthercatBusParameters
from canhaptic.drive.ethercat.servo_drive import EthercatDrive
from canhaptic.drive.ethercat.thin_master import ThinMaster
from canhaptic.drive.rig import Rig
from canhaptic.sim.drive.ethercat.cable import Cable, CableEffects
from canhaptic.sim.drive.ethercat.drive_node import ClockParameters
from tests.sim_drive.drive_on_bus import TRAITS
from tests.sim_drive.ethercat_line import PERIOD, dictionary_of, make_drive

FILE = TRAITS / "ethercat_servo.eds"


class Bench:
    """Drives on a cable, and a rig on them.

    Args:
        count: Number of drives.
        drift: Rate of their clocks [ppb]; each runs 30 ppm slower than the one before.
        effects: Faults of frames.
        axis: Keys of every axis.
        bus: Keys of the line.
        drive: Keys of every simulated drive.
        clocks: Clocks of the drives; None: by `drift`.
    """

    def __init__(
        self, count: int = 1, drift: int = 0, effects: CableEffects | None = None, axis: Any = None, drive: Any = None,
        clocks: Sequence[ClockParameters] | None = None, **bus: Any,
    ) -> None:  # fmt: skip
        clocks = clocks or [ClockParameters(drift - 30_000 * n if drift else 0, 123_456_789 * n) for n in range(count)]
        self.drives = [make_drive(clock, **(drive or {})) for clock in clocks]
        self.cable = Cable(self.drives, PERIOD, effects, seed=1)
        self.clock = VirtualClock((self.cable,))
        self.cable.use(self.clock)
        parameters = EthercatBusParameters(**{"type": "ethercat", "rate": 1e9 / PERIOD, **bus})
        self.line = EthercatBusCycle(ThinMaster(self.cable, self.clock), self.clock, parameters)
        given = {"esi": FILE, "counts_per_unit": 1e4, "torque_limit": 10.0, "rated_torque": 100.0, **(axis or {})}
        axes = [EthercatAxisParameters(**{"name": f"axis{n}", "position": n, **given}) for n in range(count)]
        self.axes = [EthercatDrive(self.line, of, dictionary_of(FILE, 1)) for of in axes]
        self.rig = Rig([self.line], self.axes, parameters)

    def run(self, cycles: int, *torques: float) -> None:
        self.rig.start()
        for _ in range(cycles):
            self.rig.sync()
            self.rig.write_torques(torques)
        self.rig.stop()
