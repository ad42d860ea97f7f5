"""`passivity_observer`: PO/PC of ref. [9] in its exact sampled form.

The observer sums the interaction energy (eq. 2), which for a held torque is exact and needs no estimate of velocity.
While the sum is negative - more was drawn than ever put in - the passivity controller adds a damper sized to win the
shortfall back in one hold like the last. It guards eq. 3 and knows nothing of what the model should have dissipated
(eq. 4): a spring and damper that creates energy may feel like a spring alone before it acts, as sec. II of the paper
says.
"""

from dataclasses import dataclass, field
from typing import Annotated, ClassVar, Protocol

from canhaptic.control.balance import AT_REST, Certificate, EnergyBalance
from canhaptic.control.environments.environment import Environment
from canhaptic.control.passivity.controller import LoopProperties
from canhaptic.control.passivity.hold_account import (
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
from canhaptic.control.passivity.sampled_model import SampledModel, begin_model, follow, settle
from canhaptic.control.passivity.stepped import SteppedController
from canhaptic.control.recovery import damping_cap
from canhaptic.control.running_sum import RunningSum, add
from canhaptic.control.velocity import DamperVelocity
from canhaptic.errors import ParameterError
from canhaptic.kernels import Kernel, MakeBuffer, new
from canhaptic.units import Parameters, quantity


class PassivityObserverParameters(DamperVelocity):
    """How hard the passivity controller may brake."""

    damping_limit: Annotated[float, quantity("N*s/m", "N*m*s/rad", gt=0.0)] | None = None
    """Damping limit of the passivity controller. Without it the cap from moving mass, delay and sample time holds, so
    one of the two must be known: the damper wanted grows without bound as the motion comes to rest."""


@dataclass(frozen=True, slots=True)
class ObserverSettings:
    """Constants of a run."""

    damping_limit: float  # of the passivity controller [N*s/m or N*m*s/rad]
    hold: HoldSettings


@dataclass(slots=True)
class _PassivityObserverState:
    """State kept from SYNC to SYNC."""

    axis: Axis = field(default_factory=Axis)
    model: SampledModel = field(default_factory=SampledModel)
    observed: RunningSum = field(default_factory=RunningSum)  # sum(h_i) [J]


def settings_of(
    environment: Environment, parameters: PassivityObserverParameters, loop: LoopProperties
) -> ObserverSettings:
    """Returns what is fixed for a run.

    Raises:
        ParameterError: Nothing bounds the damper.
    """
    return observer_settings("passivity_observer", environment, parameters, loop)


def observer_settings(
    algorithm: str, environment: Environment, parameters: PassivityObserverParameters, loop: LoopProperties
) -> ObserverSettings:
    """Returns what is fixed for a run of an algorithm with a passivity controller.

    Raises:
        ParameterError: Nothing bounds the damper.
    """
    limit = parameters.damping_limit
    if limit is None and loop.moving_mass is None:
        raise ParameterError(
            f"{algorithm}: got neither damping_limit nor moving_mass, expected one of them to bound the "
            "damper; give passivity.damping_limit, or passivity.moving_mass for the cap it implies "
            "(--set passivity.moving_mass=0.2)"
        )
    if limit is None:
        limit = max(0.0, damping_cap(loop.delay, loop.moving_mass, loop.sample_time) - environment.damping)
    return ObserverSettings(limit, hold_settings(parameters, loop, Certificate.NONE))


class _WithObserver(Protocol):
    """Settings of an algorithm with a passivity controller."""

    @property
    def observer(self) -> ObserverSettings: ...


def observer_memory(settings: _WithObserver, make_buffer: MakeBuffer) -> AxisMemory:
    """Returns the buffers of one axis of an algorithm with a passivity controller that needs no others."""
    return hold_memory(settings.observer, make_buffer)


def step(
    environment: Environment,
    settings: ObserverSettings,
    state: _PassivityObserverState,
    memory: AxisMemory,
    position: float,
    torque_applied: float,
) -> EnergyBalance:
    """Accounts for the hold that ended; see `Controller.step`."""
    axis, model = state.axis, state.model
    if not axis.started:
        begin_model(environment, axis, model, memory, position)
        return AT_REST
    hold = open_hold(settings.hold, axis, memory, position, torque_applied)
    observed = add(state.observed, hold.h_i)
    branch, h_r, contact, spring, damper = follow(environment, model, position, hold)
    gen, leak = settle(environment, model, 1.0, hold.h_i - hold.h_pas, h_r)
    extra = controlling_damping(settings.damping_limit, observed, hold) if contact else 0.0
    efforts = spring, damper, extra * hold.displacement / hold.elapsed
    account = new(HoldAccount, (branch, h_r, gen, 0.0, leak))
    rendered = environment.damping + extra if contact else 0.0
    return close_hold(settings.hold, axis, memory, hold, account, efforts, rendered, model.state, model.h_s)


def controlling_damping(limit: float, missing: float, hold: Hold) -> float:
    """Returns the damping [N*s/m or N*m*s/rad] that wins back an energy below zero [J] in one hold like the last."""
    displacement = hold.displacement
    if missing >= 0.0 or displacement == 0.0:
        return 0.0
    return min(limit, -missing * hold.elapsed / displacement / displacement)


class PassivityObserver(SteppedController):
    """Time-domain passivity control around the sampled environment."""

    parameters_type: ClassVar[type[Parameters]] = PassivityObserverParameters
    kernel: ClassVar[Kernel] = Kernel(settings_of, _PassivityObserverState, hold_memory, step)
