"""Opens the CAN buses of a scene through python-can."""

import itertools
import os
from typing import Any, Final

import can

from canhaptic.drive.parameters import BusParameters
from canhaptic.errors import InputError, LinkError

_ECHOING: Final = frozenset({"udp_multicast"})  # interfaces that give back what was sent, whatever they are told
_PRIVATE: Final = itertools.count()


def private_channel() -> str:
    """Returns a channel of the virtual interface that nothing else in this process uses."""
    return f"canhaptic-{os.getpid()}-{next(_PRIVATE)}"


def echoes(bus: BusParameters) -> bool:
    """Returns whether the interface gives back the frames that were sent through it."""
    return bus.interface in _ECHOING


def open_bus(bus: BusParameters, channel: str | int | None) -> can.BusABC:
    """Returns one connection to the bus.

    Raises:
        InputError: python-can has no such interface, lacks its driver or library, or refuses an option.
        LinkError: The interface is there but cannot be opened: no such channel, no device, no permission.
    """
    options: dict[str, Any] = {"bitrate": bus.bitrate, **bus.options}
    if bus.interface == "virtual":
        options = {"preserve_timestamps": True, **bus.options}
    place = f"bus {bus.interface!r}, channel {channel!r}"
    try:
        return can.Bus(interface=bus.interface, channel=channel, **options)
    except (can.CanInterfaceNotImplementedError, ImportError, TypeError, ValueError) as error:
        raise InputError(
            f"{place}: python-can cannot use it ({error}); correct bus.interface, bus.channel and bus.options, "
            "or install what the interface needs"
        ) from error
    except (can.CanError, OSError) as error:
        raise LinkError(
            f"{place}: cannot be opened ({error}); is the interface up, its bit rate {bus.bitrate} and its device free?"
        ) from error
