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


class ForceGradientParameters(PassivityObserverParameters):
    least_force: Annotated[float, quantity("N", "N*m", ge=0.0, le=1000.0)] = 0.001


@dataclass(frozen=True, slots=True)
class _ForceGradientSettings:
    observer: ObserverSettings
    least_force: float


@dataclass(slots=True)
class _ForceGradientState:
    axis: Axis = field(default_factory=Axis)
    model: SampledModel = field(default_factory=SampledModel)
    observed: RunningSum = field(default_factory=RunningSum)
    wanted: float = 0.0
    force: float = 0.0
    depth: float = 0.0


def settings_of(
    environment: Environment, parameters: ForceGradientParameters, loop: LoopProperties
) -> _ForceGradientSettings:
    observer = observer_settings("force_gradient", environment, parameters, loop)
    return _ForceGradientSettings(observer, parameters.least_force)


def step(
    environment: Environment,
    settings: _ForceGradientSettings,
    state: _ForceGradientState,
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
    wanted = spring + damper
    force = gradient_force(settings.least_force, state, wanted, model.true)
    share = force / wanted if force != 0.0 else 0.0
    extra = controlling_damping(settings.observer.damping_limit, observed, hold) if contact else 0.0
    efforts = (spring * share, damper * share, extra * hold.displacement / hold.elapsed)
    state.wanted, state.force, state.depth = (wanted, force + efforts[2], model.true)
    account = new(HoldAccount, (branch, h_r, gen, 0.0, leak))
    rendered = environment.damping * share + extra if contact else 0.0
    return close_hold(settings.observer.hold, axis, memory, hold, account, efforts, rendered, model.state, model.h_s)


def gradient_force(least_force: float, state: _ForceGradientState, wanted: float, depth: float) -> float:
    if abs(wanted) <= least_force:
        return 0.0
    side = 1.0 if wanted > 0.0 else -1.0
    change = side * (wanted - state.wanted)
    if side * (depth - state.depth) < 0.0:
        change = -abs(abs(wanted) - abs(state.wanted))
    return side * max(0.0, side * state.force + change)


class ForceGradient(SteppedController):
    parameters_type: ClassVar[type[Parameters]] = ForceGradientParameters
    kernel: ClassVar[Kernel] = Kernel(settings_of, _ForceGradientState, observer_memory, step)
