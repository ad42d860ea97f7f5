"""The master's end of one CAN bus: every frame it sends or receives passes here, in the caller's thread.

There is no Notifier and no callback thread: the caller that waits pumps the bus and gets the exceptions of handlers.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

import can

from canhaptic.canopen.data_frame import DataFrame
from canhaptic.drive.clock import Clock, WallClock
from canhaptic.errors import LinkError
from canhaptic.host.stop_signal import is_urgent, require_none

_Handler = Callable[[bytearray], None]
Recorder = Callable[[int, int, bytes | bytearray, bool], None]
"""Called as recorder(timestamp [ns], COB-ID, data, is_rx) for every frame."""

_LOOK: Final = 20_000_000  # [ns] between two looks for a signal
_URGENT: Final = 20_000_000  # [ns]: the longest wait for a confirmation once a second signal came
_MOST_FRAMES_AT_ONCE: Final = 10_000  # a bus that delivers this many frames at one instant is broken


@dataclass(slots=True)
class _LinkStatistics:
    """Counts since the link was made. A received frame that is also counted as late, short or the like is not used."""

    duplicate: int = 0  # second TPDO for one SYNC
    echoed: int = 0  # our own frame, given back by the interface
    error_frames: int = 0
    foreign: int = 0  # COB-ID without a receiver, remote frame, or extended identifier
    late: int = 0  # TPDO outside the window of its SYNC, SDO answer after its time
    received: int = 0  # every frame received, used or not
    send_failures: int = 0
    sent: int = 0
    short: int = 0  # data of another length than the map has


class Link:
    """Sends and receives through a python-can bus, by a clock.

    Args:
        bus: The bus; the caller shuts it down.
        clock: Clock for every wait.
        recorder: Called with every frame, for the bus log.
        echoes: Whether the interface also delivers the frames that it sends (`udp_multicast` does).

    Attributes:
        is_starting: Whether a rig on this bus is being started.
        intruder: Name of the first frame from another sender that only this master may send; empty without one.
        keep_alive: Function that `wait_for` calls while it waits: it sends what is due and returns when the next is due
            [ns]. None: nothing is sent while waiting.
    """

    def __init__(
        self, bus: can.BusABC, clock: Clock, recorder: Recorder | None = None, *, echoes: bool = False
    ) -> None:
        self.clock = clock
        self.statistics = _LinkStatistics()
        self._bus, self._recorder, self._echoes = bus, recorder, echoes
        self._handlers: dict[int, _Handler] = {}
        self._now, self._receive = clock.now, clock.receive
        self._channel = getattr(bus, "channel_id", None)
        self._not_returned: dict[int, int] = {}  # by COB-ID: frames sent that the interface has not given back
        self._own: Mapping[int, str] = {}
        self.intruder, self.is_starting = "", False
        self._is_slow = isinstance(clock, WallClock)  # a wait takes its time, and a signal may come meanwhile
        self.keep_alive: Callable[[], int] | None = None

    def reserve(self, names: Mapping[int, str]) -> None:
        """Set the COB-IDs that only this master may send, and clear the intruder."""
        self._own, self.intruder = names, ""

    def subscribe(self, can_id: int, handler: _Handler) -> None:
        """Call `handler(data)` for each frame of this COB-ID from now on, replacing any earlier handler."""
        self._handlers[can_id] = handler

    def unsubscribe(self, can_id: int) -> None:
        """Remove the handler of this COB-ID; its frames then count as foreign."""
        self._handlers.pop(can_id, None)

    def send(self, can_id: int, data: bytes) -> int:
        """Send one data frame.

        Returns:
            Timestamp of the frame in the bus log [ns].

        Raises:
            LinkError: The interface refused the frame twice (a full queue, ENOBUFS, bus-off).
        """
        message = DataFrame()
        message.timestamp = self._now() * 1e-9
        message.arbitration_id = can_id
        message.channel = self._channel
        message.data = bytearray(data)
        message.dlc = len(data)
        try:
            self._bus.send(message)
        except (can.CanError, OSError):
            self._send_again(message)
        now = self._now()  # a full queue or a stalled host may have held it up
        self.statistics.sent += 1
        if self._echoes:
            self._not_returned[can_id] = self._not_returned.get(can_id, 0) + 1
        record = self._recorder
        if record is not None:
            record(now, can_id, data, False)
        return now

    def request(self, can_id: int) -> None:
        """Send one remote frame; the bus log holds its answer only.

        Raises:
            LinkError: The interface refused the frame twice.
        """
        message = can.Message(arbitration_id=can_id, is_extended_id=False, is_remote_frame=True, dlc=1)
        message.timestamp = self._now() * 1e-9
        try:
            self._bus.send(message)
        except (can.CanError, OSError):
            self._send_again(message)
        self.statistics.sent += 1
        if self._echoes:
            self._not_returned[can_id] = self._not_returned.get(can_id, 0) + 1

    def _send_again(self, message: can.Message) -> None:
        self.statistics.send_failures += 1
        try:
            self._bus.send(message)
        except (can.CanError, OSError) as error:
            remedy = "check the cable, the bit rate and the length of the interface's queue (ip link set CHANNEL "
            text = f"frame {message.arbitration_id:#05x} was not sent: {error}; {remedy}txqueuelen 1000)"
            raise LinkError(text) from error

    def poll(self, deadline: int) -> bool:
        """Take the next frame and hand it to its handler; return False when none came until `deadline` [ns].

        Raises:
            LinkError: The interface failed.
        """
        try:
            message = self._receive(self._bus, deadline)
        except (can.CanError, OSError) as error:
            raise LinkError(f"the bus cannot be read: {error}; check cable and interface") from error
        if message is None:
            return False
        self.statistics.received += 1
        can_id = message.arbitration_id
        handler = self._handlers.get(can_id)
        if handler is None or message.is_extended_id or message.is_remote_frame or message.is_error_frame:
            self._put_aside(message)
            return True
        record, data = self._recorder, message.data
        if record is not None:
            record(self._now(), can_id, data, True)
        handler(data)
        return True

    def pump(self, deadline: int) -> None:
        """Handle frames until `deadline` [ns], then those still waiting.

        Raises:
            LinkError: The bus failed, or frames come without end.
        """
        while self.poll(deadline):
            if self._now() >= deadline:
                self.drain()
                return

    def drain(self) -> None:
        """Handle the frames that are waiting.

        Raises:
            LinkError: Frames come without end.
        """
        now = self.clock.now()
        for _ in range(_MOST_FRAMES_AT_ONCE):
            if not self.poll(now):
                return
        raise LinkError(f"more than {_MOST_FRAMES_AT_ONCE} frames wait at one instant; something floods the bus")

    def wait_for(self, condition: Callable[[], bool], timeout: int) -> bool:
        """Handle frames until `condition()` holds; return False when `timeout` [ns] passed first.

        Frames received before the call count: the condition looks at state, not at the next frame. A second signal
        shortens the wait, and during a start the first one ends it with StartStoppedError.
        """
        deadline = self.clock.now() + timeout
        while not condition():
            if self.is_starting:
                require_none()
            now = self.clock.now()
            if is_urgent():
                deadline = min(deadline, now + _URGENT)
            look = min(deadline, now + _LOOK) if self._is_slow else deadline
            if self.keep_alive is not None:
                look = min(look, self.keep_alive())
            if not self.poll(look) and look == deadline:
                return condition()
        return True

    def _put_aside(self, message: can.Message) -> None:
        """Count a frame without a handler; the bus log still shows it."""
        if message.is_error_frame:
            self.statistics.error_frames += 1
            return
        can_id = message.arbitration_id
        if self._not_returned.get(can_id):
            self._not_returned[can_id] -= 1
            self.statistics.echoed += 1
            return
        self.statistics.foreign += 1
        if message.is_remote_frame or can_id > 0x7FF:
            return
        if can_id in self._own and not message.is_extended_id:
            self.intruder = self.intruder or f"{self._own[can_id]} (COB-ID {can_id:#05x})"
        if self._recorder is not None:
            self._recorder(self.clock.now(), can_id, message.data, True)
