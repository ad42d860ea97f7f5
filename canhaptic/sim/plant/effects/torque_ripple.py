"""Torque ripple: the torque constant varies with position, F = torque * amplitude * sin(2 pi q / pitch + phase).

States added: none (travel and effort of the splitting). Order 2. Energy: booked as work of the motor, so that the
true motor work then differs from the one computed from the torque demand by at most that part.
Typical: 1..5 % at the 6th electrical harmonic. Source: Hanselman, "Brushless Permanent Magnet Motor Design", 2003.
"""

from typing import Annotated, ClassVar, Final, Literal

from canhaptic.sim.plant.assembly import Account, PlantModel
from canhaptic.sim.plant.effort_forces import RIPPLE, Bristle, Effort, mean_force
from canhaptic.units import Parameters, quantity

_NO_BRISTLE: Final = Bristle()


class TorqueRipple(Parameters):
    """A torque constant that depends on position."""

    order: ClassVar[int | None] = 2
    rank: ClassVar[int] = 1

    type: Literal["torque_ripple"] = "torque_ripple"
    amplitude: Annotated[float, quantity("1", ge=0.0, lt=1.0)]
    """Part of the torque."""
    pitch: Annotated[float, quantity("m", "rad", ge=1e-9, le=1e3)]
    """Period of the ripple."""
    phase: Annotated[float, quantity("rad", ge=-10.0, le=10.0)] = 0.0
    """Phase of the sine at position 0."""

    def add_to(self, scene: PlantModel) -> None:
        """Adds the effort."""
        scene.efforts.append(_Ripple(self))


class _Ripple:
    """The effort of torque ripple."""

    state_names: tuple[str, ...] = ()
    account: Account | None = "motor"

    def __init__(self, ripple: TorqueRipple) -> None:
        self.effort = Effort(RIPPLE, ripple.amplitude, ripple.pitch, ripple.phase)

    def reset(self) -> None:
        """Keeps nothing."""

    def force(self, position: float, travel: float, duration: float, torque: float) -> float:
        """Returns the mean force [N or N*m] along the travel."""
        return mean_force(self.effort, _NO_BRISTLE, position, travel, duration, torque)

    def commit(self, position: float, travel: float, duration: float, torque: float) -> None:
        """Keeps nothing."""

    def stored(self, position: float) -> float:
        """Returns 0."""
        return 0.0
