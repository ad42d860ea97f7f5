"""`energy_tank` of an admittance display: no command gives out more than a tank holds.

The tank receives F u T of each command and supplies it; it holds `capacity` at most. A command that would overdraw it
is scaled down. As the observer, it assumes a perfect drive. Franken et al., IEEE Trans. Robotics 27, 2011;
Schindlbeck and Haddadin, ICRA 2015.
"""

from typing import Annotated, ClassVar

from canhaptic.control.admittance.display_controller import DisplayController
from canhaptic.control.admittance.display_environment import DisplayEnvironment
from canhaptic.control.admittance.sampled_group import UnprotectedDisplayGroup
from canhaptic.control.admittance.sampled_mass import DisplayReply, DisplayRun, SampledHold, display_kernel
from canhaptic.kernels import new
from canhaptic.units import Parameters, quantity


class TankDisplayParameters(Parameters):
    """Parameters of an admittance display with an energy tank."""

    initial: Annotated[float, quantity("J", ge=0.0, le=1e3)] = 0.0
    """Energy in the tank at the start."""
    capacity: Annotated[float, quantity("J", gt=0.0, le=1e3)] = 1.0
    """Largest energy in the tank."""


def first_energy(environment: DisplayEnvironment, given: TankDisplayParameters, position: float) -> float:
    """Return the energy in the tank at the start [J]."""
    return given.initial


def respond(environment: DisplayEnvironment, run: DisplayRun[TankDisplayParameters], hold: SampledHold) -> DisplayReply:
    """Scales a command that would take more than the tank holds."""
    settings, state, wish = run.settings, run.state, hold.wish
    state.energy = min(settings.given.capacity, state.energy + hold.force * hold.before * hold.elapsed)
    taken = -hold.force * wish * settings.port.sample_time
    if taken > 0.0 and taken > state.energy:
        wish *= max(0.0, state.energy) / taken
    return new(DisplayReply, (wish, 0.0, 0.0))


class TankDisplay(DisplayController):
    """A virtual mass that moves by the energy in its tank."""

    parameters_type = TankDisplayParameters
    kernel = display_kernel(respond, first_energy)


class TankDisplayGroup(UnprotectedDisplayGroup):
    """Virtual mass on several axes with one tank: a command that would overdraw it is scaled on all axes alike."""

    parameters_type: ClassVar[type[Parameters]] = TankDisplayParameters

    def _begin(self) -> float:
        return float(self._parameters.initial)

    def _observe(self, energy: float) -> None:
        self._energy = min(self._parameters.capacity, self._energy + energy)

    def _protected(self, wish: list[float], forces: list[float]) -> tuple[list[float], list[float]]:
        taken = -sum(force * speed for force, speed in zip(forces, wish, strict=True)) * self._time
        if taken > 0.0 and taken > self._energy:
            wish = [speed * max(0.0, self._energy) / taken for speed in wish]
        return wish, [0.0] * self.axes
