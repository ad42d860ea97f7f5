"""A simulated axis whose hand follows a course: legs of constant speed and constant rise of the push."""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Final, NamedTuple

from canhaptic.lab.figures.guided_hand import PUSH_RATE, SPEED, GuidedHand
from canhaptic.lab.loop.axis_loop import LoopCase
from canhaptic.sim.plant.effects import Effect
from canhaptic.sim.plant.plant import Plant, PlantParameters

_NS: Final = 1e9


class Leg(NamedTuple):
    """A part of the course of a hand; it begins with the SYNC nearest to its time."""

    begins: float  # [s]
    speed: float = 0.0  # of the place [m/s or rad/s]
    push_rate: float = 0.0  # [N/s or N*m/s]


class GuidedPlant(Plant):
    """A plant whose hand is given new rates at the beginning of each leg.

    Args:
        parameters: Mass, bearings and start.
        hand: The guided hand.
        effects: Effects of the plant.
        sample_time_ns: Sample time [ns].
        course: Course of the hand, in the order of time; before the first leg the hand rests.
        seed: Seed of every random effect.
    """

    def __init__(
        self,
        parameters: PlantParameters,
        hand: GuidedHand,
        effects: Sequence[Effect],
        sample_time_ns: int,
        course: Iterable[Leg],
        seed: int = 0,
    ) -> None:
        super().__init__(parameters, hand, effects, sample_time_ns, seed)
        self._legs = {round(leg.begins * _NS / sample_time_ns) * sample_time_ns: leg for leg in course}

    def begin(self, now: int) -> None:
        """Start the clock, and the first leg where it begins at once."""
        super().begin(now)
        self._turn(now)

    def advance_to(self, now: int, torque: float) -> None:
        """Move to `now` [ns] under a torque; see `Plant`."""
        super().advance_to(now, torque)
        self._turn(now)

    def _turn(self, now: int) -> None:
        leg = self._legs.get(now)
        if leg is not None:
            self.set_states({SPEED: leg.speed, PUSH_RATE: leg.push_rate})


def guided_case(
    case: LoopCase,
    parameters: PlantParameters,
    hand: GuidedHand,
    course: Sequence[Leg],
    effects: Sequence[Effect] = (),
    seed: int = 0,
) -> LoopCase:
    """Return a loop whose plant is held by a guided hand."""
    period = case.sample_time_ns
    return replace(
        case, make_plant=lambda: GuidedPlant(parameters, hand, effects, period, course, seed), simulation=None
    )
