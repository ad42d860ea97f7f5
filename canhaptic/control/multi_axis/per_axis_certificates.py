"""The certificates for axes that may act apart: each holds its new torque, an older one, or a part of either.

`bound` holds for torques that act together. Where a frame is lost, a link policy ramps, or a limiter or drive cuts one
axis alone, the group's torque turns, and energy that one axis was to bring in is missing while another still gives it
out. With `max_consecutive_losses` = L declared, the energy is certified axis by axis: in every hold from now on, axis i
may have any torque between 0 and one of those sent for it, each of which may stay for L more holds. With D_ij the
displacement of axis i in hold j, counted along such a torque f,

    energy out <= sum over holds and axes of max over f of max(0, f D_ij),
    D_ij <= D_i0 + j sqrt(r_i) (N + h),        r_i = T^2 / m_i,

N the largest |f|_r of all torques that may act, h that of the hand: for any inertia M >= diag(m) one axis answers to
the torques of all with no more than this (Cauchy-Schwarz). f D_ij grows with f where it is positive, so that the ends
of the interval are enough. With the new torques scaled by l <= 1, N <= N_0 + l N_1 with
N_1^2 = sum(r_i max(0, W_i^2 - f_i^2)), f_i the largest sent before. Every term is a parabola in l, their sum convex,
and the largest l within the budget is found by solving for the terms that count at the last one, from l = 1 down.

A mover's motion, known in advance, is taken off D_ij (`bound`). The hand counts axis by axis as well: a force across
the torque of the group that pulls one axis along its own torque is part of the declared force.
"""

import math
from collections.abc import Sequence
from typing import Final

from canhaptic.control.multi_axis.group_certificates import AxisLimits, share_within
from canhaptic.control.multi_axis.group_commands import Values

_PASSES: Final = 24
"""Of the search for a share; what needs more renders nothing."""
_ROUNDING: Final = 1e-12

_Parabola = tuple[float, float, float]
"""A + B l + C l^2 [J]."""


