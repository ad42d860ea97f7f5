from dataclasses import dataclass, field
from typing import Annotated, ClassVar, Self

from pydantic import model_validator

from canhaptic.control.balance import AT_REST, EnergyBalance
from canhaptic.control.environments.environment import Environment
from canhaptic.control.passivity.controller import LoopProperties
from canhaptic.kernels import new
from canhaptic.units import Parameters, quantity
from tests.control.old_forms.hold_account import Axis, AxisMemory, HoldAccount, close_hold, open_hold
from tests.control.old_forms.kernel import Kernel
from tests.control.old_forms.passivity_observer import (
    ObserverSettings,
    PassivityObserverParameters,
    observer_memory,
    observer_settings,
)
from tests.control.old_forms.sampled_model import SampledModel, begin_model, follow, settle
from tests.control.old_forms.stepped import SteppedController


class UltimatePassivityParameters(PassivityObserverParameters):
    lower: Annotated[float, quantity("J", le=0.0, ge=-1000.0)] = -0.01
    upper: Annotated[float, quantity("J", ge=-1000.0, le=1000.0)] = 0.0
    conservative_damping: Annotated[float, quantity("N*s/m", "N*m*s/rad", ge=0.0, le=1000000.0)] = 50.0
    counted_holds: Annotated[int, quantity("count", ge=0, le=1000000000)] = 0

    @model_validator(mode="after")
    def _upper_is_above_lower(self) -> Self:
        if self.upper <= self.lower:
            raise ValueError(f"upper {self.upper} J is not above lower {self.lower} J, expected upper > lower")
        return self


@dataclass(frozen=True, slots=True)
class _UltimatePassivitySettings:
    observer: ObserverSettings
    lower: float
    upper: float
    damping: float
    counted_holds: int


@dataclass(slots=True)
class _UltimatePassivityState:
    axis: Axis = field(default_factory=Axis)
    model: SampledModel = field(default_factory=SampledModel)
    energy: float = 0.0
    holds: int = 0
    conservative: bool = False


def settings_of(
    environment: Environment, parameters: UltimatePassivityParameters, loop: LoopProperties
) -> _UltimatePassivitySettings:
    given, observer = (parameters, observer_settings("ultimate_passivity", environment, parameters, loop))
    damping = min(given.conservative_damping, observer.damping_limit)
    return _UltimatePassivitySettings(observer, given.lower, given.upper, damping, given.counted_holds)


def step(
    environment: Environment,
    settings: _UltimatePassivitySettings,
    state: _UltimatePassivityState,
    memory: AxisMemory,
    position: float,
    torque_applied: float,
) -> EnergyBalance:
    axis, model = (state.axis, state.model)
    if not axis.started:
        begin_model(environment, axis, model, memory, position)
        return AT_REST
    hold = open_hold(settings.observer.hold, axis, memory, position, torque_applied)
    switch(settings, state, hold.h_i)
    branch, h_r, contact, spring, damper = follow(environment, model, position, hold)
    gen, leak = settle(environment, model, 1.0, hold.h_i - hold.h_pas, h_r)
    extra = settings.damping if contact and state.conservative else 0.0
    efforts = (spring, damper, extra * hold.velocity)
    account = new(HoldAccount, (branch, h_r, gen, 0.0, leak))
    rendered = environment.damping + extra if contact else 0.0
    return close_hold(settings.observer.hold, axis, memory, hold, account, efforts, rendered, model.state, model.h_s)


def switch(settings: _UltimatePassivitySettings, state: _UltimatePassivityState, h_i: float) -> None:
    state.energy += h_i
    state.holds += 1
    if state.holds == settings.counted_holds:
        state.energy, state.holds = (0.0, 0)
    if state.energy <= settings.lower:
        state.conservative = True
    elif state.energy >= settings.upper:
        state.conservative = False


class UltimatePassivity(SteppedController):
    parameters_type: ClassVar[type[Parameters]] = UltimatePassivityParameters
    kernel: ClassVar[Kernel] = Kernel(settings_of, _UltimatePassivityState, observer_memory, step)
