"""A sum of environments at one handle: forces, stored energies and damping add, with one account.

Statements and proofs: `docs/theory/sums.md`. N1 is the account, N2 the common place of rest, N3 where the force
reverses, N4 the stiffest slope, N5 why a strain adds to media alone.

The state of a sum is the position, counted from a place where every part is at rest (`origin`), so that state 0 stores
nothing. A zone of contact is a stretch between two such places: those ends store nothing, as the surface of a wall and
the resting positions of detents do. Parts that keep a strain of their own add only to media that store nothing.
"""

from collections.abc import Sequence
from math import floor, inf, isfinite, pi, sqrt
from typing import Annotated, Any, ClassVar, Final

from pydantic import Field

from canhaptic.control.environments import Everywhere, is_ours
from canhaptic.control.environments.detents import Detents
from canhaptic.control.environments.free_space import FreeSpace
from canhaptic.control.environments.viscous_medium import ViscousMedium
from canhaptic.errors import ParameterError
from canhaptic.units import Parameters

_CERTAIN: Final = 1.0 - 1e-9
"""Factor that allows for rounding in a distance to the next reversal of the force."""
_ROUNDING: Final = 1e-15  # of a position
_ON_NOTCH: Final = 1e-12  # of a pitch
_CLOSE: Final = 1e-12  # of an energy
_DOUBLINGS: Final = 60
_MOST_STEPS: Final = 100  # of the root finder; bisection alone ends within 64


_Place = Annotated[float, Field(allow_inf_nan=True)]


