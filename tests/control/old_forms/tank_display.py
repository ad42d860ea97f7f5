from dataclasses import dataclass
from typing import Annotated, ClassVar

from canhaptic.control.admittance.display_environment import DisplayEnvironment, DisplayMemory, motion_settings
from canhaptic.control.admittance.port import DisplayProperties, begin_port, port_settings
from canhaptic.control.balance import AT_REST, EnergyBalance
from canhaptic.units import Parameters, quantity
from tests.control.old_forms.display_controller import DisplayController
from tests.control.old_forms.kernel import Kernel
from tests.control.old_forms.sampled_mass import DisplaySettings, DisplayState, command, follow, memory_of


class TankDisplayParameters(Parameters):
    initial: Annotated[float, quantity("J", ge=0.0, le=1000.0)] = 0.0
    capacity: Annotated[float, quantity("J", gt=0.0, le=1000.0)] = 1.0


@dataclass(frozen=True, slots=True)
class TankSettings(DisplaySettings):
    initial: float
    capacity: float


def settings_of(
    environment: DisplayEnvironment, parameters: TankDisplayParameters, properties: DisplayProperties
) -> TankSettings:
    return TankSettings(
        port_settings(properties), motion_settings(environment, properties), parameters.initial, parameters.capacity
    )


def step(
    environment: DisplayEnvironment,
    settings: TankSettings,
    state: DisplayState,
    memory: DisplayMemory,
    position: float,
    torque_applied: float,
) -> EnergyBalance:
    force = -torque_applied
    if not state.axis.started:
        begin_port(state.axis, memory.positions, position, force)
        state.energy = settings.initial
        return AT_REST
    hold = follow(environment, settings, state, memory, position, force)
    state.energy = min(settings.capacity, state.energy + force * hold.before * hold.elapsed)
    wish, taken = (hold.wish, -force * hold.wish * settings.port.sample_time)
    if taken > 0.0 and taken > state.energy:
        wish *= max(0.0, state.energy) / taken
    return command(environment, settings, state, memory, hold, 0.0, wish, 0.0)


class TankDisplay(DisplayController):
    parameters_type: ClassVar[type[Parameters]] = TankDisplayParameters
    kernel: ClassVar[Kernel] = Kernel(settings_of, DisplayState, memory_of, step)
