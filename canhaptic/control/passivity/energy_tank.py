"""`energy_tank`: the spring beyond a constant stiffness takes its energy from a tank, and only what is in there.

The force is K_c x + b x (K - K_c) + d v with 0 <= b <= 1. The tank holds T: what the damper dissipates flows in while T
is below `most_energy`, what the variable spring takes up flows in, and what it gives back flows out. b is the largest
that leaves T above `least_energy` if the next hold moves like the last,

    -b (K - K_c) x D <= T - least_energy + (energy of the damper in a hold like the last),   D the motion in it

(constraint and tank of `VariableImpedanceWithEnergyTank::on_tank_update` in `variable_impedance_energy_tank.cpp` of the
package qp_ros2, which was read, after F. Ferraguti, C. Secchi and C. Fantuzzi, ICRA 2013,
doi:10.1109/ICRA.2013.6631284, which was not; the limits of a tank are also those of "Passive hierarchical impedance
control via energy tanks" by Dietrich et al., of which a transcript was read).

Departures: one axis, so that the quadratic program is the quotient above; the tank's energy is counted from the torque
applied, exact for each hold, where the sources integrate; it begins empty, where they begin with 2 J; no limit of the
power out of the tank. The motion of a hold is not known beforehand, so that it promises nothing.
"""

from dataclasses import dataclass, field
from typing import Annotated, ClassVar, NamedTuple

from canhaptic.control.balance import AT_REST, Certificate, EnergyBalance
from canhaptic.control.environments.environment import Environment
from canhaptic.control.passivity.controller import LoopProperties
from canhaptic.control.passivity.hold_account import (
    Axis,
    AxisMemory,
    Hold,
    HoldAccount,
    HoldSettings,
    close_hold,
    hold_memory,
    hold_settings,
    open_hold,
)
from canhaptic.control.passivity.sampled_model import SampledModel, begin_model, follow, settle
from canhaptic.control.passivity.stepped import SteppedController
from canhaptic.control.velocity import DamperVelocity
from canhaptic.kernels import Buffer, Kernel, MakeBuffer, new
from canhaptic.units import Parameters, quantity


class EnergyTankParameters(DamperVelocity):
    """The constant spring and the tank."""

    constant_stiffness: Annotated[float, quantity("N/m", "N*m/rad", ge=0.0, le=1e9)] = 0.0
    """K_c: rendered at every level of the tank."""
    initial_energy: Annotated[float, quantity("J", ge=0.0, le=1e3)] = 0.0
    """Energy in the tank at the start, which may be given out."""
    least_energy: Annotated[float, quantity("J", ge=0.0, le=1e3)] = 0.0
    """Energy of the tank below which nothing is taken out."""
    most_energy: Annotated[float, quantity("J", gt=0.0, le=1e3)] = 3.0
    """Energy of the tank above which the damper does not fill it; as in the source."""


@dataclass(frozen=True, slots=True)
class _EnergyTankSettings:
    """Constants of a run."""

    constant_stiffness: float  # [N/m or N*m/rad]
    initial_energy: float  # [J]
    least_energy: float  # [J]
    most_energy: float  # [J]
    hold: HoldSettings


@dataclass(slots=True)
class _EnergyTankState:
    """State kept from SYNC to SYNC."""

    axis: Axis = field(default_factory=Axis)
    model: SampledModel = field(default_factory=SampledModel)
    brought: float = 0.0  # energy in the tank beyond the initial one [J]


class _EnergyTankMemory(NamedTuple):
    """Buffers of one axis."""

    axis: AxisMemory
    parts: Buffer  # part of the variable spring in each command, 0..1, a ring as `axis.commands`


def settings_of(
    environment: Environment, parameters: EnergyTankParameters, loop: LoopProperties
) -> _EnergyTankSettings:
    """Returns what is fixed for a run."""
    given, hold = parameters, hold_settings(parameters, loop, Certificate.NONE)
    return _EnergyTankSettings(
        given.constant_stiffness, given.initial_energy, given.least_energy, given.most_energy, hold
    )


def memory_of(settings: _EnergyTankSettings, make_buffer: MakeBuffer) -> _EnergyTankMemory:
    """Returns the buffers of one axis."""
    axis = hold_memory(settings, make_buffer)
    return _EnergyTankMemory(axis, make_buffer(settings.hold.delay + 1))


def step(
    environment: Environment,
    settings: _EnergyTankSettings,
    state: _EnergyTankState,
    memory: _EnergyTankMemory,
    position: float,
    torque_applied: float,
) -> EnergyBalance:
    """Accounts for the hold that ended; see `Controller.step`."""
    axis, model = state.axis, state.model
    if not axis.started:
        begin_model(environment, axis, model, memory.axis, position)
        return AT_REST
    missed, parts, oldest = axis.missed, memory.parts, axis.oldest
    for behind in range(min(missed, len(parts))):  # the drive repeats the newest command
        parts[oldest + behind - len(parts)] = parts[oldest - 1]
    hold = open_hold(settings.hold, axis, memory.axis, position, torque_applied)
    place = axis.oldest
    part = 1.0 if missed else parts[place]  # which command acted is then not known
    fill(settings, state, hold, part)
    branch, h_r, contact, spring, damper = follow(environment, model, position, hold)
    variable = spring - constant_force(settings.constant_stiffness, model.true, spring)
    share = allowed_share(settings, state, hold, variable, damper)
    rendered_spring = spring - (1.0 - share) * variable
    part = rendered_spring / spring if spring != 0.0 else 1.0
    gen, leak = settle(environment, model, part, hold.h_i, h_r)
    torque = rendered_spring + damper
    memory.parts[place] = share * variable / torque if torque != 0.0 else 0.0
    account = new(HoldAccount, (branch, h_r, gen, 0.0, leak))
    rendered = environment.damping if contact else 0.0
    efforts = rendered_spring, damper, 0.0
    return close_hold(settings.hold, axis, memory.axis, hold, account, efforts, rendered, model.state, model.h_s)


def constant_force(stiffness: float, depth: float, spring: float) -> float:
    """Returns the force of the constant spring, not larger than that of the environment [N or N*m]."""
    force = stiffness * depth
    return force if abs(force) < abs(spring) else spring


def fill(settings: _EnergyTankSettings, state: _EnergyTankState, hold: Hold, part: float) -> None:
    """Adds to the tank what damper and variable spring took up in a hold, `part` of its force being the latter's."""
    state.brought += part * hold.h_i
    dissipated = hold.damper * hold.displacement
    if dissipated > 0.0 and settings.initial_energy + state.brought < settings.most_energy:
        state.brought += dissipated


def allowed_share(
    settings: _EnergyTankSettings, state: _EnergyTankState, hold: Hold, variable: float, damper: float
) -> float:
    """Returns b, the part of the variable spring that the tank allows in the next hold, 0..1.

    Args:
        settings: Of the run.
        state: Of the run.
        hold: That ended; the next is taken to move like it.
        variable: Force of the whole variable spring [N or N*m].
        damper: Force of the damper [N or N*m].
    """
    taken = -variable * hold.displacement
    if taken <= 0.0:
        return 1.0
    there = settings.initial_energy + state.brought - settings.least_energy + max(0.0, damper * hold.displacement)
    return min(1.0, max(0.0, there / taken))


class EnergyTank(SteppedController):
    """The sampled environment, its spring within what a tank holds."""

    parameters_type: ClassVar[type[Parameters]] = EnergyTankParameters
    kernel: ClassVar[Kernel] = Kernel(settings_of, _EnergyTankState, memory_of, step)
