"""NMT commands, heartbeat and life guarding of a simulated node (CiA 301, 7.2.8)."""

from collections.abc import Callable
from functools import partial
from typing import Final

from canhaptic.canopen import objects
from canhaptic.canopen.objects import DataType, NmtCommand, SdoAbort
from canhaptic.sim.drive.profile.object_store import Entry, ObjectStore
from canhaptic.sim.drive.profile.timers import Timers

_Call = Callable[[], None]
_Now = Callable[[], int]

_NS_PER_MS: Final = 1_000_000


def command_for(content: bytes, node_id: int) -> NmtCommand | None:
    """Return the command of an NMT frame, or None when it addresses another node or is not valid."""
    addressed = len(content) == 2 and content[1] in (0, node_id)
    return next((command for command in NmtCommand if addressed and command == content[0]), None)


class HeartbeatProducer:
    """Sends the NMT state every 0x1017 [ms].

    Args:
        store: Object store.
        timers: Timers of the node.
        send: Sends a heartbeat with the present state.
        now: Returns the time [ns].
    """

    def __init__(self, store: ObjectStore, timers: Timers, send: _Call, now: _Now) -> None:
        self._time = store.optional(objects.PRODUCER_HEARTBEAT_TIME, DataType.UNSIGNED16)
        self._timers, self._send, self._now = timers, send, now
        self._timer, self._time.changed = timers.add(self._beat), self.restart

    def restart(self) -> None:
        """Restart with the period in 0x1017; at 0 no heartbeat is sent."""
        self._timers.stop(self._timer)
        if period := self._time.number * _NS_PER_MS:
            self._timers.start(self._timer, self._now() + period)

    def _beat(self, due: int) -> None:
        self._send()
        period = self._time.number * _NS_PER_MS
        following = due + period
        if (late := self._now() - following) >= 0:  # after a stall: skipped, not caught up
            following += (late // period + 1) * period
        self._timers.start(self._timer, following)


class LifeGuard:
    """Answers guard requests with the NMT state and a bit that alternates, and notices that they end.

    The life time, 0x100C [ms] times 0x100D, counts from the first request. A node that produces heartbeats (0x1017) or
    whose dictionary lacks these objects is not guarded (CiA 301, 7.2.8.3).

    Args:
        store: Object store.
        timers: Timers of the node.
        now: Returns the time [ns].
        send: Sends the state with the bit given, 0x00 or 0x80.
        on_lost: Called when a request is overdue.
        on_return: Called when requests are back.
    """

    def __init__(
        self, store: ObjectStore, timers: Timers, now: _Now, send: Callable[[int], None], on_lost: _Call,
        on_return: _Call,
    ) -> None:  # fmt: skip
        self._heartbeat = store.optional(objects.PRODUCER_HEARTBEAT_TIME, DataType.UNSIGNED16)
        self._guard_time = store.find(objects.GUARD_TIME)
        self._factor = store.optional(objects.LIFE_TIME_FACTOR, DataType.UNSIGNED8)
        self._timers, self._now, self._send = timers, now, send
        self._on_lost, self._on_return = on_lost, on_return
        self._timer = timers.add(self._lose)
        for entry in (self._guard_time, self._factor):
            if entry is not None:
                entry.changed = partial(timers.stop, self._timer)
        self.restart()

    def restart(self) -> None:
        """Begin anew after a boot-up: the next answer has no bit set, and nothing is watched before it."""
        self._timers.stop(self._timer)
        self._toggle, self._is_lost = 0, False

    def answer(self) -> None:
        """Answer a guard request."""
        if self._guard_time is None or self._heartbeat.number:
            return
        self._send(self._toggle)
        self._toggle ^= 0x80
        life_time = self._guard_time.number * self._factor.number * _NS_PER_MS
        if life_time:
            self._timers.start(self._timer, self._now() + life_time)
        if self._is_lost:
            self._is_lost = False
            self._on_return()

    def _lose(self, _due: int) -> None:
        if not self._heartbeat.number:
            self._is_lost = True
            self._on_lost()


class HeartbeatConsumer:
    """Monitors the heartbeats of the nodes in 0x1016, each from its first heartbeat on.

    Args:
        store: Object store.
        timers: Timers of the node.
        now: Returns the time [ns].
        on_lost: Called when a heartbeat is overdue.
        on_return: Called when all lost heartbeats are back.
        on_change: Called when 0x1016 was written.
    """

    def __init__(
        self, store: ObjectStore, timers: Timers, now: _Now, on_lost: _Call, on_return: _Call, on_change: _Call
    ) -> None:
        self._timers, self._now = timers, now
        self._on_lost, self._on_return, self._on_change = on_lost, on_return, on_change
        self._slots: list[tuple[Entry, int]] = []
        while (entry := store.find(objects.CONSUMER_HEARTBEAT_TIME, len(self._slots) + 1)) is not None:
            slot = len(self._slots)
            entry.check = partial(self._check, slot)
            entry.changed = self.restart
            self._slots.append((entry, timers.add(partial(self._lose, slot))))
        self._lost: set[int] = set()

    def restart(self) -> None:
        """Restart the monitoring with the nodes and times in 0x1016."""
        for _, timer in self._slots:
            self._timers.stop(timer)
        self._lost.clear()
        self._on_change()

    def watched(self) -> dict[int, int]:
        """Return the subentry (slot) of 0x1016 for each monitored heartbeat COB-ID."""
        nodes = ((entry.number >> 16 & 0x7F, slot) for slot, (entry, _) in enumerate(self._slots) if _time(entry))
        return {objects.HEARTBEAT_BASE + node: slot for node, slot in nodes if node}

    def hear(self, slot: int, content: bytes | bytearray) -> None:
        """Record a heartbeat of the node in a slot of 0x1016."""
        if len(content) != 1:
            return
        entry, timer = self._slots[slot]
        self._timers.start(timer, self._now() + _time(entry))
        if slot in self._lost:
            self._lost.discard(slot)
            if not self._lost:
                self._on_return()

    def _lose(self, slot: int, _due: int) -> None:
        self._lost.add(slot)
        self._on_lost()

    def _check(self, slot: int, value: int) -> SdoAbort | None:
        """Refuse to watch one node twice (CiA 301, 7.5.2.19)."""
        others = [entry.number >> 16 & 0x7F for i, (entry, _) in enumerate(self._slots) if i != slot and _time(entry)]
        is_twice = value & 0xFFFF and value >> 16 & 0x7F in others
        return SdoAbort.PARAMETER_INCOMPATIBLE if is_twice else None


def _time(entry: Entry) -> int:
    return (entry.number & 0xFFFF) * _NS_PER_MS
