"""`ultimately_passive` of an admittance display: what was created is dissipated by and by, as eq. 19 of the paper does.

Energy that the hold created goes into a surplus H. A series slip u_pas = C F with C = alpha H takes F u_pas T of it in
each hold, so that the sum becomes passive in the end, not at each instant. C is capped by the
stability of the slip against the stiffest hand declared (C K T <= 0.5).
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

_STABLE = 0.5
"""Largest C K T of a series slip against a spring, with a whole hold of delay to spare."""


class UltimatelyPassiveDisplayParameters(Parameters):
    """Parameters of an admittance display: how fast the surplus is dissipated."""

    alpha: Annotated[float, quantity("m/N/s/J", "rad/N/m/s/J", ge=0.0, le=1e6)] = 1.0
    """Slip per force and per joule of surplus."""
    hand_stiffness: Annotated[float, quantity("N/m", "N*m/rad", gt=0.0, le=1e8)] = 5000.0
    """Stiffest hand, an over-estimate: bounds the slip."""


@dataclass(frozen=True, slots=True)
class SlipSettings(DisplaySettings):
    """Constants of a run."""

    slip_per_energy: float  # slip per force, per surplus [m/(N*s*J) or rad/(N*m*s*J)]
    slip_most: float  # slip per force [m/(N*s) or rad/(N*m*s)]


def settings_of(
    environment: DisplayEnvironment, parameters: UltimatelyPassiveDisplayParameters, properties: DisplayProperties
) -> SlipSettings:
    """Returns what is fixed for a run."""
    most = _STABLE / (parameters.hand_stiffness * properties.sample_time)
    return SlipSettings(port_settings(properties), motion_settings(environment, properties), parameters.alpha, most)


def step(
    environment: DisplayEnvironment,
    run: Run[SlipSettings, DisplayState, DisplayMemory],
    position: float,
    torque_applied: float,
) -> EnergyBalance:
    """Dissipates part of the surplus; see `Controller.step`."""
    settings, state, memory = run.settings, run.state, run.memory
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
    """A virtual mass whose surplus is dissipated by and by."""

    parameters_type: ClassVar[type[Parameters]] = UltimatelyPassiveDisplayParameters
    kernel: ClassVar[Kernel] = Kernel(settings_of, DisplayState, memory_of, step)