class PerAxisBound:
    """What the torques under way may still give out, and how much of new ones may be added."""

    def __init__(self, axes: AxisLimits, delay: int, losses: int) -> None:
        """Keeps what is known.

        Args:
            axes: What the certificates know of the motor axes.
            delay: Whole holds between computation and action.
            losses: Consecutive cycles in which an axis may be without a new torque.
        """
        self._axes, self._delay, self._losses = axes, delay, losses
        whole = [b + d for b, d in zip(axes.before, axes.during, strict=True)]
        self._responses, self._roots = whole, [math.sqrt(r) for r in whole]
        self._first = max([d / r if r else 0.0 for d, r in zip(axes.during, whole, strict=True)])
        self._holds = delay + 1 + losses

    def take(
        self, displacement: Values, blur: Values, torques: Values, under_way: Sequence[Values],
        coming: tuple[Values, ...] = (),
    ) -> None:  # fmt: skip
        """Takes the hold that ended and the torques that may still act.

        Args:
            displacement: In the hold that ended, (axes,) [rad or m].
            blur: How much further each axis may have moved in it (axes,).
            torques: Held in it, (axes,) [N*m or N].
            under_way: Sent, and to act before the next command.
            coming: Motion of a mover in the holds to come, (axes,) each; empty where nothing moves [rad or m].
        """
        self._coming = coming
        axes, losses, sent = self._axes, self._losses, (torques, *under_way)
        self._committed = [
            sent[max(0, hold - losses) : min(hold, self._delay) + 1] for hold in range(1, self._holds + 1)
        ]
        self._largest = [max([abs(values[i]) for values in sent]) for i in range(len(torques))]
        self._starts = []
        for i, moved in enumerate(displacement):
            slack = axes.count[i] + blur[i]
            along = slack + moved, slack - moved
            self._starts.append([(start, axes.lost[i] * max(0.0, -start)) for start in along])

    def _cells(self, torques: Sequence[float], fixed: Sequence[float] = ()) -> list[list[_Parabola]]:
        """Returns what each axis may give out in each hold: the largest of some parabolas, and of 0.

        Args:
            torques: W, (axes,), of which the share l is to be found.
            fixed: Torques sent whatever l is, on axes without W; none where left out.
        """
        largest = [max(f, abs(t)) for f, t in zip(self._largest, fixed, strict=True)] if fixed else self._largest
        norm = math.sqrt(sum([r * f * f for r, f in zip(self._responses, largest, strict=True)])) + self._axes.hand
        more = math.sqrt(
            sum([r * max(0.0, t * t - f * f) for r, t, f in zip(self._responses, torques, largest, strict=True)])
        )
        cells = []
        for index, committed in enumerate(self._committed):
            hold, mine = index + 1, index - self._delay
            grown = more * (mine + self._first) if mine >= 0 else 0.0
            for i, root in enumerate(self._roots):
                pieces = []
                for sign, (start, lost) in zip((1.0, -1.0), self._starts[i], strict=True):
                    base = start + hold * (lost + root * norm)
                    if self._coming:
                        base -= sign * self._coming[index][i]
                    slope = root * grown
                    old = max([sign * values[i] for values in committed], default=0.0)
                    new = sign * torques[i]
                    if mine >= 0 and fixed:
                        old = max(old, sign * fixed[i])
                    if old > 0.0:
                        pieces.append((old * base, old * slope, 0.0))
                    if mine >= 0 and new > 0.0:
                        pieces.append((0.0, new * base, new * slope))
                cells.append(pieces)
        return cells

    def needed_by_hand(self) -> float:
        """Returns the most energy [J] that the torques under way may give out to a hand within its declared force."""
        nothing = (0.0,) * len(self._roots)
        return sum([max([0.0, *[piece[0] for piece in pieces]]) for pieces in self._cells(nothing)])

    def share_by_hand(self, torques: Values, budget: float) -> float:
        """Returns the largest share l <= 1 of new torques within a budget [J]; 0 where none is.

        Args:
            torques: W, (axes,) [N*m or N].
            budget: [J].
        """
        return _largest_share(self._cells(torques), budget)

    def raised(self, torques: Values, share: float, budget: float) -> Values:
        """Returns torques of which axes that move against theirs get more than the share of all.

        Such an axis takes energy in whatever the others do; without it no group would begin from an empty account, as
        the first torque of an axis at rest gives out F^2 T^2 / 2m. The force of a group turns by it while the account
        is short. What costs nothing at all is sent in debt as well.

        Args:
            torques: W, (axes,) [N*m or N].
            share: That all axes may have.
            budget: [J].
        """
        found = [share * torque for torque in torques]
        starts = [
            self._starts[i][0 if torque > 0.0 else 1][0] * abs(torque) for i, torque in enumerate(torques)
        ]  # fmt: skip
        budget = max(budget, self.needed_by_hand())
        for axis in sorted(range(len(torques)), key=starts.__getitem__):
            if starts[axis] < 0.0:
                alone = [torque if i == axis else 0.0 for i, torque in enumerate(torques)]
                others = [0.0 if i == axis else torque for i, torque in enumerate(found)]
                found[axis] = max(share, _largest_share(self._cells(alone, others), budget)) * torques[axis]
        return tuple(found)

    def needs(self, torques: Values, power: int) -> tuple[list[float], list[float]]:
        """Returns sums over all holds of |f_i|^power by the torques under way, and what l^power of new ones adds.

        Args:
            torques: W, (axes,); zeros for those under way alone.
            power: 1 or 2.
        """
        count = len(torques)
        old, new = [0.0] * count, [0.0] * count
        for index, committed in enumerate(self._committed):
            for i, torque in enumerate(torques):
                held = max([abs(values[i]) for values in committed], default=0.0) ** power
                old[i] += held
                if index >= self._delay:
                    new[i] += max(0.0, abs(torque) ** power - held)
        return old, new

    def moved(self, torques: Values) -> tuple[float, float]:
        """Returns what a mover takes at most [J] of the torques under way, and how much more of new ones.

        Args:
            torques: W, (axes,); zeros for those under way alone.
        """
        old = new = 0.0
        for index, (committed, motion) in enumerate(zip(self._committed, self._coming, strict=False)):
            for i, moved in enumerate(motion):
                held = max([0.0, *[-values[i] * moved for values in committed]])
                old += held
                if index >= self._delay:
                    new += max(0.0, -torques[i] * moved - held)
        return old, new


def _largest_share(cells: list[list[_Parabola]], budget: float) -> float:
    """Returns the largest l <= 1 at which the cells, each the largest of its parabolas and 0, sum to the budget [J]."""
    share = 1.0
    for _ in range(_PASSES):
        fixed = linear = square = 0.0
        for pieces in cells:
            most = 0.0
            active = 0.0, 0.0, 0.0
            for piece in pieces:
                value = piece[0] + share * (piece[1] + share * piece[2])
                if value > most:
                    most, active = value, piece
            fixed, linear, square = fixed + active[0], linear + active[1], square + active[2]
        size = abs(fixed) + share * (abs(linear) + share * square)
        if fixed + share * (linear + share * square) <= budget + _ROUNDING * size:
            return share
        smaller = share_within(budget - fixed, linear, square)
        if not smaller < share:
            return 0.0
        share = smaller
    return 0.0
