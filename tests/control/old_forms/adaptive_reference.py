from dataclasses import dataclass, field
from typing import Annotated, ClassVar

from canhaptic.control.balance import AT_REST, EnergyBalance, RunningSum, add
from canhaptic.control.environments.environment import Environment
from canhaptic.control.passivity.controller import LoopProperties
from canhaptic.kernels import new
from canhaptic.units import Parameters, quantity
from tests.control.old_forms.hold_account import Axis, AxisMemory, HoldAccount, close_hold, open_hold
from tests.control.old_forms.kernel import Kernel
from tests.control.old_forms.passivity_observer import (
    ObserverSettings,
    PassivityObserverParameters,
    controlling_damping,
    observer_memory,
    observer_settings,
)
from tests.control.old_forms.sampled_model import SampledModel, begin_model, follow, settle
from tests.control.old_forms.stepped import SteppedController


class AdaptiveReferenceParameters(PassivityObserverParameters):
    least_speed: Annotated[float, quantity("m/s", "rad/s", ge=0.0, le=10.0)] = 0.002


@dataclass(frozen=True, slots=True)
class _AdaptiveReferenceSettings:
    observer: ObserverSettings
    least_speed: float


@dataclass(slots=True)
class _AdaptiveReferenceState:
    axis: Axis = field(default_factory=Axis)
    model: SampledModel = field(default_factory=SampledModel)
    observed: RunningSum = field(default_factory=RunningSum)
    coefficient: float = 0.0


def settings_of(
    environment: Environment, parameters: AdaptiveReferenceParameters, loop: LoopProperties
) -> _AdaptiveReferenceSettings:
    observer = observer_settings("adaptive_reference", environment, parameters, loop)
    return _AdaptiveReferenceSettings(observer, parameters.least_speed)


def step(
    environment: Environment,
    settings: _AdaptiveReferenceSettings,
    state: _AdaptiveReferenceState,
    memory: AxisMemory,
    position: float,
    torque_applied: float,
) -> EnergyBalance:
    axis, model = (state.axis, state.model)
    if not axis.started:
        begin_model(environment, axis, model, memory, position)
        return AT_REST
    hold = open_hold(settings.observer.hold, axis, memory, position, torque_applied)
    observed = add(state.observed, hold.h_i)
    branch, h_r, contact, spring, damper = follow(environment, model, position, hold)
    gen, leak = settle(environment, model, 1.0, hold.h_i - hold.h_pas, h_r)
    below = below_reference(state, observed, hold.h_i)
    extra = 0.0
    if contact and abs(hold.velocity) > settings.least_speed:
        extra = controlling_damping(settings.observer.damping_limit, below, hold)
    efforts = (spring, damper, extra * hold.displacement / hold.elapsed)
    account = new(HoldAccount, (branch, h_r, gen, 0.0, leak))
    rendered = environment.damping + extra if contact else 0.0
    return close_hold(settings.observer.hold, axis, memory, hold, account, efforts, rendered, model.state, model.h_s)


def below_reference(state: _AdaptiveReferenceState, observed: float, h_i: float) -> float:
    square = state.model.true * state.model.true
    if h_i > 0.0:
        if square > 0.0:
            state.coefficient = max(0.0, observed / square)
        return 0.0
    if h_i == 0.0:
        return 0.0
    return min(0.0, observed - state.coefficient * square)


class AdaptiveReference(SteppedController):
    parameters_type: ClassVar[type[Parameters]] = AdaptiveReferenceParameters
    kernel: ClassVar[Kernel] = Kernel(settings_of, _AdaptiveReferenceState, observer_memory, step)
