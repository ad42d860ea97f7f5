"""`energy_tank` of an admittance display: no command gives out more than a tank holds.

The tank takes F u T of each command and gives it back; it holds `capacity` at most. A command that would take more than
is in it is scaled down. As the observer, it takes the drive for perfect. Franken et al., IEEE Trans. Robotics 27, 2011;
Schindlbeck and Haddadin, ICRA 2015.
"""

from dataclasses import dataclass
from typing import Annotated, ClassVar

from canhaptic.control.admittance.display_controller import DisplayController
from canhaptic.control.admittance.display_environment import DisplayEnvironment
from canhaptic.control.admittance.motion import DisplayMemory, motion_settings
from canhaptic.control.admittance.port import begin_port, port_settings
from canhaptic.control.admittance.properties import DisplayProperties
from canhaptic.control.admittance.sampled_mass import (
    DisplaySettings,
    DisplayState,
    command,
    follow,
    memory_of,
)
from canhaptic.control.balance import AT_REST, EnergyBalance
from canhaptic.kernels import Kernel, Run
from canhaptic.units import Parameters, quantity


class TankDisplayParameters(Parameters):
    """Parameters of an admittance display with an energy tank."""

    initial: Annotated[float, quantity("J", ge=0.0, le=1e3)] = 0.0
    """Energy in the tank at the start."""
    capacity: Annotated[float, quantity("J", gt=0.0, le=1e3)] = 1.0
    """Largest energy in the tank."""


@dataclass(frozen=True, slots=True)
class TankSettings(DisplaySettings):
    """Constants of a run."""

    initial: float  # [J]
    capacity: float  # [J]


def settings_of(
    environment: DisplayEnvironment, parameters: TankDisplayParameters, properties: DisplayProperties
) -> TankSettings:
    """Returns what is fixed for a run."""
    return TankSettings(
        port_settings(properties), motion_settings(environment, properties), parameters.initial, parameters.capacity
    )


def step(
    environment: DisplayEnvironment,
    run: Run[TankSettings, DisplayState, DisplayMemory],
    position: float,
    torque_applied: float,
) -> EnergyBalance:
    """Scales a command that would take more than the tank holds; see `Controller.step`."""
    settings, state, memory = run.settings, run.state, run.memory
    force = -torque_applied
    if not state.axis.started:
        begin_port(state.axis, memory.positions, position, force)
        state.energy = settings.initial
        return AT_REST
    hold = follow(environment, settings, state, memory, position, force)
    state.energy = min(settings.capacity, state.energy + force * hold.before * hold.elapsed)
    wish, taken = hold.wish, -force * hold.wish * settings.port.sample_time
    if taken > 0.0 and taken > state.energy:
        wish *= max(0.0, state.energy) / taken
    return command(environment, settings, state, memory, hold, 0.0, wish, 0.0)


class TankDisplay(DisplayController):
    """A virtual mass that moves by what is in its tank."""

    parameters_type: ClassVar[type[Parameters]] = TankDisplayParameters
    kernel: ClassVar[Kernel] = Kernel(settings_of, DisplayState, memory_of, step)
