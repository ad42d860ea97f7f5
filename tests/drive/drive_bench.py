"""A master and simulated drives in lock-step on a private virtual bus, with every frame recorded."""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import can
from canopen import ObjectDictionary

from canhaptic.canopen.eds import read_dictionary
from canhaptic.drive.axis_parameters import AxisParameters, CanBusParameters
from canhaptic.drive.can.bus_cycle import can_buses
from canhaptic.drive.can.link import Link
from canhaptic.drive.can.servo_drive import ServoDrive
from canhaptic.drive.clock import VirtualClock
from canhaptic.drive.rig import Rig
from canhaptic.signals import PlantEnergy
from canhaptic.sim.bus.virtual_bus import LeanVirtualBus
from canhaptic.sim.drive import SimulatedDriveParameters
from canhaptic.sim.drive.can.drive_node import DrivesOnBus, SimulatedDrive

REPOSITORY = Path(__file__).resolve().parent.parent.parent
OUR_EDS = REPOSITORY / "eds" / "cia402_servo.eds"
RATED_TORQUE = 10.0  # [N]
COUNTS_PER_UNIT = 1e5
_channels = itertools.count()


class FreeMass:
    """A motor that is a free mass of 1 kg, not held; starts at 10 mm."""

    def __init__(self) -> None:
        self.position, self.velocity, self.time = 0.01, 0.0, 0

    def begin(self, now: int) -> None:
        self.time = now

    def advance_to(self, now: int, torque: float) -> None:
        elapsed = (now - self.time) * 1e-9
        self.position += elapsed * (self.velocity + 0.5 * torque * elapsed)
        self.velocity += torque * elapsed
        self.time = now

    def energy(self) -> PlantEnergy:
        return PlantEnergy(0.0, 0.0, 0.0, 0.0)


class TamperedBus:
    """The master's connection with somebody in between: `on_receive` and `on_send` see, change or drop frames."""

    def __init__(self, bus: can.BusABC) -> None:
        self.inner = bus
        self.on_receive: Callable[[can.Message], can.Message | None] = lambda message: message
        self.on_send: Callable[[can.Message], can.Message | None] = lambda message: message

    def recv(self, timeout: float | None = None) -> can.Message | None:
        while (message := self.inner.recv(timeout)) is not None:
            if (changed := self.on_receive(message)) is not None:
                return changed
        return None

    def send(self, message: can.Message, timeout: float | None = None) -> None:
        if (changed := self.on_send(message)) is not None:
            self.inner.send(changed, timeout)

    def shutdown(self) -> None:
        self.inner.shutdown()

    def answer(self, request_start: str, replace_with: str) -> None:
        """Replaces the SDO answers that begin with the bytes `request_start` (hexadecimal)."""
        start, data = bytes.fromhex(request_start), bytearray.fromhex(replace_with)

        def tamper(message: can.Message) -> can.Message:
            if 0x580 < message.arbitration_id < 0x600 and bytes(message.data).startswith(start):
                message.data = data
            return message

        self.on_receive = tamper

    def drop(self, *can_ids: int) -> None:
        """Drops every frame with one of these COB-IDs on its way to the master."""
        self.on_receive = lambda message: None if message.arbitration_id in can_ids else message


@dataclass
class Bench:
    """Everything that a test looks at."""

    rig: Rig
    links: list[Link]
    clock: VirtualClock
    tampered: TamperedBus
    drives: list[SimulatedDrive]
    buses: list[can.BusABC]
    frames: list[tuple[int, int, bytes, bool]] = field(default_factory=list)

    def sent(self, can_id: int) -> list[bytes]:
        """Data of every frame of the master with this COB-ID."""
        return [data for _, frame_id, data, is_rx in self.frames if frame_id == can_id and not is_rx]

    def received(self, can_id: int) -> list[bytes]:
        """Data of every frame that reached the master with this COB-ID."""
        return [data for _, frame_id, data, is_rx in self.frames if frame_id == can_id and is_rx]

    def torques_sent(self, can_id: int = 0x205) -> list[int]:
        """Target torques of every RPDO, decoded by hand from bytes 2 and 3."""
        return [int.from_bytes(data[2:4], "little", signed=True) for data in self.sent(can_id)]

    def run(self, cycles: int, torque: float = 0.0) -> list[Any]:
        """Runs cycles with a constant torque on every axis and returns the samples of the first."""
        samples = []
        for _ in range(cycles):
            samples.append(self.rig.sync()[0])
            self.rig.write_torques([torque] * len(self.rig.drives))
        return samples

    def close(self) -> None:
        for bus in self.buses:
            bus.shutdown()


