"""NMT, heartbeat and EMCY of a simulated node (CiA 301, 7.2.7 and 7.2.8), with error register, history and timers.

Its time is in integer nanoseconds of a clock that the owner supplies.
"""

from collections.abc import Callable
from functools import partial
from typing import Final

from canhaptic.canopen import objects
from canhaptic.canopen.objects import DataType, NmtCommand, SdoAbort
from canhaptic.sim.drive.profile.object_store import Entry, ObjectStore, refuse_unless

NEVER: Final = 1 << 62  # [ns], later than any clock
_ERROR_HISTORY: Final = 0x1003

HEARTBEAT_LOST: Final = 0x8130
PDO_TOO_SHORT: Final = 0x8210
SYNC_LENGTH: Final = 0x8240
RPDO_TIMEOUT: Final = 0x8250
COMMUNICATION: Final = 0x8100
SYNC_LOST: Final = 0x8700

# Bit of the error register (0x1001) by the leading digits of the error code; bit 0 (generic) is always set.
_REGISTER_BITS: Final = {0x2: 1 << 1, 0x3: 1 << 2, 0x4: 1 << 3, 0x8: 1 << 4, 0xF: 1 << 7}


class Timers:
    """Timers of one node, each with a due time and an action.

    Restarting a timer costs one or two comparisons: a deadline that every cycle postpones is examined only when its
    earliest value has passed.

    Attributes:
        earliest: No timer is due before this [ns].
    """

    def __init__(self) -> None:
        self._due: list[int] = []
        self._actions: list[Callable[[int], None]] = []
        self.earliest = NEVER
        self._is_exact = True  # a timer is due at `earliest`, or none is set

    def add(self, action: Callable[[int], None]) -> int:
        """Add a stopped timer and return its number; `action` is called with the due time [ns]."""
        self._due.append(NEVER)
        self._actions.append(action)
        return len(self._due) - 1

    def start(self, timer: int, due: int) -> None:
        """Set a timer to `due` [ns], replacing its former time."""
        if due <= self.earliest:
            self.earliest, self._is_exact = due, True
        elif self._due[timer] == self.earliest:
            self._is_exact = False
        self._due[timer] = due

    def stop(self, timer: int) -> None:
        """Stop a timer, which is then never due."""
        self._due[timer] = NEVER
        self._is_exact = False

    def stop_all(self) -> None:
        """Stop every timer."""
        self._due[:] = [NEVER] * len(self._due)
        self.earliest, self._is_exact = NEVER, True

    def is_running(self, timer: int) -> bool:
        """Return whether the timer is set."""
        return self._due[timer] != NEVER

    def next_due(self) -> int:
        """Return when the next timer is due [ns]; `NEVER` when none is set."""
        if not self._is_exact:
            self.earliest, self._is_exact = min(self._due, default=NEVER), True
        return self.earliest

    def fire(self, now: int) -> None:
        """Call the action of every timer due up to `now` [ns], in order of time; each timer is stopped first."""
        times = self._due
        while (due := self.next_due()) <= now:
            timer = times.index(due)
            times[timer], self._is_exact = NEVER, False
            self._actions[timer](due)


class EmergencyProducer:
    """Keeps the present errors; sends one EMCY when an error appears, and EMCY 0x0000 when errors disappear.

    Args:
        store: Object store (0x1001, 0x1003, 0x1014, 0x603F are used).
        node_id: Node ID of the drive.
        send: Called with COB-ID and content of a frame.
    """

    def __init__(self, store: ObjectStore, node_id: int, send: Callable[[int, bytes], None]) -> None:
        self._register = store.optional(objects.ERROR_REGISTER, DataType.UNSIGNED8)
        self._error_code = store.optional(objects.ERROR_CODE, DataType.UNSIGNED16)
        self._cob_id = store.optional(objects.EMCY_COB_ID, DataType.UNSIGNED32)
        self._default_cob_id = objects.EMCY_BASE + node_id
        self._send = send
        self._count = store.find(_ERROR_HISTORY) or Entry(_ERROR_HISTORY, 0, DataType.UNSIGNED8)
        self._history: list[Entry] = []
        while (field := store.find(_ERROR_HISTORY, len(self._history) + 1)) is not None:
            self._history.append(field)
        self._count.check, self._count.changed = refuse_unless(lambda value: value == 0), self._clear_history
        self.reset()

    def reset(self) -> None:
        """Clear the present errors without an EMCY."""
        self._present: list[int] = []
        self.show()

    def show(self) -> None:
        """Write the present errors to the error objects and clear the history."""
        self._show_present()
        self._clear_history()

    def announce(self, code: int) -> None:
        """Record an error and send its EMCY, unless it is present already."""
        if code not in self._present:
            self._present.append(code)
            for field, value in zip(self._history, [code, *(field.value for field in self._history)], strict=False):
                field.value = value
            self._count.value = min(self._count.number + 1, len(self._history))
            self._transmit(code)

    def withdraw(self, *codes: int) -> None:
        """Remove errors (all when none is named) and send EMCY 0x0000 if one was present."""
        remaining = [code for code in self._present if codes and code not in codes]
        if len(remaining) < len(self._present):
            self._present = remaining
            self._transmit(0)

    def _show_present(self) -> None:
        self._error_code.value = self._present[-1] if self._present else 0
        register = 0
        for code in self._present:
            register |= 1 | _REGISTER_BITS.get(code >> 12, 0)
        self._register.value = register

    def _transmit(self, code: int) -> None:
        """Update the error objects and send an EMCY: the code of a new error, or 0 when errors disappeared."""
        self._show_present()
        cob_id = self._cob_id.number or self._default_cob_id
        if not cob_id & objects.COB_ID_INVALID:
            self._send(cob_id & 0x7FF, bytes((code & 0xFF, code >> 8, self._register.number)) + bytes(5))

    def _clear_history(self) -> None:
        for field in self._history:
            field.value = None
        self._count.value = 0


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
