"""NMT of the simulated drive (CiA 301, 7.2.8): state, heartbeat producer, heartbeat consumer."""

from collections.abc import Callable
from functools import partial
from typing import Final

from canhaptic.canopen.objects import (
    CONSUMER_HEARTBEAT_TIME,
    HEARTBEAT_BASE,
    PRODUCER_HEARTBEAT_TIME,
    DataType,
    NmtCommand,
    SdoAbort,
)
from canhaptic.sim.drive.profile.object_store import Entry, ObjectStore
from canhaptic.sim.drive.timers import Timers

_NS_PER_MS: Final = 1_000_000
_COMMANDS: Final = frozenset(int(command) for command in NmtCommand)


def command_for(content: bytes, node_id: int) -> NmtCommand | None:
    """Return the command of an NMT frame, or None when it is for another node or is none."""
    if len(content) != 2 or content[0] not in _COMMANDS or content[1] not in (0, node_id):
        return None
    return NmtCommand(content[0])


class HeartbeatProducer:
    """Sends the NMT state every 0x1017 [ms].

    Args:
        store: Object store.
        timers: Timers of the node.
        send: Sends a heartbeat with the present state.
        now: Returns the time [ns].
    """

    def __init__(self, store: ObjectStore, timers: Timers, send: Callable[[], None], now: Callable[[], int]) -> None:
        self._time = store.entry(PRODUCER_HEARTBEAT_TIME, DataType.UNSIGNED16)
        self._timers, self._send, self._now = timers, send, now
        self._timer = timers.add(self._beat)
        self._time.changed = self.restart

    def restart(self) -> None:
        """Restart with the period in the object; 0 sends none."""
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


class HeartbeatConsumer:
    """Watches the nodes of 0x1016, each from its first heartbeat on.

    Args:
        store: The objects.
        timers: Timers of the node.
        now: Returns the time [ns].
        on_lost: Called when a heartbeat is overdue.
        on_return: Called when all that were lost are back.
        on_change: Called when 0x1016 was written.
    """

    def __init__(
        self,
        store: ObjectStore,
        timers: Timers,
        now: Callable[[], int],
        on_lost: Callable[[], None],
        on_return: Callable[[], None],
        on_change: Callable[[], None],
    ) -> None:
        self._timers, self._now = timers, now
        self._on_lost, self._on_return, self._on_change = on_lost, on_return, on_change
        self._slots: list[tuple[Entry, int]] = []
        while (entry := store.find(CONSUMER_HEARTBEAT_TIME, len(self._slots) + 1)) is not None:
            slot = len(self._slots)
            entry.check = partial(self._check, slot)
            entry.changed = self.restart
            self._slots.append((entry, timers.add(partial(self._lose, slot))))
        self._lost: set[int] = set()

    def restart(self) -> None:
        """Restart with the values in the objects."""
        for _, timer in self._slots:
            self._timers.stop(timer)
        self._lost.clear()
        self._on_change()

    def watched(self) -> dict[int, int]:
        """Return COB-ID -> slot of every node watched."""
        nodes = ((entry.number >> 16 & 0x7F, slot) for slot, (entry, _) in enumerate(self._slots) if _time(entry))
        return {HEARTBEAT_BASE + node: slot for node, slot in nodes if node}

    def hear(self, slot: int) -> None:
        """Record a heartbeat of the node in a slot of 0x1016."""
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