class SumOfParts(Everywhere, Parameters):
    """Environments that depend on the position alone, at one handle; made by `added`."""

    parts: tuple[Any, ...]  # without the one with notches
    damping: float  # of all parts together: the largest that acts anywhere [N*s/m or N*m*s/rad]
    low: _Place  # from here ...
    high: _Place  # ... to here every part without notches is at rest; may be infinite [m or rad]
    origin: float  # where the state is 0 [m or rad]
    steepest: float | None  # sum of the largest slopes of the forces; None: not known [N/m or N*m/rad]
    side: str  # "below" or "above" if all parts are solid there, else ""
    notched: Any = None  # the part with notches
    pitch: float = 0.0  # of its notches; 0: there are none [m or rad]
    place: float = 0.0  # position of any of its notches [m or rad]
    first: int = 0  # notches from `place` to the lowest one at which every part is at rest
    last: int = 0  # the same of the highest

    linear_stiffness: ClassVar[None] = None
    damps_by_place: ClassVar[bool] = True

    @property
    def position(self) -> float:
        """Where a contact begins [m or rad]."""
        ends = [self.origin] if self.pitch else [end for end in (self.high, self.low) if isfinite(end)]
        return float(ends[0]) if ends else 0.0

    def rests(self) -> tuple[float, float]:
        """Return the positions from and to at which every part without notches stores nothing [m or rad]."""
        return self.low, self.high

    def contact(self, position: float) -> int:
        """Return the zone of contact; 0 where every part is at rest and none damps."""
        if self.pitch:
            turns = (position - self.place) / self.pitch
            whole = floor(turns)
            if turns == whole and self.first <= whole <= self.last and not self._is_felt(position):
                return 0
            return 2 * self._stretch(whole) + 1
        if position < self.low:
            return 1
        return 2 if position > self.high else 3 * self._is_felt(position)

    def _stretch(self, notch: int) -> int:
        """Return the number of the notch at which a zone begins, which every notch of another part's contact shares."""
        return int(min(max(notch, self.first - 1), self.last))

    def _is_felt(self, position: float) -> bool:
        return any(part.contact(position) for part in self.parts)

    def true_state(self, position: float, displacement: float, previous: float) -> float:
        """Return the distance from the place of rest [m or rad]."""
        return position - self.origin

    def admissible(self, state: float, true: float) -> float:
        """Return the state, or the nearest one in the zone of the state `true`."""
        low, high = self._zone(true + self.origin)
        return min(max(state, low - self.origin), high - self.origin)

    def _zone(self, position: float) -> tuple[float, float]:
        """Return the ends of the zone of a position [m or rad]; what is finite of them stores nothing."""
        if self.pitch:
            number = self._stretch(floor((position - self.place) / self.pitch))
            low = self.place + number * self.pitch if number >= self.first else -inf
            return low, self.place + (number + 1) * self.pitch if number < self.last else inf
        if position < self.low:
            return -inf, self.low
        return (self.high, inf) if position > self.high else (self.low, self.high)

    def one_way(self, position: float) -> tuple[float, float]:
        """Return an interval around a position in which the force keeps its direction [m or rad] (N2, N3)."""
        force = self.effort(position - self.origin)
        if force == 0.0:
            return position, position
        if not self.pitch:
            return (self.high, inf) if force > 0.0 else (-inf, self.low)
        low, high = (self.low, inf) if force > 0.0 else (-inf, self.high)  # where no part without notches is against it
        room = _CERTAIN * abs(force) / self.steepest if self.steepest else 0.0
        if low <= position <= high and self.notched.effort(self._in_notch(position)) * force > 0.0:
            below, above = self.notched.one_way(position)
            return min(max(low, below), position - room), max(min(high, above), position + room)
        return position - room, position + room

    def _at(self, state: float) -> float:
        """Return the position of a state [m or rad], exact where a zone ends, so that nothing is stored there."""
        position = state + self.origin
        end = self.low if abs(position - self.low) < abs(position - self.high) else self.high
        return end if abs(position - end) <= _ROUNDING * (abs(end) + abs(self.origin)) else position

    def _in_notch(self, position: float) -> float:
        """Return the state of the part with notches at a position [m or rad], exactly 0 at a notch."""
        turns = (position - self.place) / self.pitch
        if abs(turns - round(turns)) <= _ON_NOTCH:
            return 0.0
        state: float = self.notched.true_state(position, 0.0, 0.0)
        return state

    def stored_energy(self, state: float) -> float:
        """Return the sum of the stored energies [J]."""
        position = self._at(state)
        total: float = self.notched.stored_energy(self._in_notch(position)) if self.pitch else 0.0
        for part in self.parts:
            if part.contact(position):
                total += part.stored_energy(part.true_state(position, 0.0, 0.0))
        return total

    def effort(self, state: float) -> float:
        """Return the sum of the efforts [N or N*m]."""
        position = self._at(state)
        total: float = self.notched.effort(self._in_notch(position)) if self.pitch else 0.0
        for part in self.parts:
            if part.contact(position):
                total += part.effort(part.true_state(position, 0.0, 0.0))
        return total

    def damping_at(self, state: float) -> float:
        """Return the sum of the damping coefficients that act at a state [N*s/m or N*m*s/rad]."""
        position = self._at(state)
        total: float = self.notched.damping if self.pitch else 0.0
        for part in self.parts:
            if part.contact(position):
                total += part.damping
        return total

    def state_of_energy(self, energy: float, like: float) -> float:
        """Return the state that stores `energy` [J] on the flank of the state `like`; the crest if none stores it."""
        low, high = (end - self.origin for end in self._zone(like + self.origin))
        force, stored = self.effort(like), self.stored_energy(like)
        end = low if isfinite(low) and (force > 0.0 or not isfinite(high)) else high
        if not isfinite(end) or (force == 0.0 and stored == 0.0):
            return like
        if energy <= 0.0:
            return end
        start = like
        if stored < energy:
            ends = self.one_way(like + self.origin)
            crest = ends[like > end] - self.origin
            if isfinite(crest) and self.stored_energy(crest) <= energy:
                return crest
            start = crest if isfinite(crest) else like
        return self._between(end, start, energy)

    def _between(self, end: float, far: float, energy: float) -> float:
        """Return the state that stores `energy` [J], from a state that stores nothing towards `far`, and beyond it.

        Newton's method for the root of the energy, with bisection where a step would leave the bracket.
        """
        near, way = end, far - end
        for _ in range(_DOUBLINGS):
            if self.stored_energy(end + way) >= energy:
                break
            near, way = end + way, 2.0 * way
        else:
            return near
        far = end + way
        state = end + way * sqrt(energy / self.stored_energy(far))
        for _ in range(_MOST_STEPS):
            stored, slope = self.stored_energy(state), self.effort(state)
            if abs(stored - energy) <= _CLOSE * energy:
                break
            near, far = (near, state) if stored > energy else (state, far)
            newton = state - 2.0 * (stored - sqrt(stored * energy)) / slope if slope * way > 0.0 else near
            state = newton if min(near, far) < newton < max(near, far) else 0.5 * (near + far)
        return state


