"""A short run that presses on a guarded wall, with somebody on both ends of the bus: every frame is seen and can fail.

Only public seams are used: the connections that `open_bus` returns, the progress of the run and the simulated drive.
"""

import itertools
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple
from unittest.mock import patch

import can

from canhaptic.canopen.objects import NmtState
from canhaptic.drive.can.door import open_bus
from canhaptic.drive.safety.link_policy import StopReason
from canhaptic.errors import CanHapticError
from canhaptic.scene.build import Experiment, build
from canhaptic.scene.load import load_scene
from canhaptic.sim.bus.virtual_bus import LeanVirtualBus
from canhaptic.sim.drive.can.drive_node import SimulatedDrive
from tests.scene.test_code_process import CALM, scene_in

CONFIGS = Path(__file__).parents[2] / "configs"
WALL = ("environment={type: spring_damper_wall, stiffness: 800, damping: 2}", "simulation.user={damping: 5, push: -5}")
AT = 30  # cycles before the deed: the wall pushes back with 4 N by then
SYNC, HEARTBEATS = 0x80, range(0x701, 0x780)
_channels = itertools.count()
OnFrame = Callable[[can.Message], "can.Message | None"]


def as_it_is(message: can.Message) -> can.Message:
    return message


class Between:
    """A connection to the bus with somebody in between, who may change, drop or refuse each frame."""

    def __init__(self, bus: can.BusABC) -> None:
        self._bus = bus
        self.channel_id = getattr(bus, "channel_id", None)
        self.on_send: OnFrame = as_it_is
        self.on_receive: OnFrame = as_it_is

    def send(self, message: can.Message, timeout: float | None = None) -> None:
        if (changed := self.on_send(message)) is not None:
            self._bus.send(changed, timeout)

    def recv(self, timeout: float | None = None) -> can.Message | None:
        while (message := self._bus.recv(timeout)) is not None:
            if (changed := self.on_receive(message)) is not None:
                return changed
        return None

    def shutdown(self) -> None:
        self._bus.shutdown()


class Frame(NamedTuple):
    """A frame that the master sent or tried to send."""

    syncs: int  # sent before it, since the deed
    is_sent: bool  # whether the interface took it
    can_id: int
    data: bytes


@dataclass
class Edge:
    """The run as a deed sees it."""

    experiment: Experiment
    master: Between  # the master's connection
    far: Between  # that of the drive
    other: can.BusABC  # of somebody else
    frames: list[Frame] = field(default_factory=list)  # of the master, from the deed on
    syncs: int = 0
    is_done: bool = False
    wants_stop: bool = False  # of the operator
    last: bytes = bytes(4)  # RPDO that went out before the deed
    has_pressed: bool = False

    @property
    def was_pressing(self) -> bool:
        """Whether a torque was commanded when it was done."""
        return not _is_zero(self.last)

    @property
    def is_over(self) -> bool:
        """Whether the drives were stopped after a contact."""
        return self.has_pressed and self.drive.nmt_state is NmtState.PRE_OPERATIONAL

    @property
    def drive(self) -> SimulatedDrive:
        assert self.experiment.far_side is not None
        return self.experiment.far_side.drives[0]

    @property
    def rpdo(self) -> int:
        return 0x200 + self.drive.node_id

    @property
    def tpdo(self) -> int:
        return 0x180 + self.drive.node_id

    def sends(self, can_id: int, data: bytes | Sequence[int] = b"", **kind: bool) -> None:
        """Somebody else sends a frame."""
        frame = can.Message(arbitration_id=can_id, data=bytes(data), is_extended_id=False)
        for name, value in kind.items():
            setattr(frame, name, value)
        self.other.send(frame)


Deed = Callable[[Edge], object]


