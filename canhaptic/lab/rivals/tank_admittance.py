"""`energy_tank` of an admittance display: no command generates more energy than the tank holds.

The energy F u T of each hold (hand force, speed, sample time) is added to the tank, which holds at most `capacity`. A
command whose negative F u T would overdraw the tank is scaled down. Like the passivity observer, the method assumes an
ideal drive. Franken et al., IEEE Trans. Robotics 27, 2011; Schindlbeck and Haddadin, ICRA 2015.
"""

from typing import Annotated, ClassVar

from canhaptic.control.admittance.admittance_controller import Vector
from canhaptic.control.admittance.unprotected_admittance import UnprotectedAdmittance
from canhaptic.units import Parameters, quantity


class TankAdmittanceParameters(Parameters):
    """Parameters of an admittance display with an energy tank."""

    initial: Annotated[float, quantity("J", ge=0.0, le=1e3)] = 0.0
    """Initial energy of the tank."""
    capacity: Annotated[float, quantity("J", gt=0.0, le=1e3)] = 1.0
    """Largest energy in the tank."""


class TankAdmittance(UnprotectedAdmittance):
    """A virtual mass with one tank for all axes: a command that would overdraw it is scaled down on all of them."""

    parameters_type: ClassVar[type[Parameters]] = TankAdmittanceParameters

    def _begin(self) -> float:
        return float(self._given.initial)

    def _observe(self, energy: float, dissipated: float) -> None:
        self._energy = min(self._given.capacity, self._energy + energy)

    def _protected(self, request: Vector, forces: Vector) -> tuple[Vector, Vector]:
        taken = -sum(force * speed for force, speed in zip(forces, request, strict=True)) * self._time
        if taken > 0.0 and taken > self._energy:
            request = [speed * max(0.0, self._energy) / taken for speed in request]
        return request, [0.0] * self.axes
