"""The drives' side of a recording: returns the recorded response to each frame of the master, compared first."""

from collections import deque
from collections.abc import Sequence
from typing import Final, NamedTuple

import can

from canhaptic.replay.recording import Recording

NEVER: Final = 1 << 62  # [ns]


class ReplayOverError(BaseException):
    """Ends the run: the recording is at its end, or the master departed from it.

    Not an `Exception`: no handler on the way out may treat it as a fault of drive or link and go on sending.
    """


class _Departure(NamedTuple):
    """The first frame in which the master departs from the recording."""

    place: int  # index of the recorded frame
    bus: int  # that the frame was sent on
    can_id: int  # of the frame sent instead
    data: bytes


class RecordedSide:
    """Plays the frames that the master did not send (a `SimulatedPeer`), and compares its frames but its heartbeats.

    Order and times are those of the recording: a frame comes once the master has sent everything that was recorded
    before it. Recorded frames of the drives that precede a frame of the master have reached the master when it sends
    it.

    Args:
        buses: Its connections to the buses, in the order of the scene.
        recording: Recording to play.
        first: Index of the first frame to play.

    Attributes:
        compared: Frames of the master found equal so far.
        played: Frames of the drives sent so far.
        reached: Time of the master's last frame in the recording [ns]; its computation until then took that long.
        departure: First difference; None while there is none.
    """

    def __init__(self, buses: Sequence[can.BusABC], recording: Recording, first: int) -> None:
        self._buses = tuple(buses)
        self._sent: list[deque[can.Message]] = [deque() for _ in buses]  # by the master, not compared yet
        self._places = recording.buses
        self._frames = recording.frames
        self._is_master = recording.is_master
        self._left_out = recording.heartbeat
        self._end = len(recording.frames)
        self._next = first
        self._is_over = False
        self.compared = 0
        self.played = 0
        self.reached = 0
        self.departure: _Departure | None = None

    def _collect(self) -> None:
        for bus, sent in zip(self._buses, self._sent, strict=True):
            while (message := bus.recv(0.0)) is not None:
                if message.arbitration_id != self._left_out:
                    sent.append(message)

    def process(self, now: int) -> None:
        """Compare every frame that the master has sent, and send the frames due up to `now` [ns].

        Raises:
            ReplayOverError: The recording is at its end, or the master departed from it.
        """
        if self._is_over:  # the rig tries to stop its drives on the way out
            raise ReplayOverError
        self._collect()
        while any(self._sent):
            self._compare()
        while self.next_due() <= now:
            self._play()

    def next_due(self) -> int:
        """Return when the next frame of the drives is due [ns]; never while the master has to send first."""
        if self._next == self._end or self._is_master[self._next]:
            return NEVER
        return self._frames[self._next].timestamp_ns

    def next_command(self) -> int:
        """Time of the master's next frame, if nothing comes from the drives before [ns]."""
        if self._next == self._end or not self._is_master[self._next]:
            return NEVER
        return self._frames[self._next].timestamp_ns

    @property
    def unsent(self) -> int:
        """Index of the first recorded frame of the master that it has not sent; -1 when it has sent all."""
        return next((index for index in range(self._next, self._end) if self._is_master[index]), -1)

    def _play(self) -> None:
        frame, bus = self._frames[self._next], self._buses[self._places[self._next]]
        self._next += 1
        self.played += 1
        bus.send(
            can.Message(
                timestamp=frame.timestamp_ns * 1e-9,
                arbitration_id=frame.can_id,
                is_extended_id=frame.can_id > 0x7FF,
                data=frame.data,
            )
        )

    def _compare(self) -> None:
        """Compare one frame: with the next one of its bus in the recording, or of another bus if there is none."""
        while self._next < self._end and not self._is_master[self._next]:
            self._play()
        if self._next == self._end:
            raise self._over()
        frame, place = self._frames[self._next], self._places[self._next]
        bus = place if self._sent[place] else next(n for n, sent in enumerate(self._sent) if sent)
        message = self._sent[bus].popleft()
        if bus != place or message.arbitration_id != frame.can_id or message.data != frame.data:
            self.departure = _Departure(self._next, bus, message.arbitration_id, bytes(message.data))
            raise self._over()
        self.reached = frame.timestamp_ns
        self._next += 1
        self.compared += 1

    def _over(self) -> ReplayOverError:
        self._is_over = True
        return ReplayOverError()
