"""What a scene asks of EtherCAT: a line with its master."""

from canhaptic.drive.clock import Clock
from canhaptic.drive.ethercat.bus_cycle import EthercatBusCycle
from canhaptic.drive.ethercat.parameters import EthercatBusParameters
from canhaptic.drive.ethercat.thin_master import Line, ThinMaster


def line_on(cable: Line, clock: Clock, bus: EthercatBusParameters) -> EthercatBusCycle:
    """Return the line of the drives on a cable in this process.

    Args:
        cable: Carries the frames.
        clock: Clock of every wait.
        bus: Parameters of the line.
    """
    return EthercatBusCycle(ThinMaster(cable, clock), clock, bus)
