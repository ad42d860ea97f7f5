"""Time of a recording: it advances only when the master waits, and then moves to the next recorded frame.

The master sends each frame when it was sent in the recording, however long it computes today and for any deadline it
waits for. So a SYNC that was late then is as late now, and the same deadlines are skipped.
"""

import can

from canhaptic.drive.clock import Clock
from canhaptic.replay.recorded_side import NEVER, RecordedSide


class RecordedClock:
    """A `Clock` that a recording drives.

    Args:
        side: The drive's side of the recording.
        start: The time at the beginning [ns].
        pace: A clock to keep pace with; None to go as fast as the machine allows.
    """

    def __init__(self, side: RecordedSide, start: int, pace: Clock | None = None) -> None:
        self._side = side
        self._now = start
        self._pace = pace
        self._lead: int | None = None  # of the pace over the recording, from the first wait on

    def now(self) -> int:
        """Return the time of the recording [ns]."""
        return self._now

    def wait_until(self, deadline: int) -> None:
        """Run the recorded side until `deadline` [ns]."""
        while self._now < deadline:
            self._side.process(self._now)
            self._move(min(deadline, max(self._now + 1, self._side.next_due())))

    def receive(self, bus: can.BusABC, deadline: int) -> can.Message | None:
        """Next frame of the drives; None when the master's turn comes before, or at `deadline` [ns]."""
        side = self._side
        while True:
            side.process(self._now)
            self._move(side.reached)
            if (message := bus.recv(0.0)) is not None:
                return message
            due, command = side.next_due(), side.next_command()
            if due == NEVER:
                self._move(command if command != NEVER else deadline)
                return None
            self._move(due)  # recorded before the master's next frame, so it comes before it, however late it was

    def _move(self, now: int) -> None:
        if now > self._now:
            if self._pace is not None:
                if self._lead is None:
                    self._lead = self._pace.now() - self._now
                self._pace.wait_until(now + self._lead)
            self._now = now
