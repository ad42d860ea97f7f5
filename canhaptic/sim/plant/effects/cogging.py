"""Cogging: the detent torque of magnets and slots, F = -amplitude * sin(2 pi q / pitch + phase), torque or none.

A potential force: over a substep the mean along the travel is taken in closed form (a discrete gradient), so that what
it stores it gives back. States added: none (travel and effort of the splitting). Order 2.
Energy: stored. Typical: 0.5..3 % of the rated torque, pitch = one turn / lcm(poles, slots).
Source: Hanselman, "Brushless Permanent Magnet Motor Design", 2nd ed., 2003, ch. 4.
"""

import math
from typing import Annotated, ClassVar, Literal

from canhaptic.sim.plant.assembly import Account, PlantModel
from canhaptic.units import Parameters, quantity


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
    """Of the sine at position 0."""

    def add_to(self, scene: PlantModel) -> None:
        """Adds the effort."""
        scene.efforts.append(_Detent(self))


class _Detent:
    """The effort of cogging."""

    state_names: tuple[str, ...] = ()
    account: Account | None = None

    def __init__(self, cogging: Cogging) -> None:
        self._amplitude, self._phase = cogging.amplitude, cogging.phase
        self._wave_number = 2.0 * math.pi / cogging.pitch

    def reset(self) -> None:
        """Keeps nothing."""

    def force(self, position: float, travel: float, duration: float, torque: float) -> float:
        """Returns the mean force [N or N*m] along the travel."""
        return -self._amplitude * mean_sine(self._wave_number, self._phase, position, travel)

    def commit(self, position: float, travel: float, duration: float, torque: float) -> None:
        """Keeps nothing."""

    def stored(self, position: float) -> float:
        """Returns the potential [J], zero at the detent."""
        half = math.sin(0.5 * (self._wave_number * position + self._phase))
        return 2.0 * self._amplitude / self._wave_number * half * half


def mean_sine(wave_number: float, phase: float, position: float, travel: float) -> float:
    """Returns the mean of sin(wave_number * q + phase) from `position` to `position + travel`, without cancellation."""
    half = 0.5 * wave_number * travel
    spread = math.sin(half) / half if half else 1.0
    return math.sin(wave_number * (position + 0.5 * travel) + phase) * spread