class Outcome(NamedTuple):
    """How a run ended."""

    reason: StopReason
    error: BaseException | None
    syncs_to_zero: int | None  # SYNCs between the deed and the zero torque after which none other was sent
    frames: list[Frame]
    edge: Edge
    result: dict[str, Any]  # the account; empty where it was lost

    @property
    def is_disabled_or_said(self) -> bool:
        """Whether the drive holds no torque and is disabled, or the error says that this is not known."""
        drive = self.edge.drive
        is_off = drive.torque == 0.0 and not drive.servo.is_powered
        return is_off or "not confirmed to be disabled" in str(self.error).lower()

    @property
    def is_zero_first(self) -> bool:
        """Whether a zero torque went out before every frame but SYNC, heartbeat and torques."""
        for frame in self.frames:
            if frame.can_id == self.edge.rpdo and _is_zero(frame.data):
                return True
            if frame.can_id not in (SYNC, *HEARTBEATS, self.edge.rpdo):
                return False
        return False


def pressed(
    deed: Deed = lambda edge: None,
    *changes: str,
    each: Deed = lambda edge: None,
    prepare: Deed = lambda edge: None,
    at: int = AT,
    cycles: int = 60,
    name: str = "demo.yaml",
    own: Path | None = None,
    energy_log: Path | None = None,
    bus_log: Path | None = None,
) -> Outcome:
    """How a run ends in which something is done after `at` cycles.

    Args:
        deed: What is done, once.
        changes: Overrides of the scene.
        each: What is done after every later cycle.
        prepare: What is done before the run.
        at: Cycles before the deed; 0: before the start.
        cycles: Cycles of the run.
        name: File of the scene.
        own: Folder for a scene whose environment is code in a process of its own; None: no such code.
        energy_log: Energy log to write.
        bus_log: Bus log to write.
    """
    channel = f"bus.channel=edge-{next(_channels)}"
    if own is not None:
        scene = scene_in(own, CALM, WALL[1], "environment.position=0", channel, *changes)
    else:
        scene = load_scene(CONFIGS / name, (*(WALL if name == "demo.yaml" else ()), channel, *changes))
    ends: list[Between] = []

    def opened(bus: Any, channel: Any) -> Any:
        ends.append(Between(open_bus(bus, channel)))
        return ends[-1]

    with ExitStack() as stack:
        with patch("canhaptic.drive.can.door.open_bus", opened):
            experiment = build(scene, "free", energy_log, bus_log)
        stack.callback(_closed, experiment)
        other = LeanVirtualBus(scene.bus.channel)
        stack.callback(other.shutdown)
        edge = Edge(experiment, ends[1], ends[0], other)
        _watch(edge)
        prepare(edge)

        def progress(done: int) -> None:
            other.waiting.clear()
            if done == at:
                edge.is_done = True
                deed(edge)
            elif done > at:
                each(edge)

        if at == 0:
            edge.is_done = True
            deed(edge)
        result, error = _ended(edge, cycles, progress)
    return Outcome(experiment.rig.stop_reason, error, _syncs_to_zero(edge), edge.frames, edge, result)


def _ended(edge: Edge, cycles: int, progress: Callable[[int], None]) -> tuple[dict[str, Any], BaseException | None]:
    try:
        result, error = edge.experiment.run_through(cycles, lambda: edge.wants_stop, progress)
    except Exception as raised:
        return {}, raised
    return dict(result), error


def _closed(experiment: Experiment) -> None:
    with suppress(CanHapticError):  # the first call raised it
        experiment.close()


def _watch(edge: Edge) -> None:
    """Note what the master sends, before anybody else sees it."""
    send = edge.master.send

    def noted(message: can.Message, timeout: float | None = None) -> None:
        can_id, data, is_sent = message.arbitration_id, bytes(message.data), False
        try:
            send(message, timeout)
            is_sent = True
        finally:
            if not edge.is_done and can_id == edge.rpdo:
                edge.last = data
                edge.has_pressed |= not _is_zero(data)
            if edge.is_done:
                edge.frames.append(Frame(edge.syncs, is_sent, can_id, data))
                edge.syncs += is_sent and can_id == SYNC

    edge.master.send = noted


def _is_zero(rpdo: bytes) -> bool:
    """Whether an RPDO asks for no torque, or for no velocity of a display: what follows the controlword."""
    return not any(rpdo[2:])


def _syncs_to_zero(edge: Edge) -> int | None:
    zero = None
    for frame in edge.frames:
        if frame.can_id == edge.rpdo:
            if not _is_zero(frame.data):
                zero = None
            elif zero is None and frame.is_sent:
                zero = frame.syncs
    return zero
