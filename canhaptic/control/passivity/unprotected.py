"""`unprotected`: the sampled environment without protection, as most haptic loops run it: what sampling creates."""

from dataclasses import dataclass, field
from typing import ClassVar

from canhaptic.control.balance import AT_REST, Certificate, EnergyBalance
from canhaptic.control.environments.environment import Environment
from canhaptic.control.passivity.controller import LoopProperties
from canhaptic.control.passivity.hold_account import (
    Axis,
    AxisMemory,
    HoldAccount,
    HoldSettings,
    axis_memory,
    close_hold,
    hold_settings,
    open_hold,
)
from canhaptic.control.passivity.sampled_model import SampledModel, begin_model, follow, settle
from canhaptic.control.passivity.stepped import SteppedController
from canhaptic.control.velocity import DamperVelocity
from canhaptic.kernels import Kernel, MakeBuffer, new
from canhaptic.units import Parameters


class UnprotectedParameters(DamperVelocity):
    """Nothing to choose but the velocity of the damper."""


@dataclass(slots=True)
class _UnprotectedState:
    """State kept from SYNC to SYNC."""

    axis: Axis = field(default_factory=Axis)
    model: SampledModel = field(default_factory=SampledModel)


def settings_of(environment: Environment, parameters: UnprotectedParameters, loop: LoopProperties) -> HoldSettings:
    """Returns what is fixed for a run."""
    return hold_settings(parameters, loop, Certificate.NONE)


def memory_of(settings: HoldSettings, make_buffer: MakeBuffer) -> AxisMemory:
    """Returns the buffers of one axis."""
    return axis_memory(settings.delay, settings.longest_window, make_buffer)


def step(
    environment: Environment,
    settings: HoldSettings,
    state: _UnprotectedState,
    memory: AxisMemory,
    position: float,
    torque_applied: float,
) -> EnergyBalance:
    """Torque = -effort(x) - d v with x and v straight from the position; see `Controller.step`."""
    axis, model = state.axis, state.model
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
    """torque = -effort(x) - d v."""

    parameters_type: ClassVar[type[Parameters]] = UnprotectedParameters
    kernel: ClassVar[Kernel] = Kernel(settings_of, _UnprotectedState, memory_of, step)
