"""Energy that an admittance display may still give out, by each certificate: lower bounds, for all axes together.

Each axis has its own drive and its own hand, so that margins and losses of the axes add up (D4 of
`docs/theory/commands_of_a_display.md`). A command is sent if one margin covers what all queued commands and this one
can use up of it. Any energy that is dissipated or leaked reduces every margin.
"""

from collections.abc import Sequence
from math import inf
from typing import ClassVar

from canhaptic.control.admittance.declared_hand import HeardForce
from canhaptic.control.admittance.guarded_axis import GuardedAxis
from canhaptic.control.admittance.late_margin import LateMargin
from canhaptic.control.balance import Certificate


class _OfAxes(LateMargin):
    """Margin of some axes together."""

    def __init__(self, axes: Sequence[GuardedAxis], latency: int) -> None:
        super().__init__(latency)
        self._axes = axes


class ByLoop(_OfAxes):
    """Margin W = E - sum of V, by the velocity loops of the drives: for every hand."""

    certificate: ClassVar[int] = Certificate.VELOCITY_LOOP.value

    def used(self) -> float:
        """Return the most that all queued commands can use up [J]."""
        used = 0.0
        for axis in self._axes:
            used += axis.used()
        return used

    def fastest(self, request: float, budget: float) -> float:
        """Return the largest certified speed of a single axis in the direction of a request [m/s or rad/s]."""
        axis = self._axes[0]
        return axis.loop.fastest(axis.drive.lead, axis.commands, budget, 1.0 if request >= 0.0 else -1.0)


class ByForce(_OfAxes):
    """Margin E - sum of G, for a hand of bounded force on each axis (D2)."""

    certificate: ClassVar[int] = Certificate.LARGEST_HAND_FORCE.value

    def used(self) -> float:
        """Return the most that all queued commands can use up [J]."""
        return sum([axis.force.used(axis.commands) for axis in self._axes])

    def fastest(self, request: float, budget: float) -> float:
        """Return the largest certified speed of a single axis [m/s or rad/s]."""
        return self._axes[0].force.fastest(self._axes[0].commands, budget)

    def lost(self) -> float:
        """Return a bound on the fall of the margin in the hold that ended [J]."""
        return sum([axis.force.lost(axis.commands) for axis in self._axes])


class ByDeclaredHand:
    """Margin A = E - sum of M s^2 / 2 at the SYNC of the last force, for hands of declared impedance (D1).

    Attributes:
        known: Lower bound of the margin [J].
    """

    certificate: ClassVar[int] = Certificate.DECLARED_HAND.value

    def __init__(self, axes: Sequence[GuardedAxis]) -> None:
        self._axes, self.known = axes, 0.0

    def hear(self, late: float, heard: Sequence[HeardForce]) -> None:
        """Update the margin with a reading of every axis, at a SYNC where at least `late` had come in [J]."""
        found = [axis.declared.hear(of) for axis, of in zip(self._axes, heard, strict=True)]
        least, gained = late - sum([stored for stored, _ in found]), sum([gain for _, gain in found])
        self.known = max(least, self.known + gained) if gained > -inf else least

    def used(self) -> float:
        """Return the most that all queued commands can use up [J]; infinite if a force is missing."""
        return sum([axis.declared.used(axis.commands) for axis in self._axes])

    def fastest(self, request: float, budget: float) -> float:
        """Return the largest certified speed of a single axis in the direction of a request [m/s or rad/s]."""
        return self._axes[0].declared.fastest_speed(self._axes[0].commands, request, budget)
