"""A python-can bus with simulated faults, and the parameters that a scene gives them under `simulation.bus`.

Frames are lost, delayed, duplicated, reordered, truncated, corrupted or refused. The bus wraps one connection, the
master's or the drives', and affects both directions. The same frames and the same seed give the same faults: each
effect draws from its own random stream once per frame, so that adding an effect does not change the others.

With simulated time a delayed frame arrives at its exact virtual time, because the bus takes part in `process` and
`next_due` of the simulated drives; in real time it arrives when the owner of the connection next receives. A scene
without `simulation.bus` has an ideal bus and never imports this module.
"""

import copy
import errno
import heapq
import itertools
from collections import Counter, deque
from collections.abc import Callable, Container, Sequence
from functools import partial
from random import Random
from typing import Annotated, Final, Literal, NamedTuple, Protocol

import can
from pydantic import model_validator

from canhaptic.canopen.objects import SYNC_FRAME_COB_ID
from canhaptic.signals import SimulatedPeer
from canhaptic.sim.drive.profile.timers import NEVER
from canhaptic.units import Parameters, quantity

Direction = Literal["to_drive", "to_master"]
_Probability = Annotated[float, quantity("1", ge=0.0, le=1.0)]
_CobId = Annotated[int, quantity("1", ge=0, le=0x7FF)]

_SECOND: Final = 1_000_000_000  # [ns]
_EFFECTS: Final = (
    *("drop", "duplicate", "reorder", "truncate", "corrupt", "refuse", "delay", "jitter", "foreign_rate", "wire_time"),
    *("freeze", "stall", "bus_off"),
)


class Window(Parameters):
    """A time window, once or periodic."""

    begin: Annotated[float, quantity("s", ge=0.0, le=1e6)] = 0.0
    """Start of the window, counted from the first SYNC; from the first frame when `bring_up` is set."""
    duration: Annotated[float, quantity("s", gt=0.0, le=1e6)]
    """Length of the window."""
    every: Annotated[float, quantity("s", gt=0.0, le=1e6)] | None = None
    """Period of the window; None: it occurs once."""

    @model_validator(mode="after")
    def _check(self) -> "Window":
        if self.every is not None and self.every <= self.duration:
            raise ValueError(f"every is {self.every:g} s, expected more than duration ({self.duration:g} s)")
        return self


