"""One direction of a simulated bus, and the wire that both directions share."""

import heapq
import itertools
from collections import Counter
from collections.abc import Callable, Container
from typing import Final

import can

from canhaptic.sim.bus.bus_effects import BusEffects, Direction, Schedule
from canhaptic.sim.bus.frame_effects import Flight, frame_effects, stream
from canhaptic.sim.drive.timers import NEVER

_Delivery = Callable[[can.Message, int], None]
"""Called as deliver(frame, now [ns]) when it arrives."""
Counts = Counter[tuple[str, str, int]]
"""Frames struck, by (effect, direction, COB-ID)."""

_SECOND: Final = 1_000_000_000  # [ns]


def _worst_case_bits(length: int) -> int:
    """Most bits of a classic frame with `length` data bytes, interframe space included.

    47 bits around the data and one stuff bit in every four of the 34 + 8 n that are stuffed (Davis et al. 2007, eq. 1).
    """
    return 47 + 8 * length + (33 + 8 * length) // 4


class Wire:
    """A medium that carries one frame at a time; of those that wait when it falls free, the lowest COB-ID goes first.

    Args:
        bitrate: Bit rate of the wire [bit/s].
    """

    def __init__(self, bitrate: int) -> None:
        self._bitrate = bitrate
        self._waiting: list[tuple[int, int, can.Message, _Delivery]] = []
        self._number = 0
        self._current: tuple[can.Message, _Delivery] | None = None
        self._end = NEVER

    def request(self, message: can.Message, deliver: _Delivery) -> None:
        """Queue a frame for the wire."""
        self._number += 1
        heapq.heappush(self._waiting, (message.arbitration_id, self._number, message, deliver))

    def run(self, now: int, frozen_until: int) -> None:
        """End the frame whose time is over and begin the next; called at `next_due` and after each request.

        Args:
            now: Time [ns].
            frozen_until: End of a freeze, before which no frame begins [ns]; not later than `now` without one.
        """
        if self._current is not None and self._end <= now:
            (message, deliver), self._current, self._end = self._current, None, NEVER
            deliver(message, now)
        if self._current is None and self._waiting:
            if frozen_until > now:
                self._end = frozen_until
                return
            _, _, message, deliver = heapq.heappop(self._waiting)
            self._current = (message, deliver)
            self._end = now + -(-_worst_case_bits(len(message.data)) * _SECOND // self._bitrate)

    def next_due(self) -> int:
        """Time when the frame on the wire, or a freeze, ends [ns]."""
        return self._end


class Foreign:
    """Frames of other devices, at random times.

    Attributes:
        due: Time of the next frame [ns]; `NEVER` before `begin`.
    """

    def __init__(self, effects: BusEffects, seed: int) -> None:
        self._rate, self._ids = effects.foreign_rate, itertools.cycle(effects.foreign_ids)
        self._random = stream(seed, "both", "foreign")
        self._freeze = Schedule(effects.freeze)
        self._epoch = self._asked = 0  # begin, and when the next frame would like to be sent [ns]
        self.due = NEVER

    def begin(self, now: int) -> None:
        """Start at `now` [ns]."""
        self._epoch = self._asked = now
        self._schedule()

    def take(self) -> can.Message:
        """Frame that is due; the next one becomes due later."""
        self._schedule()
        data = self._random.randbytes(self._random.randrange(9))
        return can.Message(arbitration_id=next(self._ids), is_extended_id=False, data=data)

    def _schedule(self) -> None:
        self._asked += max(1, round(self._random.expovariate(self._rate) * _SECOND))
        self.due = max(self._asked, self._epoch + self._freeze.end(self._asked - self._epoch))


class BusSegment:
    """Frames of one direction in transit, with the effects that the scene names.

    Args:
        effects: Effects of the bus.
        direction: Direction of the frames.
        seed: Seed of everything random.
        counts: Counts every frame affected.
        wire: Wire on which frames are arbitrated after their delays; None: they arrive at once.
        deliver: Takes the frames that arrive.
    """

    def __init__(
        self,
        effects: BusEffects,
        direction: Direction,
        seed: int,
        counts: Counts,
        wire: Wire | None,
        deliver: _Delivery,
    ) -> None:
        def count(effect: str, cob_id: int) -> None:
            counts[effect, direction, cob_id] += 1

        self._effects = frame_effects(effects, direction, seed, count)
        self._ids: Container[int] = range(0x800) if effects.ids is None else frozenset(effects.ids)
        self._during = Schedule(effects.during) if effects.during else None
        self._freeze = Schedule(effects.freeze)
        self._deliver: _Delivery = deliver if wire is None else lambda m, _now: wire.request(m, deliver)
        self._queue: list[tuple[int, int, can.Message]] = []
        self._number = 0
        self._last_due = -NEVER

    def suffers(self, cob_id: int, time: int) -> bool:
        """Whether the effects on single frames act on a frame, `time` [ns] after the first SYNC."""
        return cob_id in self._ids and (self._during is None or bool(self._during.end(time)))

    def push(self, message: can.Message, now: int, epoch: int) -> None:
        """Take a frame sent at `now` [ns]; `epoch` is the time of the first SYNC [ns]."""
        flights = [Flight(message, now, keeps_order=True)]
        if self.suffers(message.arbitration_id, now - epoch):
            for effect in self._effects:
                flights = [result for flight in flights for result in effect.apply(flight)]
        for flight in flights:
            due = max(flight.due, self._freeze.end(flight.due - epoch) + epoch)
            self._enter(flight.message, due, keeps_order=flight.keeps_order)

    def pass_through(self, message: can.Message, now: int) -> None:
        """Take a frame without effects; it still waits for those before it."""
        self._enter(message, now, keeps_order=True)

    def _enter(self, message: can.Message, due: int, *, keeps_order: bool) -> None:
        if keeps_order:
            self._last_due = due = max(due, self._last_due)
        self._number += 1
        heapq.heappush(self._queue, (due, self._number, message))

    def run(self, now: int) -> None:
        """Deliver the frames due up to `now` [ns]."""
        queue = self._queue
        while queue and queue[0][0] <= now:
            _, _, message = heapq.heappop(queue)
            self._deliver(message, now)

    def next_due(self) -> int:
        """Return when the next frame arrives [ns]; `NEVER` when none is on its way."""
        return self._queue[0][0] if self._queue else NEVER
