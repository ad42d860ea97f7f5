"""The schedule of a rig: when the next SYNC is due, and which deadlines were missed.

Deadlines are absolute. One that is missed is skipped and counted, never caught up: a burst of SYNCs would make drives
sample and hold at intervals other than the sample time.
"""


class Pace:
    """Deadlines of SYNC, one each sample time.

    Args:
        period: Sample time [ns].

    Attributes:
        due: Deadline of the next SYNC [ns].
        deadline: Deadline of the last SYNC [ns].
        periods: Sample times between the last two SYNCs; more than 1 after a skip.
        uneven: Duration of the last hold minus its whole sample times, as the clock that leads shows them [ns].
        skipped: Deadlines missed and skipped since `begin`.
        synced: Time at which the last SYNC was sent [ns].
        shifted: Time by which deadlines were moved forward in all, to follow the clock of a drive [ns].
        times_holds: Whether SYNC times the holds of some drive, and not the clock of a drive that of all.
    """

    def __init__(self, period: int) -> None:
        self.period = period
        self._latest = period // 2  # a deadline missed by more is skipped
        self.times_holds = True
        self.begin(0)

    def begin(self, now: int) -> None:
        """Restart the schedule: the next SYNC is due now, and later deadlines count from it."""
        self.periods = 1
        self.uneven = self.skipped = self.shifted = self._moved = 0
        self.due = self.deadline = self.synced = self._logged = now

    def shift(self, forward: int) -> None:
        """Move the next deadline forward by a time [ns], as the clock of a drive demands."""
        self.due -= forward
        self.shifted += forward
        self._moved += forward

    def index_after(self, first: int) -> int:
        """Return the sample times from a deadline [ns], itself unshifted, to the last one."""
        return (self.deadline + self.shifted - first + self._latest) // self.period

    def leave_one_out(self) -> None:
        """Delay the next SYNC by one sample time."""
        self.due += self.period

    def is_met(self, woken: int) -> bool:
        """Whether the deadline is met by who woke at this time [ns]; else it is skipped for the next."""
        lateness = woken - self.due
        if lateness > self._latest:
            self._skip(lateness)
            return False
        self.deadline = self.due
        self.due += self.period
        return True

    def sent(self, synced: int) -> None:
        """Count the periods since the SYNC before, from the time at which this one was sent [ns]."""
        period, latest = self.period, self._latest
        logged = synced - synced % 1000  # to the microsecond, as a bus log keeps it: a replay counts the same periods
        self.periods = periods = (logged - self._logged + latest) // period or 1
        self.uneven = abs(synced - self.synced - periods * period + self._moved)
        self._moved = 0
        self.synced, self._logged = synced, logged
        if synced - self.deadline > latest:  # held up after the wait: the next must not follow at once
            self._skip(synced - self.deadline)

    def _skip(self, lateness: int) -> None:
        """Skip the deadlines that were missed, up to the nearest."""
        skipped = (lateness + self._latest) // self.period
        self.skipped += skipped
        self.deadline += lateness // self.period * self.period
        self.due += skipped * self.period
