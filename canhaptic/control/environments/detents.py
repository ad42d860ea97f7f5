"""Detents: resting positions at a regular pitch, with a sinusoidal effort between them."""

import math
from typing import Annotated, ClassVar

from canhaptic.control.environments import Everywhere
from canhaptic.units import Parameters, quantity


class Detents(Everywhere, Parameters):
    """A periodic potential: H = peak pitch / pi sin^2(pi x / pitch).

    Every stretch between two resting positions is a contact zone of its own: at a resting position nothing is
    stored, so that the state is exact again whenever a detent is passed. Within a zone x is counted from the
    nearer resting position, positive from the lower and negative from the upper; x and x + pitch store the same.
    """

    peak: Annotated[float, quantity("N", "N*m", ge=0.0, le=1e6)]
    """Largest effort, a quarter of a pitch from a resting position."""
    pitch: Annotated[float, quantity("m", "rad", gt=0.0)]
    """Distance from one resting position to the next."""
    damping: Annotated[float, quantity("N*s/m", "N*m*s/rad", ge=0.0, le=1e7)] = 0.0
    """Viscous damping, everywhere but exactly at a resting position."""
    position: Annotated[float, quantity("m", "rad")] = 0.0
    """Position of any one of the resting positions."""

    linear_stiffness: ClassVar[None] = None

    def contact(self, position: float) -> int:
        """Return the contact zone: an odd number for every stretch between two resting positions, 0 exactly on one."""
        turns = (position - self.position) / self.pitch
        whole = math.floor(turns)
        return 2 * whole + 1 if turns != whole else 0

    def true_state(self, position: float, displacement: float, previous: float) -> float:
        """Return the distance from the nearer resting position [m or rad]."""
        offset = position - self.position
        return offset - round(offset / self.pitch) * self.pitch

    def admissible(self, state: float, true: float) -> float:
        """Return the state, shifted by whole pitches to be nearest the true state, and limited to the same stretch."""
        nearest = state - round((state - true) / self.pitch) * self.pitch
        return min(max(nearest, 0.0), self.pitch) if true >= 0.0 else max(min(nearest, 0.0), -self.pitch)

    def one_way(self, position: float) -> tuple[float, float]:
        """Return the interval in which the effort does not reverse: from a resting position to a crest [m or rad]."""
        half = 0.5 * self.pitch
        begin = self.position + math.floor((position - self.position) / half) * half
        return begin, (begin + half if position > begin else begin)

    def stored_energy(self, state: float) -> float:
        """Return peak pitch / pi sin^2(pi x / pitch) [J]."""
        sine = math.sin(math.pi * state / self.pitch)
        return self.peak * self.pitch / math.pi * sine * sine

    def effort(self, state: float) -> float:
        """Return peak sin(2 pi x / pitch) [N or N*m]."""
        return self.peak * math.sin(2.0 * math.pi * state / self.pitch)

    def state_of_energy(self, energy: float, like: float) -> float:
        """Return the state that stores an energy, on the flank of the state `like`; the crest if none stores it."""
        crest = self.peak * self.pitch / math.pi
        if energy <= 0.0 or crest == 0.0:
            state = 0.0
        else:
            state = math.asin(math.sqrt(min(1.0, energy / crest))) * self.pitch / math.pi
        return math.copysign(state if abs(like) <= 0.5 * self.pitch else self.pitch - state, like)
