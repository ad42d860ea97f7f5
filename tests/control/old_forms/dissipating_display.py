from math import sqrt
from typing import ClassVar

from canhaptic.control.admittance.display_environment import DisplayMemory, motion_settings
from canhaptic.control.admittance.group_environment import DisplayMass
from canhaptic.control.admittance.port import DisplayProperties, begin_port, port_settings
from canhaptic.control.balance import AT_REST, EnergyBalance
from canhaptic.errors import ParameterError
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
)


def settings_of(
    environment: DisplayMass, _parameters: NothingToChoose, properties: DisplayProperties
) -> DisplaySettings:
    if not isinstance(environment, DisplayMass):
        raise ParameterError(
            f"internal_dissipation: got {type(environment).__name__}, expected environment: virtual_mass; the balance "
            "is solved for a mass, use guarded"
        )
    return DisplaySettings(port_settings(properties), motion_settings(environment, properties))


def step(
    environment: DisplayMass,
    settings: DisplaySettings,
    state: DisplayState,
    memory: DisplayMemory,
    position: float,
    torque_applied: float,
) -> EnergyBalance:
    force = -torque_applied
    if not state.axis.started:
        begin_port(state.axis, memory.positions, position, force)
        state.energy = environment.potential(position)
        return AT_REST
    hold = follow(environment, settings, state, memory, position, force)
    impulse, potential = (force * settings.port.sample_time, environment.potential(position))
    risen, state.energy = (potential - state.energy, potential)
    wish = next_speed(environment, settings.port.sample_time, hold.before, impulse, risen)
    if hold.before == 0.0:
        wish = (impulse + settings.port.sample_time * environment.pull(position)) / environment.mass
    return command(environment, settings, state, memory, hold, 0.0, wish, 0.0)


def next_speed(environment: DisplayMass, time: float, speed: float, impulse: float, risen: float) -> float:
    share = time * environment.damping / environment.mass
    square = (1.0 + share * share) * speed * speed + 2.0 * (speed * impulse - risen) / environment.mass
    if square <= 0.0:
        return 0.0
    root = sqrt(square)
    found = -share * speed + (root if speed > 0.0 else -root)
    return found if found * speed > 0.0 else 0.0


class DissipatingDisplay(DisplayController):
    parameters_type: ClassVar[type[Parameters]] = NothingToChoose
    kernel: ClassVar[Kernel] = Kernel(settings_of, DisplayState, memory_of, step)
