from dataclasses import dataclass, field
from math import copysign, inf
from typing import Annotated, ClassVar

from canhaptic.control.balance import AT_REST, Certificate, EnergyBalance, RunningSum, add
from canhaptic.control.damping import DamperVelocity
from canhaptic.control.environments.environment import Environment
from canhaptic.control.passivity.controller import LoopProperties
from canhaptic.kernels import new
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


class BoundedObserverParameters(DamperVelocity):
    speed_offset: Annotated[float, quantity("m/s", "rad/s", gt=0.0, le=10.0)] = 0.01
    integral_holds: Annotated[float, quantity("count", ge=1.0, le=1000000.0)] = 10.0
    force_limit: Annotated[float, quantity("N", "N*m", gt=0.0, le=1000000.0)] | None = None


@dataclass(frozen=True, slots=True)
class _BoundedObserverSettings:
    speed_offset: float
    integral_holds: float
    force_limit: float
    hold: HoldSettings


@dataclass(slots=True)
class _BoundedObserverState:
    axis: Axis = field(default_factory=Axis)
    model: SampledModel = field(default_factory=SampledModel)
    observed: RunningSum = field(default_factory=RunningSum)
    integral: float = 0.0
    force: float = 0.0


def settings_of(
    environment: Environment, parameters: BoundedObserverParameters, loop: LoopProperties
) -> _BoundedObserverSettings:
    limit = inf if parameters.force_limit is None else parameters.force_limit
    hold = hold_settings(parameters, loop, Certificate.NONE)
    return _BoundedObserverSettings(parameters.speed_offset, parameters.integral_holds, limit, hold)


def step(
    environment: Environment,
    settings: _BoundedObserverSettings,
    state: _BoundedObserverState,
    memory: AxisMemory,
    position: float,
    torque_applied: float,
) -> EnergyBalance:
    axis, model = (state.axis, state.model)
    if not axis.started:
        begin_model(environment, axis, model, memory, position)
        return AT_REST
    hold = open_hold(settings.hold, axis, memory, position, torque_applied)
    observed = add(state.observed, hold.h_i)
    branch, h_r, contact, spring, damper = follow(environment, model, position, hold)
    gen, leak = settle(environment, model, 1.0, hold.h_i - hold.h_pas, h_r)
    force = state.force = controlling_force(settings, state, observed, hold, spring + damper) if contact else 0.0
    account = new(HoldAccount, (branch, h_r, gen, 0.0, leak))
    velocity = hold.displacement / hold.elapsed
    rendered = environment.damping if contact else 0.0
    if velocity * force > 0.0:
        rendered += force / velocity
    return close_hold(
        settings.hold, axis, memory, hold, account, (spring, damper, force), rendered, model.state, model.h_s
    )


def controlling_force(
    settings: _BoundedObserverSettings, state: _BoundedObserverState, observed: float, hold: Hold, wanted: float
) -> float:
    force = 0.0
    if observed < 0.0:
        velocity, power = (hold.displacement / hold.elapsed, -observed / hold.elapsed)
        if velocity != 0.0:
            force = (power + state.integral) / (velocity + copysign(settings.speed_offset, velocity))
        state.integral += (power - state.force * velocity) / settings.integral_holds
    else:
        state.integral = 0.0
    force = min(max(force, -settings.force_limit), settings.force_limit)
    return force if (wanted + force) * wanted > 0.0 else -wanted


class BoundedObserver(SteppedController):
    parameters_type: ClassVar[type[Parameters]] = BoundedObserverParameters
    kernel: ClassVar[Kernel] = Kernel(settings_of, _BoundedObserverState, hold_memory, step)
