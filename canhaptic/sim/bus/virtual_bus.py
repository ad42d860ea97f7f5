"""A faster variant of python-can's virtual bus, for classic frames within one process.

It uses the same channels, so that any other `virtual` connection of the process can join. A frame is copied field by
field instead of by `copy.deepcopy`, it waits in a deque instead of behind a condition, and polling an empty bus costs
almost nothing: one frame takes 0.6 us instead of 6 to 10.
"""

from _thread import allocate_lock
from collections import deque
from contextlib import suppress
from queue import Empty
from typing import Any, Final, cast

import can
from can.interfaces.virtual import VirtualBus, channels_lock

from canhaptic.canopen.data_frame import DataFrame

_COPIED: Final = (
    *("timestamp", "arbitration_id", "is_extended_id", "is_remote_frame", "is_error_frame", "dlc", "is_fd"),
    *("bitrate_switch", "error_state_indicator"),
)


class _Frame(can.Message):
    """A message whose fields are set after its creation: the constructor of `Message` costs more than the rest."""

    __slots__ = ()
    __init__ = object.__init__


class _Inbox:
    """Queue of received frames for one reader, with the part of `queue.Queue` that the virtual bus uses.

    `queue.SimpleQueue` is unsafe here: in CPython 3.11 its `get` waits for ever when its thread is delayed for longer
    than the timeout just after it took the lock.
    """

    __slots__ = ("_bell", "frames")

    def __init__(self) -> None:
        self.frames: deque[can.Message] = deque()
        self._bell = allocate_lock()  # locked while nothing came since the taker began to wait

    def put(self, message: can.Message, block: bool = True, timeout: float | None = None) -> None:
        """Append a frame without waiting."""
        self.frames.append(message)
        if self._bell.locked():
            with suppress(RuntimeError):  # another sender was quicker
                self._bell.release()

    def get(self, block: bool = True, timeout: float | None = None) -> can.Message:
        """Take the first frame; wait up to `timeout` [s] for it, for ever if it is None.

        Raises:
            Empty: No frame came, or the wake-up was for a frame already taken: the caller waits again.
        """
        frames, ring = self.frames, self._bell.acquire
        if block and not frames:
            ring(False)
            if not frames:  # else it came before the bell could ring
                ring(True, -1 if timeout is None else max(0.0, timeout))
        if not frames:
            raise Empty
        return frames.popleft()


class LeanVirtualBus(VirtualBus):
    """A connection to the virtual bus: frames keep the time stamp of their sender, the receive queue has no limit.

    Args:
        channel: Name of the bus that connections share.

    Attributes:
        waiting: Received frames not yet taken. Looking here costs less than polling an empty bus; frames taken here
            pass no filter.
    """

    def __init__(self, channel: Any) -> None:
        super().__init__(channel=channel, preserve_timestamps=True)
        inbox = _Inbox()
        with channels_lock:
            self.channel[self.channel.index(self.queue)] = self.queue = cast(Any, inbox)
        self.waiting = inbox.frames

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Put the frame, or a copy if the sender may reuse it, into the queue of every other connection.

        Raises:
            can.CanOperationError: The connection was shut down.
        """
        if not self._open:
            self._check_if_open()
        own, connections = self.queue, self.channel
        if type(msg) is DataFrame and len(connections) == 2:  # handed over for good, and to one taker
            for queue in connections:
                if queue is not own:
                    queue.put(msg)
            return
        for queue in connections:
            if queue is not own:
                copy = _Frame()
                for name in _COPIED:
                    setattr(copy, name, getattr(msg, name))
                copy.channel, copy.data, copy.is_rx = self.channel_id, bytearray(msg.data), True
                queue.put(copy)

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """Return the next received frame, or None after `timeout` [s]; a timeout of None waits for ever.

        Raises:
            can.CanOperationError: The connection was shut down.
        """
        if self._open and self._filters is None:
            waiting = self.waiting
            if waiting:
                return waiting.popleft()
            if timeout == 0.0:
                return None
        return super().recv(timeout)  # waits on until the time is over
