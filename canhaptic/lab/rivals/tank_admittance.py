"""`energy_tank` of an admittance display: no command generates more energy than the tank holds.

The energy F u T of each hold (hand force, speed, sample time) is added to the tank, which holds at most `capacity`. A
command whose negative F u T would overdraw the tank is scaled down. Like the passivity observer, the method assumes an
ideal drive. Franken et al., IEEE Trans. Robotics 27, 2011; Schindlbeck and Haddadin, ICRA 2015.
"""

from typing import Annotated, ClassVar

from canhaptic.control.admittance.admittance_group import UnprotectedAdmittanceGroup
from canhaptic.control.admittance.unprotected_admittance import SampledHold, UnprotectedAdmittance
from canhaptic.units import Parameters, quantity


class TankAdmittanceParameters(Parameters):
    """Parameters of an admittance display with an energy tank."""

    initial: Annotated[float, quantity("J", ge=0.0, le=1e3)] = 0.0
    """Initial energy of the tank."""
    capacity: Annotated[float, quantity("J", gt=0.0, le=1e3)] = 1.0
    """Largest energy in the tank."""


class TankAdmittance(UnprotectedAdmittance):
    """A virtual mass whose commands are limited by the energy in its tank."""

    parameters_type = TankAdmittanceParameters
    _given: TankAdmittanceParameters

    def first_energy(self, position: float) -> float:
        """Return the energy in the tank at the start [J]."""
        return self._given.initial

    def respond(self, hold: SampledHold) -> tuple[float, float, float]:
        """Update the tank and scale down a next speed that would take more energy than the tank holds."""
        request = hold.request
        self._energy = min(self._given.capacity, self._energy + hold.force * hold.before * hold.elapsed)
        taken = -hold.force * request * self._time
        if taken > 0.0 and taken > self._energy:
            request *= max(0.0, self._energy) / taken
        return request, 0.0, 0.0


class TankAdmittanceGroup(UnprotectedAdmittanceGroup):
    """A virtual mass on several axes with one tank: a command that would overdraw it is scaled equally on all axes."""

    parameters_type: ClassVar[type[Parameters]] = TankAdmittanceParameters

    def _begin(self) -> float:
        return float(self._parameters.initial)

    def _observe(self, energy: float) -> None:
        self._energy = min(self._parameters.capacity, self._energy + energy)

    def _protected(self, request: list[float], forces: list[float]) -> tuple[list[float], list[float]]:
        taken = -sum(force * speed for force, speed in zip(forces, request, strict=True)) * self._time
        if taken > 0.0 and taken > self._energy:
            request = [speed * max(0.0, self._energy) / taken for speed in request]
        return request, [0.0] * self.axes
