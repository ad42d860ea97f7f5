from dataclasses import dataclass, field
from typing import ClassVar

from canhaptic.control.balance import AT_REST, Certificate, EnergyBalance
from canhaptic.control.damping import DamperVelocity
from canhaptic.control.environments.environment import Environment
from canhaptic.control.passivity.controller import LoopProperties
from canhaptic.kernels import MakeBuffer, new
from canhaptic.units import Parameters
from tests.control.old_forms.hold_account import (
    Axis,
    AxisMemory,
    HoldAccount,
    HoldSettings,
    axis_memory,
    close_hold,
    hold_settings,
    open_hold,
)
from tests.control.old_forms.kernel import Kernel
from tests.control.old_forms.sampled_model import SampledModel, begin_model, follow, settle
from tests.control.old_forms.stepped import SteppedController


class UnprotectedParameters(DamperVelocity):
    pass


@dataclass(slots=True)
class _UnprotectedState:
    axis: Axis = field(default_factory=Axis)
    model: SampledModel = field(default_factory=SampledModel)


def settings_of(environment: Environment, parameters: UnprotectedParameters, loop: LoopProperties) -> HoldSettings:
    return hold_settings(parameters, loop, Certificate.NONE)


def memory_of(settings: HoldSettings, make_buffer: MakeBuffer) -> AxisMemory:
    return axis_memory(settings.delay, settings.longest_window, make_buffer)


def step(
    environment: Environment,
    settings: HoldSettings,
    state: _UnprotectedState,
    memory: AxisMemory,
    position: float,
    torque_applied: float,
) -> EnergyBalance:
    axis, model = (state.axis, state.model)
    if not axis.started:
        begin_model(environment, axis, model, memory, position)
        return AT_REST
    hold = open_hold(settings, axis, memory, position, torque_applied)
    branch, h_r, contact, spring, damper = follow(environment, model, position, hold)
    gen, leak = settle(environment, model, 1.0, hold.h_i, h_r)
    account = new(HoldAccount, (branch, h_r, gen, 0.0, leak))
    rendered = environment.damping if contact else 0.0
    return close_hold(settings, axis, memory, hold, account, (spring, damper, 0.0), rendered, model.state, model.h_s)


class Unprotected(SteppedController):
    parameters_type: ClassVar[type[Parameters]] = UnprotectedParameters
    kernel: ClassVar[Kernel] = Kernel(settings_of, _UnprotectedState, memory_of, step)
