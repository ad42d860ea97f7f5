"""`passivity_observer` of an admittance display: a series slip whenever the observed energy falls below zero.

The observer counts F u T, force times velocity commanded, as if the drive tracked perfectly: its known weakness.
The controller adds C F to the command, with C = -E / (F^2 T), so that the observed energy is zero after the hold.
Hannaford and Ryu, IEEE Trans. Robotics and Automation 18, 2002, in the form for a velocity output.
"""

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
    """Observes the energy of the command and adds the slip that it lacks; see `Controller.step`."""
    settings, state, memory = run.settings, run.state, run.memory
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
    """A virtual mass with observer and series slip."""

    parameters_type: ClassVar[type[Parameters]] = NothingToChoose
    kernel: ClassVar[Kernel] = Kernel(settings_of, DisplayState, memory_of, step)
