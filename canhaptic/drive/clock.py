"""Clocks of the master and a histogram of durations, in integer nanoseconds; no other module reads the time.

`WallClock` sleeps to within a margin of the deadline and spins the rest: the wake-up is accurate to a microsecond,
where a plain sleep is late by some 80 us. `VirtualClock` advances only when its owner waits: master and simulated
drives then run in lock-step in one thread, as fast as the machine allows and with the same result every time.

`DurationHistogram` keeps the durations of a whole run in constant memory: bins of 1 us and an exact maximum.
"""

import time
from collections.abc import Sequence
from itertools import accumulate
from typing import Final, Protocol, TypeVar

from canhaptic.signals import SimulatedPeer

_Frame = TypeVar("_Frame")
_Received = TypeVar("_Received", covariant=True)


class FrameSource(Protocol[_Received]):
    """What frames come from: a `can.BusABC` is one."""

    def recv(self, timeout: float | None = None) -> _Received | None:
        """Return the next frame, or None when none came within `timeout` [s]."""


class Clock(Protocol):
    """Clock of the master: the time, and the waits for deadlines and frames."""

    def now(self) -> int:
        """Return the time [ns] since the clock's own epoch."""

    def wait_until(self, deadline: int) -> None:
        """Return when `deadline` [ns] has come; at once when it has passed."""

    def receive(self, bus: FrameSource[_Frame], deadline: int) -> _Frame | None:
        """Return the next frame of `bus`, or None when none came until `deadline` [ns]."""


class ProcessorClock:
    """Time that the calling thread has used of a processor, which other programs lengthen little."""

    def now(self) -> int:
        """Return the processor time of this thread [ns]."""
        return time.thread_time_ns()


class WallClock:
    """Real time; drives simulated in this process run while it waits.

    Args:
        far_sides: Simulated drives inside this process; none for real hardware.
        spin_margin: Time before a deadline from which it spins [s].
    """

    def __init__(self, far_sides: Sequence[SimulatedPeer] = (), spin_margin: float = 200e-6) -> None:
        self._far_sides = tuple(far_sides)
        self._margin = round(spin_margin * 1e9)

    def now(self) -> int:
        """Return CLOCK_MONOTONIC [ns]."""
        return time.monotonic_ns()

    def wait_until(self, deadline: int) -> None:
        """Sleep, then spin, until `deadline` [ns]; simulated drives run meanwhile."""
        now = time.monotonic_ns()
        while now < deadline:
            if idle := self._process(deadline, now):
                time.sleep(idle)
            now = time.monotonic_ns()

    def receive(self, bus: FrameSource[_Frame], deadline: int) -> _Frame | None:
        """Return the next frame, or None at `deadline` [ns]: block, then poll, then spin."""
        now = time.monotonic_ns()
        while True:
            idle = self._process(deadline, now)
            if deadline - now <= 20_000:  # [ns]: polling on could oversleep the deadline
                break
            message = bus.recv(idle)  # simulated drives have answered; frames of others end the wait at once
            if message is not None:
                return message
            now = time.monotonic_ns()
        while time.monotonic_ns() < deadline:
            pass
        return bus.recv(0.0)

    def _process(self, deadline: int, now: int) -> float:
        """Run the simulated drives; return the time [s] until their next event or `deadline`."""
        wake = deadline
        for far_side in self._far_sides:
            far_side.process(now)
            wake = min(wake, far_side.next_due())
        idle = wake - self._margin - time.monotonic_ns()
        return idle * 1e-9 if idle > 60_000 else 0.0  # a shorter sleep takes this long anyhow


class VirtualClock:
    """Time that advances only when its owner waits, and then jumps to the next event of the simulated drives.

    Args:
        far_sides: Simulated drives that share a virtual bus with the master, in this thread.
        start: The time at the beginning [ns].
    """

    def __init__(self, far_sides: Sequence[SimulatedPeer] = (), start: int = 0) -> None:
        self._far_sides = tuple(far_sides)
        self._now = start
        if len(self._far_sides) == 1:  # the usual case, without a loop: this runs for every frame
            self._process, self._next_due = self._far_sides[0].process, self._far_sides[0].next_due
        else:
            self._process, self._next_due = self._process_all, lambda: self._next_after(-1)

    def now(self) -> int:
        """Return virtual time [ns]."""
        return self._now

    def wait_until(self, deadline: int) -> None:
        """Run the simulated drives until `deadline` [ns]."""
        while self._now < deadline:
            self._process(self._now)
            self._now = min(deadline, self._next_event(self._now))

    def receive(self, bus: FrameSource[_Frame], deadline: int) -> _Frame | None:
        """Return the next frame; virtual time moves, up to `deadline` [ns], only while there is none."""
        while True:
            now = self._now
            self._process(now)
            message = bus.recv(0.0)
            if message is not None or now >= deadline:
                return message
            event = self._next_event(now)
            if event > deadline:
                self._now = deadline
                return None
            self._now = event

    def _process_all(self, now: int) -> None:
        for far_side in self._far_sides:
            far_side.process(now)

    def _next_event(self, now: int) -> int:
        """Return the time of the next event after `now` [ns]; overdue timers are left out, so that time goes on."""
        due = self._next_due()
        return due if now < due else self._next_after(now)

    def _next_after(self, now: int) -> int:
        return min((due for far_side in self._far_sides if (due := far_side.next_due()) > now), default=1 << 62)


_BIN: Final = 1_000  # [ns]
_BINS: Final = 20_000  # durations of 20 ms and more share the last bin; their maximum is kept exactly


class DurationHistogram:
    """Counts of durations [ns], for quantiles accurate to one bin (1 us)."""

    def __init__(self) -> None:
        self._counts = [0] * (_BINS + 1)
        self.total = self.maximum = 0

    def add(self, duration: int) -> None:
        """Count one duration [ns]; a negative one counts as zero."""
        index = duration // _BIN
        self._counts[0 if index < 0 else index if index < _BINS else _BINS] += 1
        self.total += 1
        if duration > self.maximum:
            self.maximum = duration

    def quantile(self, fraction: float) -> float:
        """Return the duration [s] that `fraction` of all entries do not exceed, rounded up to a bin; 0 when empty."""
        if not self.total:
            return 0.0
        sums = enumerate(accumulate(self._counts))
        index = next(n for n, seen in sums if seen and seen >= fraction * self.total)
        return min((index + 1) * _BIN, self.maximum) * 1e-9 if index < _BINS else self.maximum * 1e-9

    def summary(self) -> dict[str, float]:
        """Return p50, p99, p99.9 and the maximum [s]."""
        quantiles = {name: self.quantile(part) for name, part in (("p50", 0.5), ("p99", 0.99), ("p99.9", 0.999))}
        return {**quantiles, "max": self.maximum * 1e-9}
