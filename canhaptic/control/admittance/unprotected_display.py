"""`unprotected` of an admittance display: the virtual mass as it is, and what sampling and the drive make of it."""

from typing import ClassVar

from canhaptic.control.admittance.display_controller import DisplayController
from canhaptic.control.admittance.display_environment import DisplayEnvironment
from canhaptic.control.admittance.motion import DisplayMemory
from canhaptic.control.admittance.port import begin_port
from canhaptic.control.admittance.sampled_mass import (
    DisplaySettings,
    DisplayState,
    NothingToChoose,
    command,
    follow,
    memory_of,
    settings_of,
)
from canhaptic.control.balance import AT_REST, EnergyBalance
from canhaptic.kernels import Kernel, Run
from canhaptic.units import Parameters


def step(
    environment: DisplayEnvironment,
    run: Run[DisplaySettings, DisplayState, DisplayMemory],
    position: float,
    torque_applied: float,
) -> EnergyBalance:
    """Moves the virtual mass on under the last force; see `Controller.step`."""
    settings, state, memory = run.settings, run.state, run.memory
    if not state.axis.started:
        begin_port(state.axis, memory.positions, position, -torque_applied)
        return AT_REST
    hold = follow(environment, settings, state, memory, position, -torque_applied)
    return command(environment, settings, state, memory, hold, 0.0, hold.wish, 0.0)


class UnprotectedDisplay(DisplayController):
    """The virtual mass without protection."""

    parameters_type: ClassVar[type[Parameters]] = NothingToChoose
    kernel: ClassVar[Kernel] = Kernel(settings_of, DisplayState, memory_of, step)
