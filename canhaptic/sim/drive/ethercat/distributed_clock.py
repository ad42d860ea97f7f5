"""The distributed clock of a simulated EtherCAT drive (ETG.1000.4, 7.2): local time, system time, drift servo, SYNC0.

Three times, all in integer nanoseconds: that of the host; the local time, which runs off from it by some ppm; and the
system time, which is the local time plus an offset. The reference clock's system time reaches the others in a frame,
and each shifts its offset towards it: without this drift servo two clocks count different holds.
"""

from typing import Final

_PPB: Final = 1_000_000_000
_MASK: Final = (1 << 64) - 1
_CATCH: Final = 1_000_000  # [ns] a larger difference is for the offset, which the master writes
_LARGEST_STEP: Final = 50_000  # [ns] by which one frame shifts the clock
_STEPS: Final = 8  # parts of a difference of which one frame takes one away
_SIGN: Final = 1 << 31
_SHORTEST: Final = 1_000  # [ns] from one SYNC0 to the next


class DistributedClock:
    """Clock of one drive.

    Args:
        drift_ppb: Rate of the clock against the host's [1e-9].
        epoch: Local time at host time 0 [ns].
        has_servo: Whether it follows the reference clock.

    Attributes:
        offset: System time minus local time (0x0920) [ns].
        delay: Propagation delay from the reference clock (0x0928) [ns].
        difference: Amount by which it differed from the system time received last (0x092C) [ns]; bit 31: behind it.
        period: Cycle of SYNC0 (0x09A0) [ns].
        next_sync: System time of the next SYNC0 [ns]; None while it is off.
    """

    def __init__(self, drift_ppb: int = 0, epoch: int = 0, *, has_servo: bool = True) -> None:
        self._drift, self._epoch, self._has_servo = drift_ppb, epoch, has_servo
        self.offset = self.delay = self.difference = self.period = 0
        self.next_sync: int | None = None

    def local(self, now: int) -> int:
        """Return the local time at a host time [ns]."""
        return now + self._epoch + (now * self._drift // _PPB if self._drift else 0)

    def system(self, now: int) -> int:
        """Return the system time at a host time [ns], as its 64 bits show it."""
        if self._drift:
            now += now * self._drift // _PPB
        return (now + self._epoch + self.offset) & _MASK

    def host(self, system: int) -> int:
        """Return the first host time at which the system time has come [ns]."""
        local = system - self.offset - self._epoch
        if not self._drift:
            return local
        now = local * _PPB // (_PPB + self._drift) - 1
        while self.local(now) < system - self.offset:
            now += 1
        return now

    def start(self, first: int, now: int) -> bool:
        """Start SYNC0 at a system time [ns]; return False for one that has passed, at which it never comes."""
        is_ahead = first > self.local(now) + self.offset and self.period >= _SHORTEST
        self.next_sync = first if is_ahead else None
        return is_ahead

    def shift(self, offset: int, now: int) -> None:
        """Set the offset [ns]; SYNC0 ends where its time is passed over: it comes when the time is met."""
        self.offset = offset
        if self.next_sync is not None and self.next_sync <= self.local(now) + offset:
            self.next_sync = None

    def follow(self, received: int, now: int) -> None:
        """Shift the clock towards the system time of the reference clock, received now [ns]."""
        ahead = self.local(now) + self.offset - received - self.delay
        if ahead:
            self.difference = min(abs(ahead), _SIGN - 1) | (_SIGN if ahead < 0 else 0)
            if self._has_servo and -_CATCH < ahead < _CATCH:
                step = (ahead + _STEPS // 2) // _STEPS
                self.offset -= max(-_LARGEST_STEP, min(_LARGEST_STEP, step))
        else:
            self.difference = 0
