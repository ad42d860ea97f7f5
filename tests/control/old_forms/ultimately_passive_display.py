from dataclasses import dataclass
from typing import Annotated, ClassVar

from canhaptic.control.admittance.display_environment import DisplayEnvironment, DisplayMemory, motion_settings
from canhaptic.control.admittance.port import DisplayProperties, begin_port, port_settings
from canhaptic.control.balance import AT_REST, EnergyBalance
from canhaptic.units import Parameters, quantity
from tests.control.old_forms.display_controller import DisplayController
from tests.control.old_forms.kernel import Kernel
from tests.control.old_forms.sampled_mass import DisplaySettings, DisplayState, command, follow, memory_of

_STABLE = 0.5


class UltimatelyPassiveDisplayParameters(Parameters):
    alpha: Annotated[float, quantity("m/N/s/J", "rad/N/m/s/J", ge=0.0, le=1000000.0)] = 1.0
    hand_stiffness: Annotated[float, quantity("N/m", "N*m/rad", gt=0.0, le=100000000.0)] = 5000.0


@dataclass(frozen=True, slots=True)
class SlipSettings(DisplaySettings):
    slip_per_energy: float
    slip_most: float


def settings_of(
    environment: DisplayEnvironment, parameters: UltimatelyPassiveDisplayParameters, properties: DisplayProperties
) -> SlipSettings:
    most = _STABLE / (parameters.hand_stiffness * properties.sample_time)
    return SlipSettings(port_settings(properties), motion_settings(environment, properties), parameters.alpha, most)


def step(
    environment: DisplayEnvironment,
    settings: SlipSettings,
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
    state.energy = max(0.0, state.energy - h_pas)
    slip = min(settings.slip_per_energy * state.energy, settings.slip_most) * force
    balance = command(environment, settings, state, memory, hold, h_pas, hold.wish, slip)
    state.energy = max(0.0, state.energy + balance.gen - balance.leak)
    return balance


class UltimatelyPassiveDisplay(DisplayController):
    parameters_type: ClassVar[type[Parameters]] = UltimatelyPassiveDisplayParameters
    kernel: ClassVar[Kernel] = Kernel(settings_of, DisplayState, memory_of, step)
