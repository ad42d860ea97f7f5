from dataclasses import dataclass, field
from typing import Annotated, ClassVar, Protocol

from canhaptic.control.balance import AT_REST, Certificate, EnergyBalance, RunningSum, add
from canhaptic.control.damping import DamperVelocity, damping_cap
from canhaptic.control.environments.environment import Environment
from canhaptic.control.passivity.controller import LoopProperties
from canhaptic.errors import ParameterError
from canhaptic.kernels import MakeBuffer, new
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


class PassivityObserverParameters(DamperVelocity):
    damping_limit: Annotated[float, quantity("N*s/m", "N*m*s/rad", gt=0.0)] | None = None


@dataclass(frozen=True, slots=True)
class ObserverSettings:
    damping_limit: float
    hold: HoldSettings


@dataclass(slots=True)
class _PassivityObserverState:
    axis: Axis = field(default_factory=Axis)
    model: SampledModel = field(default_factory=SampledModel)
    observed: RunningSum = field(default_factory=RunningSum)


def settings_of(
    environment: Environment, parameters: PassivityObserverParameters, loop: LoopProperties
) -> ObserverSettings:
    return observer_settings("passivity_observer", environment, parameters, loop)


def observer_settings(
    algorithm: str, environment: Environment, parameters: PassivityObserverParameters, loop: LoopProperties
) -> ObserverSettings:
    limit = parameters.damping_limit
    if limit is None and loop.moving_mass is None:
        raise ParameterError(
            f"{algorithm}: got neither damping_limit nor moving_mass, expected one of them "
            f"to bound the damper; give passivity.damping_limit, or passivity.moving_mass for the cap it implies"
        )
    if limit is None:
        limit = max(0.0, damping_cap(loop.delay, loop.moving_mass, loop.sample_time) - environment.damping)
    return ObserverSettings(limit, hold_settings(parameters, loop, Certificate.NONE))


class _WithObserver(Protocol):
    @property
    def observer(self) -> ObserverSettings: ...


def observer_memory(settings: _WithObserver, make_buffer: MakeBuffer) -> AxisMemory:
    return hold_memory(settings.observer, make_buffer)


def step(
    environment: Environment,
    settings: ObserverSettings,
    state: _PassivityObserverState,
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
    extra = controlling_damping(settings.damping_limit, observed, hold) if contact else 0.0
    efforts = (spring, damper, extra * hold.displacement / hold.elapsed)
    account = new(HoldAccount, (branch, h_r, gen, 0.0, leak))
    rendered = environment.damping + extra if contact else 0.0
    return close_hold(settings.hold, axis, memory, hold, account, efforts, rendered, model.state, model.h_s)


def controlling_damping(limit: float, missing: float, hold: Hold) -> float:
    displacement = hold.displacement
    if missing >= 0.0 or displacement == 0.0:
        return 0.0
    return min(limit, -missing * hold.elapsed / displacement / displacement)


class PassivityObserver(SteppedController):
    parameters_type: ClassVar[type[Parameters]] = PassivityObserverParameters
    kernel: ClassVar[Kernel] = Kernel(settings_of, _PassivityObserverState, hold_memory, step)
