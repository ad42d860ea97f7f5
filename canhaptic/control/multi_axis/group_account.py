"""The account of a group between holds: one scalar balance for all its torques, and the certificates of the next."""

import math
from collections.abc import Sequence

from canhaptic.control.certificates import lost_samples
from canhaptic.control.certificates.lost_samples import Gap
from canhaptic.control.multi_axis import group_certificates as bound
from canhaptic.control.multi_axis.group_certificates import AxisLimits
from canhaptic.control.multi_axis.group_commands import GroupCommands, Values
from canhaptic.control.multi_axis.per_axis_certificates import PerAxisBound
from canhaptic.control.passivity.settlement import settle


class GroupAccount:
    """Store, surplus and certificates.

    Attributes:
        h_s: Stored energy that the network may still give [J].
        h_dis: Surplus still to be dissipated [J].
        dissipated: By the devices for certain, and not forgotten [J].
        unsure: How much less than booked may have come in so far [J]: encoder counts and lost samples.
    """

    def __init__(self, axes: AxisLimits, commands: GroupCommands, credit: float, losses: int = 0) -> None:
        """Makes an empty account.

        Args:
            axes: What the certificates know of the motor axes.
            commands: Of the same group.
            credit: Energy that may be given out before any came in [J].
            losses: Consecutive cycles without a new torque, on any axis, that the certificates survive.
        """
        self._axes, self._commands, self._credit = axes, commands, credit
        self._losses = losses
        self._apart = PerAxisBound(axes, commands.delay, losses) if losses else None
        self._coarse = any(axes.count)
        self.reset()

    def reset(self) -> None:
        """Nothing stored, nothing owed, at rest."""
        zeros: Values = (0.0,) * len(self._axes.count)
        self.h_s = self.h_dis = self.dissipated = self.unsure = 0.0
        self._unsure = self._kept_back = 0.0
        self._displacement, self._torques, self._blur = zeros, zeros, zeros
        self._still = zeros

    def ended_hold(self, displacement: Values, torques: Values) -> None:
        """Takes one hold: displacements [rad or m] and the torques applied in it [N*m or N]."""
        axes = self._axes
        if axes.by_damping or self._coarse:
            unsure = 0.0
            for i, torque in enumerate(torques):
                count = axes.count[i]
                certain = abs(displacement[i]) - count
                if certain > 0.0:
                    self.dissipated += axes.damping[i] * certain * certain
                self._unsure += 0.5 * count * abs(torque - self._torques[i])
                unsure += 0.5 * count * abs(torque)
            self.unsure = self._unsure + unsure
        self._blur = self._still
        self._displacement, self._torques = displacement, torques

    def ended_gap(self, displacement: Values, sent: tuple[Values, ...], carried: tuple[Values, ...]) -> float:
        """Takes several holds of which only the whole displacement is known; returns how much less may have come in.

        In every hold but the last, whose torque was read back, each axis may have held any torque sent for it until
        then, or the one of the hold before (`lost_samples`).

        Args:
            displacement: In all of them, (axes,) [rad or m].
            sent: Torques for each of the holds, (axes,) each; of the last one those applied [N*m or N].
            carried: Motion of a mover in each of them, (axes,) each; empty where nothing moves [rad or m].
        """
        axes, holds, last, before = self._axes, len(sent), sent[-1], self._torques
        largest = [max([abs(torques[i]) for torques in (before, *sent)]) for i in range(len(last))]
        reached = [b + d for b, d in zip(axes.before, axes.during, strict=True)]
        push = math.sqrt(sum([r * t * t for r, t in zip(reached, largest, strict=True)])) + axes.hand
        doubt = 0.0
        blur: list[float] = []
        for i, moved in enumerate(displacement):
            count, step = axes.count[i], math.sqrt(reached[i]) * push if axes.by_hand else 0.0
            gap = Gap(holds, moved, self._displacement[i], count, self._blur[i] + count, step, axes.lost[i])
            candidates = [[before[i], *[torques[i] for torques in sent[:j]]] for j in range(1, holds)]
            doubt += self._doubt(i, gap, candidates, last[i])
            for torques, motion in zip(candidates, carried, strict=False):  # not of the last hold
                doubt += max([(last[i] - torque) * motion[i] for torque in torques])
            excursion = abs(moved) + count + holds * (abs(gap.start) + gap.blur + holds * step)
            blur.append(0.5 * (holds - 1) * step + axes.lost[i] * holds * excursion)
            self._unsure += holds * count * largest[i]
            certain = abs(moved) - count
            if certain > 0.0:
                self.dissipated += axes.damping[i] * certain * certain / holds
        self._blur = tuple(blur) if axes.by_hand else self._still
        self.unsure = self._unsure + sum([0.5 * c * abs(t) for c, t in zip(axes.count, last, strict=True)])
        self._displacement, self._torques = tuple([d / holds for d in displacement]), last
        return doubt if doubt > 0.0 else 0.0

    def _doubt(self, axis: int, gap: Gap, candidates: list[list[float]], last: float) -> float:
        """Returns how much less than booked may have come in by one axis [J]."""
        axes = self._axes
        if axes.by_hand:
            return lost_samples.worst(gap, last, candidates)
        if axes.path:
            return lost_samples.worst_of_path(axes.path, last, candidates)
        return lost_samples.worst_damped(gap, last, candidates, axes.damping[axis])

    def book(
        self, h_i: float, h_pas: float, lost: float, ceiling: float, coming: tuple[Values, ...]
    ) -> tuple[float, float, float, float]:
        """Books one hold into store and surplus; returns (h_r, deficit, leak, paid) [J].

        Args:
            h_i: Interaction energy of the hold, supplied energy included [J].
            h_pas: Part of it taken by the modulated damper [J].
            lost: What the dissipators of the network took [J]; below 0 counts as 0.
            ceiling: What the network stores at its state [J]; more is not kept.
            coming: Motion of a mover in the holds to come, (axes,) each; empty where nothing moves [rad or m].
        """
        h_s, surplus = self.h_s + h_i - h_pas, self.h_dis - h_pas
        slack = 0.0
        if lost > 0.0 or h_s > ceiling:
            slack = min(self._free(h_s - surplus + self._credit, coming), h_s)
        self.h_s, self.h_dis, h_r, deficit, leak, paid = settle(h_s, surplus, lost, ceiling, slack)
        self._kept_back += h_r + leak - paid
        return h_r, deficit, leak, paid

    def certain(self) -> float:
        """Returns the energy [J] that the next torques may take out; see `Guarded`."""
        energy = self.h_s - self.h_dis + self._credit
        lacking = self.unsure - self._kept_back
        return energy - lacking if lacking > 0.0 else energy

    def keep(self, energy: float, enough: float) -> None:
        """Forgets what the devices dissipated beyond `enough` [J] together with `energy`."""
        if energy + self.dissipated > enough:
            self.dissipated = max(0.0, enough - energy)

    def fade(self, share: float) -> None:
        """Keeps a share of what the devices dissipated and the account together, out of contact."""
        if self.dissipated:
            energy = self.h_s - self.h_dis
            self.keep(energy, share * max(0.0, energy + self.dissipated))

    def _base(self, torques: Sequence[float], under_way: list[Values]) -> float:
        axes = self._axes
        along = bound.along_last(axes, torques, self._displacement, self._blur)
        return bound.base_of(axes, torques, self._displacement, along, self._torques, under_way)

    def _extractions(self, under_way: list[Values], coming: tuple[Values, ...]) -> list[float]:
        """Returns the most energy [J] that each of the torques under way may take out in its hold."""
        return [
            self._base(torques, under_way[:k])
            + bound.gain_of(self._axes, torques)
            + (bound.taken_by_mover(torques, coming[k]) if coming else 0.0)
            if any(torques)
            else 0.0
            for k, torques in enumerate(under_way)
        ]

    def _moved_at_most(self, under_way: list[Values], coming: tuple[Values, ...]) -> float:
        """Returns what a mover takes [J] in the holds of torques under way in which it takes anything."""
        total = 0.0
        for torques, moved in zip(under_way, coming, strict=False):
            taken = bound.taken_by_mover(torques, moved)
            if taken > 0.0:
                total += taken
        return total

    def _free(self, energy: float, coming: tuple[Values, ...]) -> float:
        """Returns how much of `energy` [J] is not needed by the certificates of the torques under way."""
        axes, under_way = self._axes, self._commands.under_way
        if self._apart is not None:
            return self._free_apart(self._apart, energy, coming)
        if not under_way:
            return energy + self.dissipated
        free, moved = 0.0, self._moved_at_most(under_way, coming)
        if axes.by_hand:
            worst = given = 0.0
            for extraction in self._extractions(under_way, coming):
                given += extraction
                worst = max(worst, given)
            free = energy - worst
        if axes.path:
            free = max(free, energy - moved - sum(bound.path_need(axes, torques) for torques in under_way))
        if axes.by_damping:
            needed = moved + sum(bound.damping_need(axes, torques) for torques in under_way)
            free = max(free, energy + self.dissipated - needed)
        return free if free > 0.0 else 0.0

    def shares(self, torques: Sequence[float], energy: float, coming: tuple[Values, ...]) -> tuple[float, float, float]:
        """Returns how much of the torques each certificate admits: hand force, device damping, hand speed; may be > 1.

        Args:
            torques: W, for the next free hold [N*m or N].
            energy: That may be taken out [J].
            coming: Motion of a mover in the holds to come, (axes,) each; empty where nothing moves [rad or m].
        """
        axes, under_way = self._axes, self._commands.under_way
        if self._apart is not None:
            return self._shares_apart(self._apart, tuple(torques), energy, coming)
        by_force = by_damping = by_speed = moved = 0.0
        if coming:
            moved = bound.taken_by_mover(torques, coming[self._commands.delay])
        if axes.by_hand:
            budget = energy
            for acting, extraction in zip(under_way, self._extractions(under_way, coming), strict=True):
                same = sum(a * b for a, b in zip(acting, torques, strict=True)) >= 0.0
                budget -= extraction if same else max(0.0, extraction)
            base = self._base(torques, under_way) + moved
            by_force = bound.share_within(budget, base, bound.gain_of(axes, torques))
        if axes.by_damping:
            budget = energy + self.dissipated - max(0.0, moved) - self._moved_at_most(under_way, coming)
            budget -= sum(bound.damping_need(axes, acting) for acting in under_way)
            by_damping = math.sqrt(budget / bound.damping_need(axes, torques)) if budget > 0.0 else 0.0
        if axes.path:
            budget = energy - self._moved_at_most(under_way, coming)
            budget -= sum(bound.path_need(axes, acting) for acting in under_way)
            by_speed = budget / (bound.path_need(axes, torques) + max(0.0, moved)) if budget > 0.0 else 0.0
        return by_force, by_damping, by_speed

    def raised(self, torques: Values, share: float, energy: float) -> Values:
        """Returns torques scaled by a share, or more on axes that take energy in; see `PerAxisBound.raised`.

        Right after `shares`.

        Args:
            torques: W, (axes,) [N*m or N].
            share: Admitted by the hand-force certificate.
            energy: That may be taken out [J].
        """
        if self._apart is None or not self._axes.by_hand:
            return tuple([share * torque for torque in torques])
        return self._apart.raised(torques, share, energy)

    def _free_apart(self, apart: PerAxisBound, energy: float, coming: tuple[Values, ...]) -> float:
        axes = self._axes
        apart.take(self._displacement, self._blur, self._torques, self._commands.under_way, coming)
        nothing, free = (0.0,) * len(axes.count), 0.0
        moved = apart.moved(nothing)[0]
        if axes.by_hand:
            free = energy - apart.needed_by_hand()
        if axes.path:
            free = max(free, energy - moved - axes.path * sum(apart.needs(nothing, 1)[0]))
        if axes.by_damping:
            old = zip(apart.needs(nothing, 2)[0], axes.damping, strict=True)
            free = max(free, energy + self.dissipated - moved - sum(f / (4.0 * b) for f, b in old))
        return free if free > 0.0 else 0.0

    def _shares_apart(
        self, apart: PerAxisBound, torques: Values, energy: float, coming: tuple[Values, ...]
    ) -> tuple[float, float, float]:
        """Returns `shares` for axes that may act apart; none is above 1 by hand force."""
        axes = self._axes
        apart.take(self._displacement, self._blur, self._torques, self._commands.under_way, coming)
        by_force = by_damping = by_speed = 0.0
        moved, more = apart.moved(torques)
        if axes.by_hand:
            by_force = apart.share_by_hand(torques, energy)
        if axes.by_damping:
            old, new = apart.needs(torques, 2)
            budget = energy + self.dissipated - moved - more
            budget -= sum(f / (4.0 * b) for f, b in zip(old, axes.damping, strict=True))
            need = sum(f / (4.0 * b) for f, b in zip(new, axes.damping, strict=True))
            by_damping = _root_of(budget, need)
        if axes.path:
            old, new = apart.needs(torques, 1)
            by_speed = _root_of(energy - moved - axes.path * sum(old), axes.path * sum(new) + more) ** 2
        return by_force, by_damping, by_speed


def _root_of(budget: float, need: float) -> float:
    """Returns sqrt(budget / need); 1 where nothing more is needed than there is."""
    if budget < 0.0:
        return 0.0
    return math.sqrt(budget / need) if need > 0.0 else 1.0