class BusEffects(Parameters):
    """Faults of frames between master and drives. Probabilities are per frame and direction.

    `direction`, `ids` and `during` select the frames for the effects on single frames: drop, duplicate, reorder,
    truncate, corrupt, refuse, delay, jitter. The others act on the bus as a whole; frames of other devices respect
    `during` too.
    """

    drop: _Probability = 0.0
    """Share of frames that are lost."""
    drop_burst: Annotated[float, quantity("count", ge=1.0, le=1e4)] | None = None
    """Mean number of frames lost in a row (Gilbert's two states); None: each frame is lost independently."""
    duplicate: _Probability = 0.0
    """Share of frames that arrive twice."""
    reorder: _Probability = 0.0
    """Share of frames that are delayed by `reorder_delay`, so that later frames overtake them."""
    reorder_delay: Annotated[float, quantity("s", gt=0.0, le=10.0)] = 1e-3
    """Delay of a reordered frame."""
    truncate: _Probability = 0.0
    """Share of frames that lose bytes at their end."""
    corrupt: _Probability = 0.0
    """Share of frames that arrive with one flipped data bit, as behind a faulty gateway."""
    refuse: _Probability = 0.0
    """Share of the master's frames that its interface refuses to send (ENOBUFS)."""
    delay: Annotated[float, quantity("s", ge=0.0, le=10.0)] = 0.0
    """Delay of every frame."""
    jitter: Annotated[float, quantity("s", ge=0.0, le=10.0)] = 0.0
    """Largest additional delay, random and uniform from zero; the frames of one direction stay in order."""
    direction: Literal["both", "to_drive", "to_master"] = "both"
    """Direction of the frames that are affected."""
    ids: tuple[_CobId, ...] | None = None
    """Affected COB-IDs; None: all."""
    during: tuple[Window, ...] = ()
    """Windows in which frames are affected; empty: always."""
    foreign_rate: Annotated[float, quantity("Hz", ge=0.0, le=1e5)] = 0.0
    """Rate of frames from other devices, at random times (Poisson), received by master and drives."""
    foreign_ids: tuple[_CobId, ...] = (0x7F0,)
    """COB-IDs of these frames, used in turn; with a COB-ID of an axis they imitate its frames."""
    wire_time: bool = False
    """Whether frames occupy the wire one at a time, lowest COB-ID first, for their worst-case time at `bus.bitrate`."""
    freeze: tuple[Window, ...] = ()
    """Windows in which the bus carries no frame; the waiting frames follow at the end, in one burst."""
    stall: tuple[Window, ...] = ()
    """Windows in which the master's host is stalled; needs the master in the same process."""
    bus_off: tuple[Window, ...] = ()
    """Windows in which nothing can be sent and arriving frames are lost."""
    bring_up: bool = False
    """Whether frames before the first SYNC are affected too."""
    buses: tuple[str, ...] | None = None
    """Names of the affected buses, each with its own random faults; None: all."""

    @model_validator(mode="after")
    def _check(self) -> "BusEffects":
        if not any(getattr(self, name) for name in _EFFECTS):
            raise ValueError(f"names no effect, expected one of: {', '.join(_EFFECTS)}; omit `bus` for an ideal bus")
        for name, what in (("ids", "COB-ID"), ("foreign_ids", "COB-ID"), ("buses", "name")):
            if getattr(self, name) == ():
                raise ValueError(f"{name} is empty, expected at least one {what}; leave it out for the defaults")
        most = 1.0 if self.drop_burst is None else self.drop_burst / (1.0 + self.drop_burst)
        if self.drop > most:
            raise ValueError(
                f"drop is {self.drop:g}, expected at most {most:g} with a drop_burst of {self.drop_burst:g} frames, "
                "because at least one frame arrives between two bursts"
            )
        return self

    @property
    def named(self) -> tuple[str, ...]:
        """Effects that differ from their defaults, in the order in which they are listed."""
        return tuple(name for name in _EFFECTS if getattr(self, name))

    def suffers(self, direction: Direction) -> bool:
        """Whether the effects on single frames act on a direction."""
        return self.direction in ("both", direction)


class Schedule:
    """Time windows in integer nanoseconds.

    Args:
        windows: Windows of the scene.
    """

    def __init__(self, windows: Sequence[Window]) -> None:
        self._windows = tuple(
            (round(w.begin * _SECOND), round(w.duration * _SECOND), round((w.every or 0.0) * _SECOND)) for w in windows
        )

    def end(self, time: int) -> int:
        """End of the window that contains `time` [ns], merged with adjoining windows; 0 if none contains it."""
        latest = time
        for begin, duration, every in self._windows * len(self._windows):  # any of them may follow any other
            since = latest - begin
            if since >= 0 and every:
                since %= every
            if 0 <= since < duration:
                latest += duration - since
        return latest if latest > time else 0


class Flight(NamedTuple):
    """A frame in transit."""

    message: can.Message
    due: int  # when it arrives [ns]
    keeps_order: bool  # False: the ones behind it may overtake


_Count = Callable[[str, int], None]
"""Called as count(effect, COB-ID) for each affected frame."""


def _with_data(flight: Flight, data: bytearray) -> Flight:
    """Return a copy of a frame with other data."""
    changed = copy.copy(flight.message)
    changed.data, changed.dlc = data, len(data)
    return flight._replace(message=changed)


def _truncated(_effects: BusEffects, random: Random, flight: Flight) -> list[Flight] | None:
    """Cut bytes off the end of the data."""
    data = flight.message.data
    return [_with_data(flight, bytearray(data[: random.randrange(len(data))]))] if data else None


