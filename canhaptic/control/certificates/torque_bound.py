"""The certified bound of one axis: what is known of it and of the hand, applied to the torques under way."""

from collections.abc import Sequence
from dataclasses import dataclass

from canhaptic.control.certificates.scalar_bounds import (
    WINDOW,
    DisplacementResponse,
    device_damping_bound,
    hand_force_bound,
    hand_speed_bound,
    next_displacement,
)


@dataclass(frozen=True, slots=True)
class Declared:
    """What a configuration declares of the axis and of the hand. None: that certificate is not used."""

    sample_time: float
    response: DisplacementResponse | None  # of the hand-force certificate
    damping: float | None  # certain damping of the device [N*s/m or N*m*s/rad]
    speed: float | None  # largest speed of the hand [m/s or rad/s]
    encoder_count: float  # [m or rad]
    losses: int  # consecutive cycles without a new torque that the certificates survive


class TorqueBound:
    """Remembers the hold that ended and answers how much energy is committed and how large the next torque may be.

    Attributes:
        dissipated: By the device for certain, and not forgotten [J].
        unsure: How much less than booked may have come in so far [J]: encoder counts and lost samples.
    """

    __slots__ = (
        "_blur",
        "_count",
        "_declared",
        "_delay",
        "_displacement",
        "_history",
        "_kept",
        "_known_outward",
        "_mixes",
        "_newest",
        "_response",
        "_simple",
        "_torque",
        "_unsure",
        "dissipated",
        "unsure",
    )

    def __init__(self, declared: Declared, delay: int) -> None:
        self._declared = declared
        self._response, self._count = declared.response, declared.encoder_count
        self._delay = delay
        self._simple = not (delay or declared.losses)
        self._mixes = delay > 1 and declared.losses > 0  # some of those under way may act, and others not
        self.reset()

    def reset(self) -> None:
        """Forgets the last hold and the energy dissipated by the device."""
        self._displacement = self._torque = self._blur = self._unsure = 0.0
        self.dissipated = self.unsure = 0.0
        self._history = [(0.0, 0.0)] * WINDOW  # ring of displacement and torque of the last holds
        self._newest = self._kept = 0
        self._known_outward: dict[float, float] = {}  # by sign; of a coarse encoder, where finding it is work

    def ended_hold(self, displacement: float, torque: float) -> None:
        """Takes the hold that ended: displacement [m or rad] and the torque held in it [N or N*m]."""
        declared, count = self._declared, self._count
        if declared.damping is not None:
            certain = abs(displacement) - count
            if certain > 0.0:
                self.dissipated += declared.damping / declared.sample_time * certain * certain
        if count:
            half = 0.5 * count
            self._unsure = unsure = self._unsure + half * abs(torque - self._torque)
            self.unsure = unsure + half * abs(torque)
            newest = self._newest + 1
            if newest == WINDOW:
                newest = 0
            self._newest = newest
            self._history[newest] = displacement, torque
            if self._kept < WINDOW:
                self._kept += 1
            self._known_outward.clear()
        self._blur = 0.0
        self._displacement, self._torque = displacement, torque

    def ended_gap(self, displacement: float, torques: tuple[float, ...]) -> float:
        """Takes several holds of which only the whole displacement is known, with the torques sent for them.

        Returns how much less than torque applied times displacement may have come in [J]. In all but the last hold,
        whose torque was read back, any torque sent may have acted, and the one before them where commands may be lost.
        The energy is wrong by at most the difference of the torques times the excursion in the hold. The displacement
        alone does not bound it, as a reversal has next to none: the reach of the hand in the others does, or its speed,
        or what the device dissipates in an excursion.
        """
        declared, holds = self._declared, len(torques)
        last, candidates = torques[-1], (self._torque, *torques) if declared.losses else torques
        largest = max([abs(torque) for torque in candidates])
        apart = max([abs(torque - last) for torque in candidates])
        count = self._count
        self._kept = 0
        self._known_outward.clear()
        if declared.response is not None:
            response = declared.response
            step = (response.before + response.during) * largest + response.hand
            start = abs(self._displacement) + self._blur + count
            excursion = abs(displacement) + count + holds * (start + holds * step)
            self._blur = 0.5 * (holds - 1) * step + (1.0 - response.retained) * holds * excursion
            doubt = (holds - 1) * apart * excursion
        elif declared.speed is not None:
            doubt = (holds - 1) * apart * declared.speed * declared.sample_time
        else:
            doubt = self._doubt_of_every_hand(displacement, holds, apart)
        self._unsure += holds * count * largest
        self.unsure = self._unsure + 0.5 * count * abs(last)
        self._displacement, self._torque = displacement / holds, last
        return doubt

    def _doubt_of_every_hand(self, displacement: float, holds: int, apart: float) -> float:
        """Returns the energy in doubt [J] where damping alone is known, and books what is dissipated for certain.

        Args:
            displacement: In all the holds [m or rad].
            holds: How many.
            apart: Largest difference of a torque that may have acted from the last one [N or N*m]; see `lost_samples`.
        """
        declared, count = self._declared, self._count
        assert declared.damping is not None
        stiffness = declared.damping / declared.sample_time
        certain = abs(displacement) - count
        if certain > 0.0:
            self.dissipated += stiffness * certain * certain / holds
        return (holds - 1) * apart * ((abs(displacement) + count) / holds + apart / (4.0 * stiffness))

    def keep(self, energy: float, enough: float) -> None:
        """Forgets what the device dissipated beyond `enough` [J] together with `energy`.

        Without it a contact could live, and buzz, on what the device dissipated long ago.
        """
        if energy + self.dissipated > enough:
            self.dissipated = max(0.0, enough - energy)

    def free(self, energy: float, under_way: Sequence[float]) -> float:
        """Returns how much of `energy` [J] is not needed by the certificates of the torques under way."""
        if self._simple:
            return energy + self.dissipated
        declared = self._declared
        sequences, free = self._sequences(under_way), 0.0
        if self._mixes and self._response is not None:
            holds = declared.losses + self._delay
            free = energy - self._given(1.0, under_way, holds)[0] - self._given(-1.0, under_way, holds)[0]
        elif self._response is not None:
            free = energy - max([self._worst_out(1.0, s) + self._worst_out(-1.0, s) for s in sequences])
        if declared.speed is not None:
            path = declared.speed * declared.sample_time
            free = max(free, energy - path * max(sum(abs(f) for f in s) for s in sequences))
        if declared.damping:
            share = declared.sample_time / (4.0 * declared.damping)
            free = max(free, energy + self.dissipated - share * max(sum(f * f for f in s) for s in sequences))
        return free if free > 0.0 else 0.0

    def _sequences(self, under_way: Sequence[float]) -> list[Sequence[float]]:
        """Returns the torques that may act before the next one [N or N*m], in each order that counts."""
        losses = self._declared.losses
        if not losses:
            return [under_way]
        if self._mixes:
            return [self._sizes(under_way, losses + self._delay)]
        sequences: list[Sequence[float]] = [(self._torque,) * (losses + self._delay)]
        if under_way:
            sequences.append((*under_way, *(under_way[-1],) * losses))
        return sequences

    def _outward(self, sign: float) -> float:
        """Returns the largest displacement of the hold that ended, counted along `sign` [m or rad].

        The displacement is known to one count. A mean over j holds is known to count / j, and the hand and the torques
        can have raised the last one above the mean only so far; the smallest of these bounds counts.
        """
        if not self._count or self._response is None or self._kept < 2:
            return sign * self._displacement + self._count + self._blur
        known = self._known_outward.get(sign)
        if known is None:
            known = self._known_outward[sign] = self._by_windows(sign, self._response)
        return known

    def _by_windows(self, sign: float, response: DisplacementResponse) -> float:
        """Returns the smallest of the bounds by the mean over the last 1, 2, 3, ... holds [m or rad]."""
        count, before, during, hand = self._count, response.before, response.during, response.hand
        lost, enough = 1.0 - response.retained, 2.0 * count
        later = sign * self._torque if sign * self._torque > 0.0 else 0.0
        total = least = sign * self._displacement + count
        raised = raises = 0.0
        history, start = self._history, self._newest + 1
        for holds in range(2, self._kept + 1):  # the newest is taken; an index below 0 wraps, as a ring does
            displacement, torque = history[start - holds]
            along, push = sign * displacement, sign * torque
            if push < 0.0:
                push = 0.0
            raised += before * push + during * later + hand
            if along < count:
                raised += lost * (count - along)
            raises += raised
            total += along
            mean = (total + raises) / holds
            if mean < least:
                least = mean
            if raised * holds > enough:
                break
            later = push
        return least

    def _worst_out(self, sign: float, torques: Sequence[float]) -> float:
        """Returns the most energy [J] that the torques along `sign` may give out, >= 0."""
        response = self._response
        if response is None:
            return 0.0
        for torque in torques:
            if sign * torque > 0.0:
                break
        else:
            return 0.0
        displacement, before = self._outward(sign), sign * self._torque
        worst = given = 0.0
        for torque in torques:
            along = sign * torque
            displacement = next_displacement(displacement, before, along, response)
            if along > 0.0:
                given += along * displacement
                if given > worst:
                    worst = given
            before = along
        return worst

    def _may_act(self, sign: float, under_way: Sequence[float], holds: int) -> list[float]:
        """Returns the largest torque along `sign` that may act in each of the next holds [N or N*m], >= 0.

        Any torque sent may stay for the declared losses.
        """
        sent = [max(0.0, sign * torque) for torque in (self._torque, *under_way)]
        losses, newest = self._declared.losses, len(under_way)
        return [
            max([sent[place] for place in range(max(0, hold - losses), min(hold, newest) + 1)])
            for hold in range(1, holds + 1)
        ]

    def _sizes(self, under_way: Sequence[float], holds: int) -> tuple[float, ...]:
        """Returns the largest size of a torque that may act in each of the next holds [N or N*m]."""
        along, against = self._may_act(1.0, under_way, holds), self._may_act(-1.0, under_way, holds)
        return tuple([max(along[hold], against[hold]) for hold in range(holds)])

    def _given(self, sign: float, under_way: Sequence[float], holds: int) -> tuple[float, float]:
        """Returns what any mix of torques along `sign` may give out [J], and the base of one after them [m or rad].

        What one of them would take in is not counted: another may act in its place.
        """
        response = self._response
        assert response is not None
        displacement, before, given = self._outward(sign), sign * self._torque, 0.0
        for along in self._may_act(sign, under_way, holds):
            displacement = next_displacement(displacement, before, along, response)
            if displacement > 0.0:
                given += along * displacement
            before = along
        return given, next_displacement(displacement, before, 0.0, response)

    def _by_hand_force_of_any(self, sign: float, energy: float, under_way: Sequence[float]) -> float:
        """Returns `by_hand_force` where any mix of the torques under way may act."""
        response = self._response
        assert response is not None
        given, base = self._given(sign, under_way, self._delay)
        energy -= given + self._given(-sign, under_way, self._delay)[0]
        return min(hand_force_bound(energy, base, response.during), self._if_held_on(energy, base))

    def by_hand_force(self, sign: float, energy: float, under_way: Sequence[float]) -> float:
        """Returns the largest torque along `sign` [N or N*m] for a hand within its declared force."""
        response = self._response
        if response is None:
            return 0.0
        displacement, before = self._outward(sign), sign * self._torque
        opposed = False
        for torque in under_way:
            along = sign * torque
            displacement = next_displacement(displacement, before, along, response)
            if along >= 0.0:
                energy -= along * displacement
            else:
                opposed = True
            before = along
        if opposed:
            energy -= self._worst_out(-sign, under_way)
        base = next_displacement(displacement, before, 0.0, response)
        bound = hand_force_bound(energy, base, response.during)
        if self._declared.losses:
            bound = min(bound, self._if_held_on(energy, base))
        return bound

    def _if_held_on(self, energy: float, base: float) -> float:
        response = self._declared.response
        bound = float("inf")
        assert response is not None
        for holds in range(2, self._declared.losses + 2):
            pairs = 0.5 * holds * (holds - 1)
            start = holds * base + pairs * (response.hand + (1.0 - response.retained) * max(0.0, -base))
            gain = holds * response.during + pairs * (response.before + response.during)
            bound = min(bound, hand_force_bound(energy, start, gain))
        return bound

    def largest(self, sign: float, energy: float, under_way: Sequence[float]) -> tuple[float, float, float]:
        """Returns the bound of each certificate along `sign` [N or N*m]: hand force, device damping, hand speed.

        0 where a certificate is not declared. `energy` [J] is what may be taken out.
        """
        declared = self._declared
        by_force = by_damping = by_speed = 0.0
        losses, held = declared.losses, self._torque
        if self._mixes and self._response is not None:
            by_force = self._by_hand_force_of_any(sign, energy, under_way)
        elif self._response is not None:
            by_force = self.by_hand_force(sign, energy, under_way)
            if losses and under_way:
                by_force = min(by_force, self.by_hand_force(sign, energy, (held,) * self._delay))
        if losses:
            under_way = self._sizes(under_way, self._delay)
        if declared.damping:
            squares = 0.0
            for torque in under_way:
                squares += torque * torque
            by_damping = device_damping_bound(
                energy + self.dissipated, declared.damping, declared.sample_time, squares, losses + 1
            )
        if declared.speed is not None:
            rest = energy - declared.speed * declared.sample_time * sum(abs(torque) for torque in under_way)
            by_speed = hand_speed_bound(rest, declared.speed, declared.sample_time, losses + 1)
        return by_force, by_damping, by_speed
