"""`windowed_observer`: a passivity observer that forgets what was dissipated long ago.

An observer that sums from the start saves up what the environment dissipates, and then lets it be drawn for as long as
it lasts. Here energy that came in more than `window` holds ago is taken off the sum, while the sum stays above zero
without it (the equations of `computePOPCForce` in `src/POPCBilateralTeleoperation.cpp` of
github.com/manips-sai-org/sai-primitives, which was read; the passivity controller is that of Hannaford and Ryu 2002,
doi:10.1109/70.988969).

Departures: one port instead of the two of a teleoperator; the energy is that of the torque applied, exact for each
hold, so that what the damper took is booked when it was taken; energy that cannot be forgotten when it leaves the
window is never forgotten, where the source lengthens its queue. It promises nothing.
"""

from dataclasses import dataclass, field
from typing import Annotated, ClassVar, NamedTuple

from canhaptic.control.balance import AT_REST, EnergyBalance
from canhaptic.control.environments.environment import Environment
from canhaptic.control.passivity.controller import LoopProperties
from canhaptic.control.passivity.hold_account import (
    Axis,
    AxisMemory,
    HoldAccount,
    close_hold,
    open_hold,
)
from canhaptic.control.passivity.passivity_observer import (
    ObserverSettings,
    PassivityObserverParameters,
    controlling_damping,
    observer_memory,
    observer_settings,
)
from canhaptic.control.passivity.sampled_model import SampledModel, begin_model, follow, settle
from canhaptic.control.passivity.stepped import SteppedController
from canhaptic.kernels import Buffer, Kernel, MakeBuffer, new
from canhaptic.units import Parameters, quantity


class WindowedObserverParameters(PassivityObserverParameters):
    """Limits of the passivity controller, and the time for which energy is remembered."""

    window: Annotated[int, quantity("count", ge=1, le=100_000)] = 30
    """Holds that are remembered, independent of their energy; as in the source."""


@dataclass(frozen=True, slots=True)
class _WindowedObserverSettings:
    """Constants of a run."""

    observer: ObserverSettings
    window: int  # holds


@dataclass(slots=True)
class _WindowedObserverState:
    """State kept from SYNC to SYNC."""

    axis: Axis = field(default_factory=Axis)
    model: SampledModel = field(default_factory=SampledModel)
    energy: float = 0.0  # that is remembered [J]
    place: int = 0  # of the oldest hold in the window


class _WindowedObserverMemory(NamedTuple):
    """Buffers of one axis."""

    axis: AxisMemory
    recent: Buffer  # energy of each hold in the window, a ring [J]


def settings_of(
    environment: Environment, parameters: WindowedObserverParameters, loop: LoopProperties
) -> _WindowedObserverSettings:
    """Returns what is fixed for a run.

    Raises:
        ParameterError: Nothing bounds the damper.
    """
    observer = observer_settings("windowed_observer", environment, parameters, loop)
    return _WindowedObserverSettings(observer, parameters.window)


def memory_of(settings: _WindowedObserverSettings, make_buffer: MakeBuffer) -> _WindowedObserverMemory:
    """Returns the buffers of one axis."""
    return _WindowedObserverMemory(observer_memory(settings, make_buffer), make_buffer(settings.window))


def step(
    environment: Environment,
    settings: _WindowedObserverSettings,
    state: _WindowedObserverState,
    memory: _WindowedObserverMemory,
    position: float,
    torque_applied: float,
) -> EnergyBalance:
    """Accounts for the hold that ended; see `Controller.step`."""
    axis, model = state.axis, state.model
    if not axis.started:
        begin_model(environment, axis, model, memory.axis, position)
        return AT_REST
    hold = open_hold(settings.observer.hold, axis, memory.axis, position, torque_applied)
    remember(state, memory.recent, hold.h_i)
    branch, h_r, contact, spring, damper = follow(environment, model, position, hold)
    gen, leak = settle(environment, model, 1.0, hold.h_i - hold.h_pas, h_r)
    extra = controlling_damping(settings.observer.damping_limit, state.energy, hold) if contact else 0.0
    efforts = spring, damper, extra * hold.displacement / hold.elapsed
    account = new(HoldAccount, (branch, h_r, gen, 0.0, leak))
    rendered = environment.damping + extra if contact else 0.0
    return close_hold(
        settings.observer.hold, axis, memory.axis, hold, account, efforts, rendered, model.state, model.h_s
    )


def remember(state: _WindowedObserverState, recent: Buffer, h_i: float) -> None:
    """Adds the energy of a hold [J] to what is remembered, and forgets the hold that leaves the window."""
    place = state.place
    leaving, recent[place] = recent[place], h_i
    state.place = place + 1 if place + 1 < len(recent) else 0
    energy = state.energy + h_i
    if 0.0 < leaving < energy:
        energy -= leaving
    state.energy = energy


class WindowedObserver(SteppedController):
    """Time-domain passivity control with a window around the sampled environment."""

    parameters_type: ClassVar[type[Parameters]] = WindowedObserverParameters
    kernel: ClassVar[Kernel] = Kernel(settings_of, _WindowedObserverState, memory_of, step)
