from dataclasses import dataclass, field
from typing import Annotated, ClassVar

from canhaptic.control.balance import AT_REST, Certificate, EnergyBalance
from canhaptic.control.damping import DamperVelocity
from canhaptic.control.environments.environment import Environment
from canhaptic.control.passivity.controller import LoopProperties
from canhaptic.kernels import new
from canhaptic.units import Parameters, quantity
from tests.control.old_forms.hold_account import (
    Axis,
    AxisMemory,
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


class ForceAugmentationParameters(DamperVelocity):
    feedback_stiffness: Annotated[float, quantity("N/m", "N*m/rad", gt=0.0, le=1000000000.0)] = 1200.0
    increment: Annotated[float, quantity("N", "N*m", ge=0.0, le=1000.0)] = 0.001
    reach: Annotated[float, quantity("m", "rad", ge=0.0, le=1.0)] = 1e-05
    coarse: Annotated[float, quantity("N/m", "N*m/rad", ge=0.0, le=1000000000.0)] = 1000.0


@dataclass(frozen=True, slots=True)
class _ForceAugmentationSettings:
    feedback_stiffness: float
    increment: float
    reach: float
    coarse: float
    hold: HoldSettings


@dataclass(slots=True)
class _ForceAugmentationState:
    axis: Axis = field(default_factory=Axis)
    model: SampledModel = field(default_factory=SampledModel)
    offset: float = 0.0
    depth: float = 0.0
    force: float = 0.0
    released: bool = False


def settings_of(
    environment: Environment, parameters: ForceAugmentationParameters, loop: LoopProperties
) -> _ForceAugmentationSettings:
    given = parameters
    hold = hold_settings(given, loop, Certificate.NONE)
    return _ForceAugmentationSettings(given.feedback_stiffness, given.increment, given.reach, given.coarse, hold)


def step(
    environment: Environment,
    settings: _ForceAugmentationSettings,
    state: _ForceAugmentationState,
    memory: AxisMemory,
    position: float,
    torque_applied: float,
) -> EnergyBalance:
    axis, model = (state.axis, state.model)
    if not axis.started:
        begin_model(environment, axis, model, memory, position)
        return AT_REST
    hold = open_hold(settings.hold, axis, memory, position, torque_applied)
    zone = model.zone
    branch, h_r, contact, spring, damper = follow(environment, model, position, hold)
    gen, leak = settle(environment, model, 1.0, hold.h_i, h_r)
    if model.zone != zone:
        state.offset = state.depth = state.force = 0.0
        state.released = False
    size = abs(spring)
    share = augmented_force(settings, state, abs(model.true), size) / size if size > 0.0 else 0.0
    account = new(HoldAccount, (branch, h_r, gen, 0.0, leak))
    rendered = environment.damping if contact else 0.0
    efforts = (spring * share, damper, 0.0)
    return close_hold(settings.hold, axis, memory, hold, account, efforts, rendered, model.state, model.h_s)


def augmented_force(
    settings: _ForceAugmentationSettings, state: _ForceAugmentationState, depth: float, full: float
) -> float:
    if depth <= 0.0:
        return full
    stiffness, force = (full / depth, state.force)
    soft = min(stiffness, settings.feedback_stiffness) * depth
    if depth > state.depth:
        if state.released and state.depth > 0.0:
            missing = stiffness - state.force / state.depth
            if missing > settings.coarse:
                state.offset += settings.reach * missing
            else:
                state.offset += settings.increment if missing > 0.0 else -settings.increment
        force = max(0.0, soft + state.offset) if state.released else full
    elif depth < state.depth:
        state.released = True
        force = max(0.0, soft + state.offset)
    state.depth, state.force = (depth, force)
    return force


class ForceAugmentation(SteppedController):
    parameters_type: ClassVar[type[Parameters]] = ForceAugmentationParameters
    kernel: ClassVar[Kernel] = Kernel(settings_of, _ForceAugmentationState, hold_memory, step)
