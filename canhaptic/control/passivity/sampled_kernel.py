"""The one step of every algorithm that samples its environment: begin, open the hold, follow, respond, settle, close.

Such an algorithm is a parameter model, the state that it keeps beyond that of every axis, and one function `respond`;
`sampled_kernel` makes the kernel of them::

    class Limp(SteppedController):
        parameters_type = LimpParameters
        kernel = sampled_kernel(respond, LimpState)
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from math import inf
from typing import Any, Generic, NamedTuple, TypeAlias

from canhaptic.control.balance import AT_REST, Certificate, EnergyBalance
from canhaptic.control.environments.environment import Environment
from canhaptic.control.environments.plain import plain
from canhaptic.control.passivity.controller import LoopProperties
from canhaptic.control.passivity.hold_account import (
    Axis,
    AxisMemory,
    Hold,
    HoldAccount,
    HoldSettings,
    axis_memory,
    close_hold,
    hold_settings,
    open_hold,
)
from canhaptic.control.passivity.sampled_model import Asked, SampledModel, begin_model, follow, settle
from canhaptic.control.velocity import DamperVelocity
from canhaptic.kernels import Buffer, GivenT, Kernel, MakeBuffer, Run, StateT, new
from canhaptic.kernels.binding import bound


@dataclass(frozen=True, slots=True)
class SampledSettings(Generic[GivenT]):
    """Constants of a run."""

    given: GivenT  # parameters of the algorithm; a kernel reads their numbers alone
    limit: float  # of the damping or force that the algorithm adds; infinite: none
    hold: HoldSettings


@dataclass(slots=True)
class SampledState:
    """State kept from SYNC to SYNC; an algorithm adds its own fields."""

    axis: Axis = field(default_factory=Axis)
    model: SampledModel = field(default_factory=SampledModel)


class SampledMemory(NamedTuple):
    """Buffers of one axis."""

    axis: AxisMemory
    own: Buffer  # of the algorithm


SampledRun: TypeAlias = Run[SampledSettings[GivenT], StateT, SampledMemory]
"""Settings, state and memory of an algorithm with given parameters and state."""


class Reply(NamedTuple):
    """What an algorithm makes of the model's efforts in the next command."""

    stored: float  # share of the model's state whose energy counts as stored, 0..1
    spring: float  # [N or N*m]
    damper: float  # [N or N*m]
    modulated: float  # effort that the algorithm adds [N or N*m]
    damping: float  # of damper and added effort together [N*s/m or N*m*s/rad]


def sampled_settings(
    environment: Environment,
    parameters: DamperVelocity,
    loop: LoopProperties,
    limit: float = inf,
    certificate: Certificate = Certificate.NONE,
) -> SampledSettings[Any]:
    """Returns what is fixed for a run.

    Raises:
        ParameterError: A windowed velocity without an encoder count.
    """
    return SampledSettings(plain(parameters), limit, hold_settings(parameters, loop, certificate))


def respond(run: SampledRun[Any, Any], hold: Hold, asked: Asked) -> Reply:
    """Placeholder of an algorithm: its part of the step, after a hold, with the efforts of the model for the next."""
    raise NotImplementedError


def step(
    environment: Environment, run: SampledRun[Any, SampledState], position: float, torque_applied: float
) -> EnergyBalance:
    """Accounts for the hold that ended; see `Controller.step`."""
    state, memory, settings = run.state, run.memory.axis, run.settings.hold
    axis, model = state.axis, state.model
    if not axis.started:
        begin_model(environment, axis, model, memory, position)
        return AT_REST
    hold = open_hold(settings, axis, memory, position, torque_applied)
    asked = follow(environment, model, position, hold)
    stored, spring, damper, modulated, damping = respond(run, hold, asked)
    gen, leak = settle(environment, model, stored, hold.h_i - hold.h_pas, asked.h_r)
    account = new(HoldAccount, (asked.branch, asked.h_r, gen, 0.0, leak))
    efforts = spring, damper, modulated
    return close_hold(settings, axis, memory, hold, account, efforts, damping, model.state, model.h_s)


def sampled_kernel(
    respond_as: Callable[[Any, Hold, Asked], Reply],
    state: Callable[[], SampledState] = SampledState,
    settings: Callable[..., SampledSettings[Any]] = sampled_settings,
    kept: Callable[[SampledSettings[Any]], int] = lambda _settings: 0,
) -> Kernel:
    """Returns the kernel of an algorithm that samples its environment.

    Args:
        respond_as: The algorithm, in the place of `respond`.
        state: Makes the state at rest.
        settings: (environment, parameters, loop) -> what is fixed for a run.
        kept: Length of the buffer that the algorithm keeps.
    """

    def memory_of(made: SampledSettings[Any], make_buffer: MakeBuffer) -> SampledMemory:
        axis = axis_memory(made.hold.delay, made.hold.longest_window, make_buffer)
        return SampledMemory(axis, make_buffer(kept(made)))

    return Kernel(settings, state, memory_of, bound(step, {respond: respond_as}))
