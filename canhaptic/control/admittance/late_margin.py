"""Lower bound of an energy margin whose forces come late.

Between two SYNCs a margin falls by no more than the commands can cause: its `change`. A late force gives a bound on the
margin at an earlier SYNC, and the changes since then bring it up to date. The larger of the two bounds counts.
"""


class LateMargin:
    """Lower bound of a margin; keeps its history for late forces.

    Args:
        latency: Delay of a force in samples.

    Attributes:
        known: Lower bound of the margin [J].
        place: Index of this SYNC in the ring buffers.
        changes: Change of the margin in the hold that ended at each SYNC [J].
        before: Margin at each SYNC, plus all energy withdrawn from the account before it [J].
    """

    def __init__(self, latency: int) -> None:
        self.known, self.place = 0.0, 0
        self.changes, self.before = [0.0] * (latency + 1), [0.0] * (latency + 1)

    def fall(self, change: float, taken: float) -> None:
        """Add the change in the hold that ended; `taken` is all energy withdrawn from the account so far [J]."""
        self.known += change
        if len(self.changes) > 1:  # otherwise no force comes late
            self.place = self.oldest()
            self.changes[self.place] = change
        self.before[self.place] = self.known + taken

    def oldest(self) -> int:
        """Return the index of the SYNC to which the received force belongs."""
        then = self.place + 1
        return then if then < len(self.changes) else 0

    def known_then(self, known: float) -> float:
        """Convert a bound at this SYNC to the earlier SYNC at which the received force was measured [J]."""
        then = self.oldest()
        for place, change in enumerate(self.changes):
            if place != then:
                known -= change
        return known

    def rise(self, then: int, value: float, taken: float) -> None:
        """Raise the bound if the force proves more: at least `value` at the SYNC of index `then` [J]."""
        if then != self.place:
            for place, change in enumerate(self.changes):
                if place != then:
                    value += change
        if value > self.known:
            self.known = value
        if then == self.place:
            self.before[then] = self.known + taken
