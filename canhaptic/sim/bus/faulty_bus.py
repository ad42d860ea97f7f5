"""A python-can bus with faults: frames lost, late, doubled, out of order, short, wrong, refused, or kept waiting.

It wraps one connection, the master's or the drives', and disturbs both directions. The same frames and the same seed
give the same faults. In lock-step a delayed frame arrives at its own virtual instant, because the bus takes part in the
simulated drives' `process` and `next_due`; in real time it does so whenever its owner receives. A scene that names no
effect on its bus never imports this module.
"""

import copy
import errno
from collections import Counter, deque
from typing import Protocol

import can

from canhaptic.canopen.objects import SYNC_FRAME_COB_ID
from canhaptic.signals import SimulatedPeer
from canhaptic.sim.bus.bus_effects import BusEffects, Direction, Schedule
from canhaptic.sim.bus.bus_segment import BusSegment, Counts, Foreign, Wire
from canhaptic.sim.bus.frame_effects import Refuse
from canhaptic.sim.drive.timers import NEVER


class _BusClock(Protocol):
    """Clock of the owner of the connection."""

    def now(self) -> int:
        """Return the time [ns]."""

    def wait_until(self, deadline: int) -> None:
        """Return when `deadline` [ns] has come."""


class FaultyBus(can.BusABC):
    """One connection to a bus with faults; `use` a clock before the first frame.

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
        self._outgoing = BusSegment(effects, self._out, seed, self.counts, self._wire, self._send_on)
        self._incoming = BusSegment(effects, self._in, seed, self.counts, self._wire, self._hand_in)
        self._refuse = Refuse(effects, seed) if effects.refuse and is_master and effects.suffers(self._out) else None
        self._stall = Schedule(effects.stall) if effects.stall and is_master else None
        self._bus_off, self._freeze = Schedule(effects.bus_off), Schedule(effects.freeze)
        self._foreign = Foreign(effects, seed) if effects.foreign_rate else None
        self._foreign_times = Schedule(effects.during) if effects.during else None
        self._begins_at_once = effects.bring_up
        self._is_pumped = False  # by the simulated drives, which collect what the connection receives
        self._epoch: int | None = None

    def use(self, clock: _BusClock) -> None:
        """Set the clock that times late frames."""
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
            self._outgoing.pass_through(copy.copy(msg), now)
        else:
            self._require_working(msg.arbitration_id, now - epoch)
            self._outgoing.push(copy.copy(msg), now, epoch)
        self.advance(now)

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """Return the next frame that has arrived; None when none did within `timeout` [s], None for ever."""
        now = self._awake()
        deadline = NEVER if timeout is None else now + round(timeout * 1e9)
        while True:
            if self._is_pumped:
                self.advance(now)
            else:
                self.collect(now)
            if self._ready:
                return self._ready.popleft()
            if now >= deadline:
                return None
            message = self._bus.recv(max(0, min(deadline, self.next_due(), now + 1_000_000_000) - now) * 1e-9)
            now = self._awake()
            if message is not None:
                self._take(message, now)

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        return self.recv(timeout), False  # python-can's own way in, for its Notifier and iterator

    def shutdown(self) -> None:
        """Shut the connection down; frames on their way are lost."""
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
        """Simulated drives whose frames pass through the faults, for the master's clock to drive."""
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
        """Take over what the connection has received up to `now` [ns]."""
        receive = self._bus.recv
        while (message := receive(0)) is not None:
            self._take(message, now)
        self.advance(now)

    def next_due(self) -> int:
        """Time of the next event [ns]; `NEVER` when nothing is in transit."""
        due = min(self._outgoing.next_due(), self._incoming.next_due())
        if self._wire is not None:
            due = min(due, self._wire.next_due())
        if self._foreign is not None:
            due = min(due, self._foreign.due)
        return due

    def _awake(self) -> int:
        """Return the time [ns] at which the owner is awake."""
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
        """Return when the faults began [ns]: with the first SYNC, or the first frame; None before."""
        is_sync = message.arbitration_id == SYNC_FRAME_COB_ID and not message.is_extended_id
        if self._epoch is None and (self._begins_at_once or is_sync):
            self._epoch = now
            if self._foreign is not None:
                self._foreign.begin(now)
        return self._epoch

    def _require_working(self, cob_id: int, time: int) -> None:
        """Raise the error of a real interface that cannot send at `time` [ns] after the begin."""
        if self._bus_off.end(time):
            self.counts["bus_off", self._out, cob_id] += 1
            raise can.CanOperationError("bus-off: the controller takes no part in the bus")
        if self._refuse is not None and self._outgoing.suffers(cob_id, time) and self._refuse.happens():
            self.counts["refuse", self._out, cob_id] += 1
            raise can.CanOperationError("No buffer space available", errno.ENOBUFS)

    def _take(self, message: can.Message, now: int) -> None:
        epoch = self._begin(message, now)
        if epoch is None:
            self._incoming.pass_through(message, now)
        elif self._bus_off.end(now - epoch):
            self.counts["bus_off", self._in, message.arbitration_id] += 1
        else:
            self._incoming.push(message, now, epoch)

    def _send_on(self, message: can.Message, now: int) -> None:
        self._bus.send(message)

    def _hand_in(self, message: can.Message, now: int) -> None:
        self._ready.append(message)

    def _let_in(self, message: can.Message, now: int) -> None:
        """Pass a frame of another device to the drives, and to this side unless its bus is off."""
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
