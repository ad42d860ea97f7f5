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
    force = -torque_applied
    if not state.axis.started:
        begin_port(state.axis, memory.positions, position, force)
        return AT_REST
    slipped = state.slip
    hold = follow(environment, settings, state, memory, position, force)
    h_pas = force * slipped * hold.elapsed
    state.energy += force * (hold.before + slipped) * hold.elapsed
    slip = 0.0
    if state.energy < 0.0 and force != 0.0:
        slip = -state.energy / (force * settings.port.sample_time)
    return command(environment, settings, state, memory, hold, h_pas, hold.wish, slip)


class ObservedDisplay(DisplayController):
    parameters_type: ClassVar[type[Parameters]] = NothingToChoose
    kernel: ClassVar[Kernel] = Kernel(settings_of, DisplayState, memory_of, step)
