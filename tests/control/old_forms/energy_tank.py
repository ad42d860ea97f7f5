from dataclasses import dataclass, field
from typing import Annotated, ClassVar, NamedTuple

from canhaptic.control.balance import AT_REST, Certificate, EnergyBalance
from canhaptic.control.damping import DamperVelocity
from canhaptic.control.environments.environment import Environment
from canhaptic.control.passivity.controller import LoopProperties
from canhaptic.kernels import Buffer, MakeBuffer, new
from canhaptic.units import Parameters, quantity
from tests.control.old_forms.hold_account import (
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
from tests.control.old_forms.kernel import Kernel
from tests.control.old_forms.sampled_model import SampledModel, begin_model, follow, settle
from tests.control.old_forms.stepped import SteppedController


class EnergyTankParameters(DamperVelocity):
    constant_stiffness: Annotated[float, quantity("N/m", "N*m/rad", ge=0.0, le=1000000000.0)] = 0.0
    initial_energy: Annotated[float, quantity("J", ge=0.0, le=1000.0)] = 0.0
    least_energy: Annotated[float, quantity("J", ge=0.0, le=1000.0)] = 0.0
    most_energy: Annotated[float, quantity("J", gt=0.0, le=1000.0)] = 3.0


@dataclass(frozen=True, slots=True)
class _EnergyTankSettings:
    constant_stiffness: float
    initial_energy: float
    least_energy: float
    most_energy: float
    hold: HoldSettings


@dataclass(slots=True)
class _EnergyTankState:
    axis: Axis = field(default_factory=Axis)
    model: SampledModel = field(default_factory=SampledModel)
    brought: float = 0.0


class _EnergyTankMemory(NamedTuple):
    axis: AxisMemory
    parts: Buffer


def settings_of(
    environment: Environment, parameters: EnergyTankParameters, loop: LoopProperties
) -> _EnergyTankSettings:
    given, hold = (parameters, hold_settings(parameters, loop, Certificate.NONE))
    return _EnergyTankSettings(
        given.constant_stiffness, given.initial_energy, given.least_energy, given.most_energy, hold
    )


def memory_of(settings: _EnergyTankSettings, make_buffer: MakeBuffer) -> _EnergyTankMemory:
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
    axis, model = (state.axis, state.model)
    if not axis.started:
        begin_model(environment, axis, model, memory.axis, position)
        return AT_REST
    missed, parts, oldest = (axis.missed, memory.parts, axis.oldest)
    for behind in range(min(missed, len(parts))):
        parts[oldest + behind - len(parts)] = parts[oldest - 1]
    hold = open_hold(settings.hold, axis, memory.axis, position, torque_applied)
    place = axis.oldest
    part = 1.0 if missed else parts[place]
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
    efforts = (rendered_spring, damper, 0.0)
    return close_hold(settings.hold, axis, memory.axis, hold, account, efforts, rendered, model.state, model.h_s)


def constant_force(stiffness: float, depth: float, spring: float) -> float:
    force = stiffness * depth
    return force if abs(force) < abs(spring) else spring


def fill(settings: _EnergyTankSettings, state: _EnergyTankState, hold: Hold, part: float) -> None:
    state.brought += part * hold.h_i
    dissipated = hold.damper * hold.displacement
    if dissipated > 0.0 and settings.initial_energy + state.brought < settings.most_energy:
        state.brought += dissipated


def allowed_share(
    settings: _EnergyTankSettings, state: _EnergyTankState, hold: Hold, variable: float, damper: float
) -> float:
    taken = -variable * hold.displacement
    if taken <= 0.0:
        return 1.0
    there = settings.initial_energy + state.brought - settings.least_energy + max(0.0, damper * hold.displacement)
    return min(1.0, max(0.0, there / taken))


class EnergyTank(SteppedController):
    parameters_type: ClassVar[type[Parameters]] = EnergyTankParameters
    kernel: ClassVar[Kernel] = Kernel(settings_of, _EnergyTankState, memory_of, step)
