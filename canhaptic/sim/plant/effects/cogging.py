"""Cogging: the detent torque of magnets and slots, F = -amplitude * sin(2 pi q / pitch + phase), torque or none.

A potential force: over a substep the mean along the travel is taken in closed form (a discrete gradient), so that what
it stores it gives back. States added: none (travel and effort of the splitting). Order 2.
Energy: stored. Typical: 0.5..3 % of the rated torque, pitch = one turn / lcm(poles, slots).
Source: Hanselman, "Brushless Permanent Magnet Motor Design", 2nd ed., 2003, ch. 4.
"""

import math
from typing import Annotated, ClassVar, Final, Literal

from canhaptic.sim.plant.assembly import Account, PlantModel
from canhaptic.sim.plant.effort_forces import DETENT, Bristle, Effort, mean_force
from canhaptic.units import Parameters, quantity

_NO_BRISTLE: Final = Bristle()


class Cogging(Parameters):
    """A periodic detent."""

    order: ClassVar[int | None] = 2
    rank: ClassVar[int] = 1

    type: Literal["cogging"] = "cogging"
    amplitude: Annotated[float, quantity("N", "N*m", ge=0.0, le=1e6)]
    """Largest detent force."""
    pitch: Annotated[float, quantity("m", "rad", ge=1e-9, le=1e3)]
    """From one detent to the next."""
    phase: Annotated[float, quantity("rad", ge=-10.0, le=10.0)] = 0.0
    """Phase of the sine at position 0."""

    def add_to(self, scene: PlantModel) -> None:
        """Adds the effort."""
        scene.efforts.append(_Detent(self))


class _Detent:
    """The effort of cogging."""

    state_names: tuple[str, ...] = ()
    account: Account | None = None

    def __init__(self, cogging: Cogging) -> None:
        self.effort = Effort(DETENT, cogging.amplitude, cogging.pitch, cogging.phase)

    def reset(self) -> None:
        """Keeps nothing."""

    def force(self, position: float, travel: float, duration: float, torque: float) -> float:
        """Returns the mean force [N or N*m] along the travel."""
        return mean_force(self.effort, _NO_BRISTLE, position, travel, duration, torque)

    def commit(self, position: float, travel: float, duration: float, torque: float) -> None:
        """Keeps nothing."""

    def stored(self, position: float) -> float:
        """Returns the potential [J], zero at the detent."""
        wave_number = 2.0 * math.pi / self.effort.pitch
        half = math.sin(0.5 * (wave_number * position + self.effort.phase))
        return 2.0 * self.effort.amplitude / wave_number * half * half
