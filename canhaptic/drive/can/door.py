"""What a scene asks of CAN: connections to its buses, and links, drives and cycles on them."""

import itertools
import os
from contextlib import ExitStack
from typing import Any, Final

import can

from canhaptic.canopen.eds import DriveDictionary
from canhaptic.drive.axis_parameters import AxisParameters, CanBusParameters
from canhaptic.drive.can.link import Link, Recorder
from canhaptic.drive.can.servo_drive import ServoDrive
from canhaptic.drive.clock import Clock
from canhaptic.host.interfaces import opening_error
from canhaptic.registry import load

_ECHOING: Final = frozenset({"udp_multicast"})  # interfaces that return sent frames, with any setting
_LEAN: Final = {"virtual": "canhaptic.sim.bus.virtual_bus:LeanVirtualBus"}
_PRIVATE: Final = itertools.count()


def private_channel() -> str:
    """Return a channel of the virtual interface that is unused in this process."""
    return f"canhaptic-{os.getpid()}-{next(_PRIVATE)}"


def with_channel(bus: CanBusParameters) -> CanBusParameters:
    """Return the parameters with a channel: a private one of the virtual interface where none is given."""
    is_complete = bus.channel is not None or bus.interface != "virtual"
    return bus if is_complete else bus.model_copy(update={"channel": private_channel()})


def open_bus(bus: CanBusParameters, channel: str | int | None) -> can.BusABC:
    """Return one connection to the bus.

    Raises:
        InputError: python-can has no such interface, lacks its driver or library, or refuses an option.
        LinkError: The interface is there but cannot be opened: no such channel, no device, no permission.
    """
    if bus.interface == "virtual" and channel is not None and not bus.options:
        lean: can.BusABC = load(_LEAN, "virtual", "bus")(channel)
        return lean
    options: dict[str, Any] = {"bitrate": bus.bitrate, **bus.options}
    if bus.interface == "virtual":
        options = {"preserve_timestamps": True, **bus.options}
    try:
        return can.Bus(interface=bus.interface, channel=channel, **options)
    except Exception as error:  # backends pass on any exception of their driver library
        raise opening_error(bus, channel, error) from error


def opened(bus: CanBusParameters, stack: ExitStack) -> can.BusABC:
    """Return one connection to the bus on its own channel, closed with the stack; raise as `open_bus`."""
    connection = open_bus(bus, bus.channel)
    stack.callback(connection.shutdown)
    return connection


def link_on(
    connection: can.BusABC, clock: Clock, bus: CanBusParameters, stack: ExitStack, recorder: Recorder | None
) -> Link:
    """Return the master's end of a bus.

    Args:
        connection: Connection to the bus.
        clock: Clock of every wait.
        bus: Parameters of the bus.
        stack: Not needed: the connection is closed already.
        recorder: Called with every frame.
    """
    echoes = bus.interface in _ECHOING or bool(bus.options.get("receive_own_messages"))
    return Link(connection, clock, recorder, echoes=echoes)


def drive_on(
    link: Link, axis: AxisParameters, dictionary: DriveDictionary, bus: CanBusParameters, *, dry_run: bool,
    lateness: float,
) -> ServoDrive:  # fmt: skip
    """Return the master's image of the drive of one axis, in its mode of operation."""
    if axis.admittance is None:
        return ServoDrive(link, axis, dictionary, bus, dry_run=dry_run, lateness=lateness)
    from canhaptic.drive.can.motion_drive import CanMotionDrive

    return CanMotionDrive(link, axis, dictionary, bus)
