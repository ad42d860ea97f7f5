"""What a scene asks of EtherCAT: a line with its master, of drives in this process or on a wire."""

from contextlib import ExitStack

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


def line_on_wire(bus: EthercatBusParameters, clock: Clock, stack: ExitStack) -> EthercatBusCycle:
    """Return the line of the drives behind a network interface, which is closed with the stack.

    Args:
        bus: Parameters of the line.
        clock: Clock of every wait.
        stack: Closes the interface.

    Raises:
        InputError: pysoem is not installed.
        LinkError: The interface cannot be opened.
    """
    from canhaptic.drive.ethercat.with_pysoem import PysoemSegment

    segment = PysoemSegment(bus.interface, clock)
    stack.callback(segment.close)
    return EthercatBusCycle(segment, clock, bus)
