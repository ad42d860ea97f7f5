"""Several simulated drives on one connection to the bus: each frame is received, and copied, once. Several buses."""

from collections import deque
from collections.abc import Callable, Sequence, Sized
from functools import partial
from typing import Protocol

import can

from canhaptic.sim.drive.can.drive_node import SimulatedDrive
from canhaptic.sim.drive.can.process_data import Handler
from canhaptic.sim.drive.timers import NEVER


class Drives(Protocol):
    """Simulated drives of a rig, on one bus or several (a `SimulatedPeer`)."""

    drives: tuple[SimulatedDrive, ...]

    def process(self, now: int) -> None:
        """Handle all frames and timers of all drives up to `now` [ns]."""

    def next_due(self) -> int:
        """Return when the next of them is due [ns]."""


class DriveGroup:
    """Drives that share a bus connection (a `SimulatedPeer`) and do not receive each other's frames: no drive needs to.

    Args:
        bus: The connection that the drives were made with.
        drives: Each with a node ID of its own.
    """

    def __init__(self, bus: can.BusABC, drives: Sequence[SimulatedDrive]) -> None:
        self._waiting: Sized = "unknown"  # empty only where the bus shows what waits
        self._take: Callable[[], can.Message | None] = partial(bus.recv, 0.0)
        if isinstance(waiting := getattr(bus, "waiting", None), deque):
            self._waiting, self._take = waiting, waiting.popleft
        self.drives = tuple(drives)
        self._asleep = list(self.drives)
        self._hearers: dict[int, tuple[tuple[SimulatedDrive, Handler], ...]] = {}  # by COB-ID
        for drive in self.drives:
            drive.on_routes_changed = self._hearers.clear

    def process(self, now: int, message: can.Message | None = None) -> None:
        """Handle every frame waiting on the bus and every timer due up to `now` [ns].

        Args:
            now: Time [ns].
            message: Frame already received; None if there is none.
        """
        while self._asleep:
            self._asleep.pop(0).wake(now)
        take, waiting = self._take, self._waiting
        while message is not None or (waiting and (message := take()) is not None):
            if not (message.is_extended_id or message.is_remote_frame or message.is_error_frame):
                hearers = self._hearers.get(message.arbitration_id)
                if hearers is None:
                    hearers = self._find_hearers(message.arbitration_id)
                for drive, handler in hearers:
                    servo = drive.servo
                    servo.now = now
                    handler(message.data)
                    if servo.has_event or servo.fault_code:
                        drive.follow_up()
            message = None
        for drive in self.drives:
            if now >= drive.timers.earliest:
                drive.run_timers(now)

    def _find_hearers(self, cob_id: int) -> tuple[tuple[SimulatedDrive, Handler], ...]:
        handlers = [(drive, drive.handler(cob_id)) for drive in self.drives]
        hearers = self._hearers[cob_id] = tuple((drive, handler) for drive, handler in handlers if handler is not None)
        return hearers

    def next_due(self) -> int:
        """Return when the next timer of any drive is due [ns]."""
        earliest = NEVER
        for drive in self.drives:
            due = drive.timers.next_due()
            if due < earliest:
                earliest = due
        return earliest


class DriveGroups:
    """The drives of several buses (a `SimulatedPeer`).

    Args:
        groups: One per bus.
        drives: All of them, in the order of the axes.
    """

    def __init__(self, groups: Sequence[DriveGroup], drives: Sequence[SimulatedDrive]) -> None:
        self._groups = tuple(groups)
        self.drives = tuple(drives)

    def process(self, now: int) -> None:
        """Handle every frame waiting on each bus and every timer due up to `now` [ns]."""
        for group in self._groups:
            group.process(now)

    def next_due(self) -> int:
        """Return when the next timer of any drive is due [ns]."""
        return min((group.next_due() for group in self._groups), default=NEVER)