def _corrupted(_effects: BusEffects, random: Random, flight: Flight) -> list[Flight] | None:
    """Flip one bit of the data."""
    if not (data := bytearray(flight.message.data)):
        return None
    bit = random.randrange(8 * len(data))
    data[bit // 8] ^= 1 << bit % 8
    return [_with_data(flight, data)]


def _delayed(effects: BusEffects, random: Random, flight: Flight) -> list[Flight]:
    """Delay a frame by a fixed time and a random one."""
    delay, jitter = round(effects.delay * _SECOND), round(effects.jitter * _SECOND)
    return [flight._replace(due=flight.due + delay + (random.randrange(jitter + 1) if jitter else 0))]


_Change = Callable[[BusEffects, Random, Flight], list[Flight] | None]
_CHANGES: Final[dict[str, _Change]] = {
    "drop": lambda _effects, _random, _flight: [],
    "truncate": _truncated, "corrupt": _corrupted, "delay": _delayed, "jitter": _delayed,
    "duplicate": lambda _effects, _random, flight: [flight, _with_data(flight, bytearray(flight.message.data))],
    "reorder": lambda effects, _random, flight: [
        Flight(flight.message, flight.due + round(effects.reorder_delay * _SECOND), keeps_order=False)],
}  # fmt: skip
"""Action of each effect on a frame, None if there is nothing to change; effects act in this order."""
_Effect = Callable[[Flight], list[Flight]]
"""Function that returns the frames that result from one frame."""


def _effect(name: str, effects: BusEffects, random: Random, count: _Count) -> _Effect:
    """Function that applies an effect to a random share of the frames; with `drop_burst` in runs (Gilbert, 1960).

    A delay acts on every frame and is not counted.
    """
    share, mean = float(getattr(effects, name)), effects.drop_burst if name == "drop" else None
    change, is_struck = partial(_CHANGES[name], effects, random), False

    def apply(flight: Flight) -> list[Flight]:
        nonlocal is_struck
        threshold = share
        if mean is not None:
            threshold = 1.0 - 1.0 / mean if is_struck else share / (mean * (1.0 - share))
        is_struck = random.random() < threshold
        if not is_struck or (changed := change(flight)) is None:
            return [flight]
        count(name, flight.message.arbitration_id)
        return changed

    return partial(_delayed, effects, random) if name in ("delay", "jitter") else apply


def stream(seed: int, direction: str, effect: str) -> Random:
    """Random numbers of one effect in one direction; the same on every machine."""
    return Random(f"canhaptic bus {seed} {direction} {effect}")


def frame_effects(effects: BusEffects, direction: Direction, seed: int, count: _Count) -> list[_Effect]:
    """Effects on single frames that a scene names for one direction, in the order in which they act."""
    named = [name for name in _CHANGES if getattr(effects, name) and effects.suffers(direction)]
    if "delay" in named and "jitter" in named:
        named.remove("delay")  # one effect for both
    return [_effect(name, effects, stream(seed, direction, name), count) for name in named]


_Deliver = Callable[[can.Message, int], None]
"""Called as deliver(frame, now [ns]) when a frame arrives."""
Counts = Counter[tuple[str, str, int]]
"""Number of affected frames by (effect, direction, COB-ID)."""


def _worst_case_bits(length: int) -> int:
    """Worst-case number of bits of a classic frame with `length` data bytes, including the interframe space.

    47 bits frame the data; the 34 + 8 n bits that are stuffed get one stuff bit in four (Davis et al. 2007, eq. 1).
    """
    return 47 + 8 * length + (33 + 8 * length) // 4


class Wire:
    """The CAN wire, which carries one frame at a time; of the waiting frames the lowest COB-ID goes first.

    Args:
        bitrate: Bit rate of the wire [bit/s].

    Attributes:
        due: Time when the frame on the wire, or a freeze, ends [ns].
    """

    def __init__(self, bitrate: int) -> None:
        self._bitrate = bitrate
        self._waiting: list[tuple[int, int, can.Message, _Deliver]] = []
        self._number = 0
        self._current: tuple[can.Message, _Deliver] | None = None
        self.due = NEVER

    def request(self, message: can.Message, deliver: _Deliver) -> None:
        """Queue a frame for the wire."""
        self._number += 1
        heapq.heappush(self._waiting, (message.arbitration_id, self._number, message, deliver))

    def run(self, now: int, frozen_until: int) -> None:
        """End the frame that has been sent and begin the next; called at `due` and after each request.

        Args:
            now: Time [ns].
            frozen_until: End of a freeze, before which no frame begins [ns]; not after `now` without a freeze.
        """
        if self._current is not None and self.due <= now:
            (message, deliver), self._current, self.due = self._current, None, NEVER
            deliver(message, now)
        if self._current is None and self._waiting:
            if frozen_until > now:
                self.due = frozen_until
                return
            _, _, message, deliver = heapq.heappop(self._waiting)
            self._current = (message, deliver)
            self.due = now + -(-_worst_case_bits(len(message.data)) * _SECOND // self._bitrate)


class Foreign:
    """Source of frames of other devices, sent at random times.

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
        """Return the frame that is due, and schedule the next one."""
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
        seed: Seed of everything random.
        counts: Counter of affected frames.
        wire: Wire on which frames are arbitrated after their delays; None: they arrive at once.
        direction: Direction of the frames.
        deliver: Function that takes the arriving frames.
    """

    def __init__(
        self, effects: BusEffects, seed: int, counts: Counts, wire: Wire | None, direction: Direction, deliver: _Deliver
    ) -> None:
        def count(effect: str, cob_id: int) -> None:
            counts[effect, direction, cob_id] += 1

        self._effects = frame_effects(effects, direction, seed, count)
        self._ids: Container[int] = range(0x800) if effects.ids is None else frozenset(effects.ids)
        self._during = Schedule(effects.during) if effects.during else None
        self._freeze = Schedule(effects.freeze)
        self._deliver: _Deliver = deliver if wire is None else lambda m, _now: wire.request(m, deliver)
        self._queue: list[tuple[int, int, can.Message]] = []
        self._number = 0
        self._last_due = -NEVER

    def suffers(self, cob_id: int, time: int) -> bool:
        """Whether a frame with this COB-ID is affected, `time` [ns] after the first SYNC."""
        return cob_id in self._ids and (self._during is None or bool(self._during.end(time)))

    def push(self, message: can.Message, now: int, epoch: int) -> None:
        """Put a frame sent at `now` [ns] in transit, with its faults; `epoch` is the time of the first SYNC [ns]."""
        flights = [Flight(message, now, keeps_order=True)]
        if self.suffers(message.arbitration_id, now - epoch):
            for effect in self._effects:
                flights = [result for flight in flights for result in effect(flight)]
        for flight in flights:
            due = max(flight.due, self._freeze.end(flight.due - epoch) + epoch)
            self.enter(flight.message, due, keeps_order=flight.keeps_order)

    def enter(self, message: can.Message, due: int, *, keeps_order: bool = True) -> None:
        """Queue a frame without effects, behind earlier frames unless `keeps_order` is False."""
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
        """Return when the next frame arrives [ns]; `NEVER` when none is in transit."""
        return self._queue[0][0] if self._queue else NEVER


class _BusClock(Protocol):
    """Clock of the owner of the connection."""

    def now(self) -> int:
        """Return the time [ns]."""

    def wait_until(self, deadline: int) -> None:
        """Return when `deadline` [ns] has come."""


class FaultyBus(can.BusABC):
    """One connection to a bus with simulated faults; call `use(clock)` before the first frame.

    Args:
        bus: Wrapped connection; shut down together with this one.
        effects: Effects of the bus.
        bitrate: Bit rate of the wire [bit/s].
        seed: Seed of everything random.
        side: Owner of the connection. Stalls, and refused frames, occur on the master's side only.

    Attributes:
        counts: Affected frames, by (effect, direction, COB-ID).
    """

    def __init__(
        self, bus: can.BusABC, effects: BusEffects, *, bitrate: int, seed: int = 0, side: str = "master"
    ) -> None:
        super().__init__(channel=0)
        self.channel_info = f"{getattr(bus, 'channel_info', 'bus')} with faults"
        self.counts: Counts = Counter()
        self._bus = bus
        self._clock: _BusClock | None = None
        self._ready: deque[can.Message] = deque()
        is_master = side == "master"
        self._out: Direction = "to_drive" if is_master else "to_master"
        self._in: Direction = "to_master" if is_master else "to_drive"
        self._wire = Wire(bitrate) if effects.wire_time else None
        shared = effects, seed, self.counts, self._wire
        self._outgoing = BusSegment(*shared, self._out, lambda message, _now: self._bus.send(message))
        self._incoming = BusSegment(*shared, self._in, lambda message, _now: self._ready.append(message))
        self._refused = effects.refuse if is_master and effects.suffers(self._out) else 0.0
        self._refusals = stream(seed, "to_drive", "refuse")
        self._stall = Schedule(effects.stall) if effects.stall and is_master else None
        self._bus_off, self._freeze = Schedule(effects.bus_off), Schedule(effects.freeze)
        self._foreign = Foreign(effects, seed) if effects.foreign_rate else None
        self._foreign_times = Schedule(effects.during) if effects.during else None
        self._begins_at_once = effects.bring_up
        self._is_pumped = False  # by the simulated drives, which collect what the connection receives
        self._epoch: int | None = None

    def use(self, clock: _BusClock) -> None:
        """Set the clock by which delayed frames are timed."""
        self._clock = clock

    # --- a bus of python-can ------------------------------------------------------------------------------------------

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Send a frame, subject to the faults.

        Raises:
            can.CanOperationError: The bus is off, or the interface's queue is full (ENOBUFS).
        """
        now = self._awake()
        epoch = self._begin(msg, now)
        if epoch is None:
            self._outgoing.enter(copy.copy(msg), now)
        else:
            self._require_working(msg.arbitration_id, now - epoch)
            self._outgoing.push(copy.copy(msg), now, epoch)
        self.advance(now)

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """Return the next received frame, or None after `timeout` [s]; a timeout of None waits for ever."""
        now = self._awake()
        deadline = NEVER if timeout is None else now + round(timeout * _SECOND)
        while True:
            if self._is_pumped:
                self.advance(now)
            else:
                self.collect(now)
            if self._ready:
                return self._ready.popleft()
            if now >= deadline:
                return None
            message = self._bus.recv(max(0, min(deadline, self.next_due(), now + _SECOND) - now) * 1e-9)
            now = self._awake()
            if message is not None:
                self._take(message, now)

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        return self.recv(timeout), False  # python-can's own way in, for its Notifier and iterator

    def shutdown(self) -> None:
        """Shut the connection down; frames in transit are lost."""
        super().shutdown()
        self._bus.shutdown()

    def totals(self) -> dict[str, dict[str, int]]:
        """Number of frames affected, by effect and direction."""
        totals: dict[str, dict[str, int]] = {}
        for (effect, direction, _), count in sorted(self.counts.items()):
            of_effect = totals.setdefault(effect, {})
            of_effect[direction] = of_effect.get(direction, 0) + count
        return totals

    # --- time ---------------------------------------------------------------------------------------------------------

    def around(self, far_side: SimulatedPeer) -> SimulatedPeer:
        """Return a peer for the master's clock: the simulated drives, with their frames passed through the faults."""
        self._is_pumped = True
        return _FaultyFarSide(self, far_side)

    def advance(self, now: int) -> None:
        """Deliver the frames due up to `now` [ns], each at its own time."""
        while (due := self.next_due()) <= now:
            if self._foreign is not None and self._foreign.due <= due:
                self._let_in(self._foreign.take(), due)
            self._outgoing.run(due)
            self._incoming.run(due)
            if self._wire is not None:
                epoch = self._epoch or 0
                self._wire.run(due, self._freeze.end(due - epoch) + epoch if self._epoch is not None else 0)

    def collect(self, now: int) -> None:
        """Collect what the connection has received up to `now` [ns]."""
        receive = self._bus.recv
        while (message := receive(0)) is not None:
            self._take(message, now)
        self.advance(now)

    def next_due(self) -> int:
        """Time of the next event [ns]; `NEVER` when nothing is in transit."""
        due = min(self._outgoing.next_due(), self._incoming.next_due())
        if self._wire is not None:
            due = min(due, self._wire.due)
        if self._foreign is not None:
            due = min(due, self._foreign.due)
        return due

    def _awake(self) -> int:
        """Return the time [ns] from which the owner is no longer stalled."""
        clock = self._clock
        if clock is None:
            raise can.CanOperationError("the faulty bus has no clock; call use(clock) first")
        now = clock.now()
        if self._stall is not None and self._epoch is not None:
            end = self._stall.end(now - self._epoch)
            if end:
                self.counts["stall", self._out, 0] += 1
                clock.wait_until(end + self._epoch)
                now = clock.now()
        return now

    # --- frames -------------------------------------------------------------------------------------------------------

    def _begin(self, message: can.Message, now: int) -> int | None:
        """Return when the faults began [ns]: at the first SYNC, with `bring_up` at the first frame; None before."""
        is_sync = message.arbitration_id == SYNC_FRAME_COB_ID and not message.is_extended_id
        if self._epoch is None and (self._begins_at_once or is_sync):
            self._epoch = now
            if self._foreign is not None:
                self._foreign.begin(now)
        return self._epoch

    def _require_working(self, cob_id: int, time: int) -> None:
        """Raise the error of a real interface that cannot send, `time` [ns] after the faults began."""
        if self._bus_off.end(time):
            self.counts["bus_off", self._out, cob_id] += 1
            raise can.CanOperationError("bus-off: the controller takes no part in the bus")
        if self._refused and self._outgoing.suffers(cob_id, time) and self._refusals.random() < self._refused:
            self.counts["refuse", self._out, cob_id] += 1
            raise can.CanOperationError("No buffer space available", errno.ENOBUFS)

    def _take(self, message: can.Message, now: int) -> None:
        epoch = self._begin(message, now)
        if epoch is None:
            self._incoming.enter(message, now)
        elif self._bus_off.end(now - epoch):
            self.counts["bus_off", self._in, message.arbitration_id] += 1
        else:
            self._incoming.push(message, now, epoch)

    def _let_in(self, message: can.Message, now: int) -> None:
        """Deliver a frame of another device to both sides; this side loses it while it is bus-off."""
        epoch = self._epoch or 0

        def deliver(frame: can.Message, now: int) -> None:
            self.counts["foreign", "both", frame.arbitration_id] += 1
            self._bus.send(frame)
            if self._bus_off.end(now - epoch):
                self.counts["bus_off", self._in, frame.arbitration_id] += 1
            else:
                self._ready.append(copy.copy(frame))

        if self._foreign_times is not None and not self._foreign_times.end(now - epoch):
            return
        if self._wire is None:
            deliver(message, now)
        else:
            self._wire.request(message, deliver)


class _FaultyFarSide:
    """Simulated drives behind a faulty bus (a `SimulatedPeer`), driven by the master's clock.

    Args:
        bus: The master's connection.
        far_side: Simulated drives.
    """

    def __init__(self, bus: FaultyBus, far_side: SimulatedPeer) -> None:
        self._bus = bus
        self._far_side = far_side

    def process(self, now: int) -> None:
        """Deliver frames, run the drives, and send their answers, up to `now` [ns]."""
        self._bus.advance(now)
        self._far_side.process(now)
        self._bus.collect(now)

    def next_due(self) -> int:
        """Return when the bus or a drive is due next [ns]."""
        return min(self._bus.next_due(), self._far_side.next_due())
