"""`adaptive_reference`: a passivity controller that follows a reference energy of its own making.

The energy that came in is compared with E_ref = k x^2, x the depth in the environment. While it rises, k is the one
that fits it best, k = max(0, E / x^2); while it falls, a damper wins back what it is below E_ref (equations of the
public implementation `AdaptivTDPA.cpp` of github.com/nafi3rad/PassivityControlOfHapticRobot, which was read; no paper
of it was found). So the damper acts early and gently, where the observer of Hannaford and Ryu
(doi:10.1109/70.988969) waits until more was drawn than ever put in.

Departures: the energy is that of the torque applied, exact for each hold, where the source multiplies filtered
velocities; one axis instead of two; the damper has a limit. It promises nothing.
"""

from dataclasses import dataclass, field
from typing import Annotated, ClassVar

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
from canhaptic.control.running_sum import RunningSum, add
from canhaptic.kernels import Kernel, new
from canhaptic.units import Parameters, quantity


class AdaptiveReferenceParameters(PassivityObserverParameters):
    """Limits of the braking force, and the speed from which it acts."""

    least_speed: Annotated[float, quantity("m/s", "rad/s", ge=0.0, le=10.0)] = 0.002
    """Below it the damper is off, as in the source."""


@dataclass(frozen=True, slots=True)
class _AdaptiveReferenceSettings:
    """Constants of a run."""

    observer: ObserverSettings
    least_speed: float  # [m/s or rad/s]


@dataclass(slots=True)
class _AdaptiveReferenceState:
    """State kept from SYNC to SYNC."""

    axis: Axis = field(default_factory=Axis)
    model: SampledModel = field(default_factory=SampledModel)
    observed: RunningSum = field(default_factory=RunningSum)  # sum(h_i) [J]
    coefficient: float = 0.0  # k of E_ref = k x^2 [J/m^2 or J/rad^2]


def settings_of(
    environment: Environment, parameters: AdaptiveReferenceParameters, loop: LoopProperties
) -> _AdaptiveReferenceSettings:
    """Returns what is fixed for a run.

    Raises:
        ParameterError: Nothing bounds the damper.
    """
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
    """Accounts for the hold that ended; see `Controller.step`."""
    axis, model = state.axis, state.model
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
    efforts = spring, damper, extra * hold.displacement / hold.elapsed
    account = new(HoldAccount, (branch, h_r, gen, 0.0, leak))
    rendered = environment.damping + extra if contact else 0.0
    return close_hold(settings.observer.hold, axis, memory, hold, account, efforts, rendered, model.state, model.h_s)


def below_reference(state: _AdaptiveReferenceState, observed: float, h_i: float) -> float:
    """Returns the energy observed less its reference [J], 0 while it rises; then the reference is fitted to it.

    Args:
        state: Of the run; its coefficient changes.
        observed: Energy that came in so far [J].
        h_i: In this hold [J].
    """
    square = state.model.true * state.model.true
    if h_i > 0.0:
        if square > 0.0:
            state.coefficient = max(0.0, observed / square)
        return 0.0
    if h_i == 0.0:
        return 0.0
    return min(0.0, observed - state.coefficient * square)


class AdaptiveReference(SteppedController):
    """A passivity controller with an adaptive reference energy around the sampled environment."""

    parameters_type: ClassVar[type[Parameters]] = AdaptiveReferenceParameters
    kernel: ClassVar[Kernel] = Kernel(settings_of, _AdaptiveReferenceState, observer_memory, step)
