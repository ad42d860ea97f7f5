"""Opens the CAN buses of a scene through python-can, and wraps them in the effects that it names."""

import itertools
import os
from typing import TYPE_CHECKING, Any, Final, Literal

import can

from canhaptic.drive.axis_parameters import BusParameters
from canhaptic.errors import InputError
from canhaptic.host.interfaces import opening_error
from canhaptic.scene.models import Scene

if TYPE_CHECKING:
    from canhaptic.sim.bus.faulty_bus import FaultyBus

_ECHOING: Final = frozenset({"udp_multicast"})  # interfaces that return sent frames, with any setting
_SEEDS_APART: Final = 1_000_003  # from one bus to the next
_PRIVATE: Final = itertools.count()


def private_channel() -> str:
    """Return a channel of the virtual interface that nothing else in this process uses."""
    return f"canhaptic-{os.getpid()}-{next(_PRIVATE)}"


def echoes(bus: BusParameters) -> bool:
    """Return whether the interface gives back the frames that were sent through it."""
    return bus.interface in _ECHOING or bool(bus.options.get("receive_own_messages"))


def open_bus(bus: BusParameters, channel: str | int | None) -> can.BusABC:
    """Return one connection to the bus.

    Raises:
        InputError: python-can has no such interface, lacks its driver or library, or refuses an option.
        LinkError: The interface is there but cannot be opened: no such channel, no device, no permission.
    """
    if bus.interface == "virtual" and channel is not None and not bus.options:
        from canhaptic.sim.bus.virtual_bus import LeanVirtualBus

        return LeanVirtualBus(channel)
    options: dict[str, Any] = {"bitrate": bus.bitrate, **bus.options}
    if bus.interface == "virtual":
        options = {"preserve_timestamps": True, **bus.options}
    try:
        return can.Bus(interface=bus.interface, channel=channel, **options)
    except Exception as error:  # backends pass on any exception of their driver library
        raise opening_error(bus, channel, error) from error


def with_effects(bus: can.BusABC, scene: Scene, side: Literal["master", "drive"], index: int = 0) -> "FaultyBus":
    """Return a connection with the effects that a scene names on its buses.

    Args:
        bus: The connection as it was opened.
        scene: Has `bus_effects`.
        side: The side whose connection it is.
        index: Place of the bus among those of the scene.
    """
    from canhaptic.sim.bus.faulty_bus import FaultyBus

    if scene.bus_effects is None or scene.simulation is None:
        raise InputError(f"{scene.source}: names no effect on its bus (simulation.bus)")
    bitrate, seed = scene.buses[index].parameters.bitrate, scene.simulation.seed + _SEEDS_APART * index
    return FaultyBus(bus, scene.bus_effects, bitrate=bitrate, seed=seed, side=side)


def suffers(scene: Scene, name: str) -> bool:
    """Whether a scene names effects on the bus of this name."""
    effects = scene.bus_effects
    return effects is not None and (effects.buses is None or name in effects.buses)
