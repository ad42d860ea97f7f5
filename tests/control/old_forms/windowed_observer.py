from dataclasses import dataclass, field
from typing import Annotated, ClassVar, NamedTuple

from canhaptic.control.balance import AT_REST, EnergyBalance
from canhaptic.control.environments.environment import Environment
from canhaptic.control.passivity.controller import LoopProperties
from canhaptic.kernels import Buffer, MakeBuffer, new
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


class WindowedObserverParameters(PassivityObserverParameters):
    window: Annotated[int, quantity("count", ge=1, le=100000)] = 30


@dataclass(frozen=True, slots=True)
class _WindowedObserverSettings:
    observer: ObserverSettings
    window: int


@dataclass(slots=True)
class _WindowedObserverState:
    axis: Axis = field(default_factory=Axis)
    model: SampledModel = field(default_factory=SampledModel)
    energy: float = 0.0
    place: int = 0


class _WindowedObserverMemory(NamedTuple):
    axis: AxisMemory
    recent: Buffer


def settings_of(
    environment: Environment, parameters: WindowedObserverParameters, loop: LoopProperties
) -> _WindowedObserverSettings:
    observer = observer_settings("windowed_observer", environment, parameters, loop)
    return _WindowedObserverSettings(observer, parameters.window)


def memory_of(settings: _WindowedObserverSettings, make_buffer: MakeBuffer) -> _WindowedObserverMemory:
    return _WindowedObserverMemory(observer_memory(settings, make_buffer), make_buffer(settings.window))


def step(
    environment: Environment,
    settings: _WindowedObserverSettings,
    state: _WindowedObserverState,
    memory: _WindowedObserverMemory,
    position: float,
    torque_applied: float,
) -> EnergyBalance:
    axis, model = (state.axis, state.model)
    if not axis.started:
        begin_model(environment, axis, model, memory.axis, position)
        return AT_REST
    hold = open_hold(settings.observer.hold, axis, memory.axis, position, torque_applied)
    remember(state, memory.recent, hold.h_i)
    branch, h_r, contact, spring, damper = follow(environment, model, position, hold)
    gen, leak = settle(environment, model, 1.0, hold.h_i - hold.h_pas, h_r)
    extra = controlling_damping(settings.observer.damping_limit, state.energy, hold) if contact else 0.0
    efforts = (spring, damper, extra * hold.displacement / hold.elapsed)
    account = new(HoldAccount, (branch, h_r, gen, 0.0, leak))
    rendered = environment.damping + extra if contact else 0.0
    return close_hold(
        settings.observer.hold, axis, memory.axis, hold, account, efforts, rendered, model.state, model.h_s
    )


def remember(state: _WindowedObserverState, recent: Buffer, h_i: float) -> None:
    place = state.place
    leaving, recent[place] = (recent[place], h_i)
    state.place = place + 1 if place + 1 < len(recent) else 0
    energy = state.energy + h_i
    if 0.0 < leaving < energy:
        energy -= leaving
    state.energy = energy


class WindowedObserver(SteppedController):
    parameters_type: ClassVar[type[Parameters]] = WindowedObserverParameters
    kernel: ClassVar[Kernel] = Kernel(settings_of, _WindowedObserverState, memory_of, step)