MakeBench = Callable[..., Bench]
"""`make_bench`, of whose benches a fixture takes care."""


def started(make: MakeBench, *arguments: object, **values: object) -> Bench:
    """A bench whose rig runs."""
    bench = make(*arguments, **values)
    bench.rig.start()
    return bench


def axis(node_id: int = 5, **values: Any) -> AxisParameters:
    """Parameters of an axis of 10 N rated, limited to 8 N."""
    defaults = {
        "name": f"axis{node_id}",
        "node_id": node_id,
        "eds": OUR_EDS,
        "unit": "m",
        "counts_per_unit": COUNTS_PER_UNIT,
        "rated_torque": RATED_TORQUE,
        "torque_limit": 8.0,
    }
    return AxisParameters(**{**defaults, **values})


def dictionary(parameters: AxisParameters) -> ObjectDictionary:
    """The dictionary of an axis."""
    return read_dictionary(parameters.eds, parameters.node_id)


def private_channel() -> str:
    """A channel that no other test of this process uses."""
    return f"drive-test-{next(_channels)}"


def make_bench(
    axes: Sequence[AxisParameters] | None = None,
    bus: dict[str, Any] | None = None,
    objects: dict[str | int, Any] | None = None,
    *,
    absent: bool = False,
    keeps_objects: bool = False,
    drive_values: dict[str, Any] | None = None,
    dry_run: bool = False,
) -> Bench:
    """Builds a rig and its simulated drives, one bus, nothing started.

    Args:
        axes: One drive is made for each.
        bus: Overrides of the bus parameters.
        objects: Values of the simulated drives' objects.
        absent: Leaves the drives away.
        keeps_objects: Gives the simulated drives no values but those of their dictionary and of `objects`.
        drive_values: Further parameters of the simulated drives.
        dry_run: Builds the master's drives for a run without torque.
    """
    axes = axes or [axis()]
    parameters = CanBusParameters(**{"rate": 1000.0, **(bus or {})})
    channel = private_channel()
    buses: list[can.BusABC] = [LeanVirtualBus(channel) for _ in range(len(axes) + 1)]
    simulated = [
        SimulatedDrive(
            connection,
            a.node_id,
            dictionary(a),
            FreeMass(),
            SimulatedDriveParameters(
                counts_per_unit=a.counts_per_unit,
                objects={**({} if keeps_objects else {0x6502: 0x3FF, 0x1000: 0x00020192}), **(objects or {})},
                **{"rated_torque": RATED_TORQUE, **(drive_values or {})},
            ),
            parameters.sample_time_ns,
        )
        for a, connection in zip(axes, buses[1:], strict=True)
    ]
    far_sides = [DrivesOnBus(connection, (drive,)) for connection, drive in zip(buses[1:], simulated, strict=True)]
    clock = VirtualClock([] if absent else far_sides)
    frames: list[tuple[int, int, bytes, bool]] = []
    tampered = TamperedBus(buses[0])
    link = Link(
        tampered,  # type: ignore[arg-type]
        clock,
        lambda time, can_id, data, is_rx: frames.append((time, can_id, bytes(data), is_rx)),
    )
    drives = [ServoDrive(link, a, dictionary(a), parameters, dry_run=dry_run) for a in axes]
    return Bench(
        Rig(can_buses(link, drives, parameters), drives, parameters), [link], clock, tampered, simulated, buses, frames
    )
