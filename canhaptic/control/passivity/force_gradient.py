"""`force_gradient`: the force follows the change of the model's force, not its value.

While the motion goes deeper the force changes by what the model's force changes by; while it goes back it falls by that
size; it never changes sign and is zero where the model's is. On it acts a passivity controller, and what this added or
took stays in the force, so that the next sample has no jump back (equations of `OBGImpedancePOPC_NonVMS`, "observer
based gradient controller", in `KTBioLabLib.cpp` of the Biorobotics Laboratory of KOREATECH, version 0.1, which was
read; the passivity controller is that of Hannaford and Ryu 2002, doi:10.1109/70.988969).

Departures: the port is that of the environment, so that the error of position is the depth in it; the force before is
that of the last sample, where the source forgets to keep it; the passivity controller is a damper of bounded size for
the next hold, where the source changes the force of this one without bound. It promises nothing.
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


class ForceGradientParameters(PassivityObserverParameters):
    """Limits of the passivity controller, and the force below which none is rendered."""

    least_force: Annotated[float, quantity("N", "N*m", ge=0.0, le=1e3)] = 0.001
    """Force of the model below which none is rendered; as in the source."""


@dataclass(frozen=True, slots=True)
class _ForceGradientSettings:
    """Constants of a run."""

    observer: ObserverSettings
    least_force: float  # [N or N*m]


@dataclass(slots=True)
class _ForceGradientState:
    """State kept from SYNC to SYNC."""

    axis: Axis = field(default_factory=Axis)
    model: SampledModel = field(default_factory=SampledModel)
    observed: RunningSum = field(default_factory=RunningSum)  # sum(h_i) [J]
    wanted: float = 0.0  # force of the model in the last command [N or N*m]
    force: float = 0.0  # of the last command [N or N*m]
    depth: float = 0.0  # state of the model then, signed [m or rad]


def settings_of(
    environment: Environment, parameters: ForceGradientParameters, loop: LoopProperties
) -> _ForceGradientSettings:
    """Returns what is fixed for a run.

    Raises:
        ParameterError: Nothing bounds the damper.
    """
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
    """Accounts for the hold that ended; see `Controller.step`."""
    axis, model = state.axis, state.model
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
    efforts = spring * share, damper * share, extra * hold.displacement / hold.elapsed
    state.wanted, state.force, state.depth = wanted, force + efforts[2], model.true
    account = new(HoldAccount, (branch, h_r, gen, 0.0, leak))
    rendered = environment.damping * share + extra if contact else 0.0
    return close_hold(settings.observer.hold, axis, memory, hold, account, efforts, rendered, model.state, model.h_s)


def gradient_force(least_force: float, state: _ForceGradientState, wanted: float, depth: float) -> float:
    """Returns the force of the next command without the passivity controller [N or N*m].

    Args:
        least_force: Below it there is none [N or N*m].
        state: Force, force of the model and depth of the last command.
        wanted: Force of the model now [N or N*m].
        depth: State of the model now, of the sign of its force [m or rad].
    """
    if abs(wanted) <= least_force:
        return 0.0
    side = 1.0 if wanted > 0.0 else -1.0
    change = side * (wanted - state.wanted)
    if side * (depth - state.depth) < 0.0:
        change = -abs(abs(wanted) - abs(state.wanted))
    return side * max(0.0, side * state.force + change)


class ForceGradient(SteppedController):
    """The sampled environment by changes of its force, with a passivity controller."""

    parameters_type: ClassVar[type[Parameters]] = ForceGradientParameters
    kernel: ClassVar[Kernel] = Kernel(settings_of, _ForceGradientState, observer_memory, step)
