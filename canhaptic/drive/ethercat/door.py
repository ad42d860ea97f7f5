"""What a scene asks of EtherCAT: a line with its master, of drives in this process or on a wire, and its drives."""

from collections.abc import Sequence
from contextlib import ExitStack

from canhaptic.canopen.objects import Dictionary
from canhaptic.drive.clock import Clock
from canhaptic.drive.ethercat.bus_cycle import EthercatBusCycle
from canhaptic.drive.ethercat.parameters import EthercatAxisParameters, EthercatBusParameters
from canhaptic.drive.ethercat.servo_drive import EthercatDrive
from canhaptic.drive.ethercat.thin_master import Line, ThinMaster


def line_on(
    cable: Line | None, clock: Clock, bus: EthercatBusParameters, stack: ExitStack, _: object
) -> EthercatBusCycle:
    """Return the line of the drives on a cable, or of those behind a network interface.

    Args:
        cable: Carries the frames in this process; None: the interface does.
        clock: Clock of every wait.
        bus: Parameters of the line.
        stack: Closes the interface.

    Raises:
        InputError: pysoem is not installed.
        LinkError: The interface cannot be opened.
    """
    if cable is not None:
        return EthercatBusCycle(ThinMaster(cable, clock), clock, bus)
    from canhaptic.drive.ethercat.with_pysoem import PysoemSegment

    segment = PysoemSegment(bus.interface, clock)
    stack.callback(segment.close)
    return EthercatBusCycle(segment, clock, bus)


def drive_on(
    line: EthercatBusCycle, axis: EthercatAxisParameters, dictionary: Dictionary, _: object, *, dry_run: bool,
    lateness: float,
) -> EthercatDrive:  # fmt: skip
    """Return the master's image of the drive of one axis, in its mode of operation."""
    if axis.admittance is None:
        return EthercatDrive(line, axis, dictionary, dry_run=dry_run, lateness=lateness)
    from canhaptic.drive.ethercat.motion_drive import EthercatMotionDrive

    return EthercatMotionDrive(line, axis, dictionary, dry_run=dry_run)


def cycles_of(line: EthercatBusCycle, *_: object) -> Sequence[EthercatBusCycle]:
    """Return the line, which is a bus of the cycle itself."""
    return (line,)
