"""The peers of the cycle: python-can's stock virtual bus with bare frames, and the `canopen` package used by hand.

Both command a simulated drive that our rig has brought up and then left to them; what they hold is a spring-damper law
and nothing else: no account of energy, no limits, no log.
"""

import itertools
import struct
import threading
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from types import TracebackType
from typing import Literal, Self

import can
import canopen
from can.interfaces.virtual import VirtualBus

from canhaptic.canopen.eds import read_dictionary
from canhaptic.drive.can.bus_cycle import can_buses
from canhaptic.drive.can.link import Link
from canhaptic.drive.clock import Clock, VirtualClock, WallClock
from canhaptic.drive.rig import Rig
from canhaptic.scene.buses import can_bus
from canhaptic.scene.far_side import build_far_end
from canhaptic.scene.load import load_scene
from canhaptic.scene.parts import build_servo_drive
from canhaptic.sim.drive.can.drive_node import DrivesOnBus
from tools.bench.demo import CONFIG, COUNT, require_rendered

NODE = 1
SYNC, TPDO, RPDO = 0x080, 0x180 + NODE, 0x200 + NODE
ENABLE = 0x0F
RATED = 10.0  # [N]
STIFFNESS, DAMPING, WALL, SAMPLE_TIME = 100.0, 10.0, -0.05, 1e-3
TPDO_IMAGE, RPDO_IMAGE = struct.Struct("<Hih"), struct.Struct("<Hh")
NOTIFIER_CYCLE = 0.05  # [s]; only how long its stop takes
_NUMBERS = itertools.count()

OpenBus = Callable[[str], can.BusABC]
Law = Callable[[float, float], int]


def stock_bus(channel: str) -> can.BusABC:
    """Returns a connection to python-can's own virtual bus."""
    return VirtualBus(channel=channel, preserve_timestamps=True)


def law(position: float, last: float) -> int:
    """Returns the torque [per mille] of the plain sampled wall of the demo."""
    if position >= WALL:
        return 0
    force = -STIFFNESS * (position - WALL) - DAMPING * (position - last) / SAMPLE_TIME
    return max(-2000, min(2000, round(force / RATED * 1000.0)))


class BroughtUp:
    """The demo's simulated drive, enabled, and a connection to its bus for a peer.

    Args:
        pace: "free" (virtual time) or "real".
        open_bus: Opens a connection; both sides use it.
        overrides: Of the configuration.

    Attributes:
        bus: The connection that the rig has used for the start.
        far_side: The drive on its own connection.
        clock: Of the rig.
        patience: How long a peer may wait for a frame before it must let the drive live again [s].
        pause: How long it may sleep before that [s].
    """

    patience, pause = 0.0, 20e-6

    def __init__(
        self, pace: Literal["free", "real"], open_bus: OpenBus = stock_bus, overrides: Sequence[str] = ()
    ) -> None:
        # A peer sends no heartbeat of its own, so the drive must not wait for one.
        scene = load_scene(CONFIG, ("axes.0.watchdog=false", *overrides))
        channel = f"peer-{next(_NUMBERS)}"
        with ExitStack() as stack:
            far_bus = stack.enter_context(open_bus(channel))
            self.bus = stack.enter_context(open_bus(channel))
            self.far_side: DrivesOnBus = build_far_end(scene, None, far_bus)[0]
            sides = [self.far_side]
            self.clock: Clock = VirtualClock(sides) if pace == "free" else WallClock(sides)
            link = Link(self.bus, self.clock)
            drives = [build_servo_drive(axis, link, scene.bus) for axis in scene.axes]
            Rig(can_buses(link, drives, can_bus(scene.bus)), drives, scene.bus).start()
            self._stack = stack.pop_all()

    def process(self, now: int) -> None:
        """Lets the drive live up to `now` [ns]."""
        self.far_side.process(now)

    def check(self) -> None:
        """Makes sure that the loop did its job."""
        [drive] = self.far_side.drives
        require_rendered(drive)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.close()


class CanopenLoop:
    """The `canopen` package as its documentation shows it: a callback on the TPDO, a transmit on the RPDO."""

    def __init__(self, bus: can.BusABC, law: Law = law) -> None:
        self.bus, self.law = bus, law
        self.network = canopen.Network(bus)
        self.network.NOTIFIER_CYCLE = NOTIFIER_CYCLE
        node = canopen.RemoteNode(NODE, read_dictionary(CONFIG.parent.parent / "eds" / "cia402_servo.eds", NODE))
        self.network.add_node(node)
        self.tpdo, self.rpdo = node.tpdo[1], node.rpdo[1]
        self._map(self.tpdo, [0x6041, 0x6064, 0x6074], TPDO)
        self._map(self.rpdo, [0x6040, 0x6071], RPDO)
        self.tpdo.add_callback(self._on_tpdo)
        self.answered = threading.Event()
        self.last = 0.0

    @staticmethod
    def _map(pdo: canopen.pdo.PdoMap, objects: list[int], cob_id: int) -> None:
        pdo.clear()
        for index in objects:
            pdo.add_variable(index)
        pdo.cob_id, pdo.enabled = cob_id, True
        pdo.subscribe()

    def _on_tpdo(self, pdo: canopen.pdo.PdoMap) -> None:
        position = float(pdo.map[1].raw) * COUNT
        self.rpdo.map[0].raw = ENABLE
        self.rpdo.map[1].raw = self.law(position, self.last)
        self.rpdo.transmit()
        self.last = position
        self.answered.set()

    def begin(self) -> None:
        """Starts the Notifier, as `canopen.Network.connect` does."""
        self.network.notifier = can.Notifier(self.bus, self.network.listeners, self.network.NOTIFIER_CYCLE)

    def close(self) -> None:
        """Stops the Notifier; not part of the time."""
        assert self.network.notifier is not None
        self.network.notifier.stop(1.0)