def added(named: Sequence[tuple[str, Any]]) -> Any:
    """Return the sum of environments.

    Args:
        named: Name of each part for messages, and the part: parameters of an environment of one axis.

    Raises:
        ParameterError: Two parts cannot be added; names them, and says why.
    """
    named = [one for one in named if not isinstance(one[1], FreeSpace)]
    strained = [one for one in named if one[1].relaxes]
    if strained:
        return _strained(strained, [one for one in named if one not in strained])
    for name, part in named:
        is_known = isinstance(part, Detents) or hasattr(part, "rests")
        if not is_known or not is_ours(part, "contact", "true_state", "admissible"):
            raise _refused(
                name, "has zones of contact of its own, and where it rests is not known to a sum",
                "give it one `position` and a `side`, as an `Environment` has, and no `contact`",
            )  # fmt: skip
    notched = [one for one in named if isinstance(one[1], Detents)]
    rests = [(name, *part.rests()) for name, part in named if not isinstance(part, Detents)]
    if len(notched) > 1:
        raise _refused(_pair(notched), "have notches each", "leave one of them out")
    lowest, low, _ = max(rests, key=lambda part: part[1], default=("", -inf, inf))
    highest, _, high = min(rests, key=lambda part: part[2], default=("", -inf, inf))
    if low > high:
        raise _refused(
            f"{lowest} and {highest}", f"press against each other: the one rests from {low:g} on, the other up to "
            f"{high:g}, so that the handle is nowhere without force", "move one of them",
        )  # fmt: skip
    values = {
        "parts": tuple(part for _, part in named if not isinstance(part, Detents)),
        "low": low,
        "high": high,
        "steepest": _steepest(named),
    }
    values["damping"] = sum(part.damping for _, part in named)
    sides = {getattr(part, "side", "") for _, part in named}
    values["side"] = sides.pop() if len(sides) == 1 and sides <= {"below", "above"} else ""
    origin = min(max(0.0, low), high)
    return SumOfParts(**values, origin=origin) if not notched else _with_notches(*notched[0], values, origin)


def _with_notches(name: str, part: Any, values: dict[str, Any], near: float) -> SumOfParts:
    """Return a sum with notches; its place of rest is the notch nearest a position at which the other parts rest."""
    pitch, low, high = part.pitch, values["low"], values["high"]
    first = -_FAR if low == -inf else -floor((part.position - low) / pitch)
    last = _FAR if high == inf else floor((high - part.position) / pitch)
    if first > last:
        raise _refused(
            name, f"has no notch from {low:g} to {high:g}, where the other parts rest: the handle would rest nowhere",
            "move position, or take a smaller pitch",
        )  # fmt: skip
    number = min(max(round((near - part.position) / pitch), first), last)
    notches = {"notched": part, "pitch": pitch, "place": part.position, "first": first, "last": last}
    return SumOfParts(**values, origin=part.position + number * pitch, **notches)


_FAR: Final = 1_000_000_000
"""Notches beyond which nothing is reached."""


def _steepest(named: Sequence[tuple[str, Any]]) -> float | None:
    """Return the sum of the largest slopes [N/m or N*m/rad]; None if that of a part is not known."""
    total = 0.0
    for _, part in named:
        slope = part.linear_stiffness
        if isinstance(part, Detents):
            slope = 2.0 * pi * part.peak / part.pitch
        if slope is None:
            return None
        total += slope
    return total


def _strained(strained: Sequence[tuple[str, Any]], others: Sequence[tuple[str, Any]]) -> Parameters:
    """Return a part with a strain of its own, with the damping of media that store nothing."""
    if len(strained) > 1:
        raise _refused(_pair(strained), "need a strain each, of which a sum has one", "leave one of them out")
    (name, part), damping = strained[0], 0.0
    for other, medium in others:
        if not isinstance(medium, ViscousMedium):
            raise _refused(
                f"{name} and {other}", "energy and force of the first depend on its strain, those of the other on the "
                "position, and an algorithm keeps one of the two (N5, docs/theory/sums.md)",
                f"leave one of them out, or take viscous_medium for {name}: it adds to anything",
            )  # fmt: skip
        damping += medium.damping
    found: Parameters = part.model_copy(update={"damping": part.damping + damping})
    return found


def _pair(named: Sequence[tuple[str, Any]]) -> str:
    return " and ".join(name for name, _ in named[:2])


def _refused(what: str, why: str, remedy: str) -> ParameterError:
    return ParameterError(f"{what}: cannot be added: {why}; {remedy}")
