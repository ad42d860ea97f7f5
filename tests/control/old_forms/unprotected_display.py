from typing import ClassVar

from canhaptic.control.admittance.display_environment import DisplayEnvironment, DisplayMemory
from canhaptic.control.admittance.port import begin_port
from canhaptic.control.balance import AT_REST, EnergyBalance
from canhaptic.units import Parameters
from tests.control.old_forms.display_controller import DisplayController
from tests.control.old_forms.kernel import Kernel
from tests.control.old_forms.sampled_mass import (
    DisplaySettings,
    DisplayState,
    NothingToChoose,
    command,
    follow,
    memory_of,
    settings_of,
)


def step(
    environment: DisplayEnvironment,
    settings: DisplaySettings,
    state: DisplayState,
    memory: DisplayMemory,
    position: float,
    torque_applied: float,
) -> EnergyBalance:
    if not state.axis.started:
        begin_port(state.axis, memory.positions, position, -torque_applied)
        return AT_REST
    hold = follow(environment, settings, state, memory, position, -torque_applied)
    return command(environment, settings, state, memory, hold, 0.0, hold.wish, 0.0)


class UnprotectedDisplay(DisplayController):
    parameters_type: ClassVar[type[Parameters]] = NothingToChoose
    kernel: ClassVar[Kernel] = Kernel(settings_of, DisplayState, memory_of, step)
