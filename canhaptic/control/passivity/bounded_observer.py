"""`bounded_observer`: a passivity controller whose force stays bounded at rest and never turns the model's force round.

With D what was drawn beyond what was put in, the passivity controller adds the force

    (D / T + z) / (v + sign(v) delta),   z <- z + (D / T - (that force) v) / n,

n a number of holds, z = 0 while D <= 0; it is cut at `force_limit`, and the whole force is zero where it would change
sign (the equations of `Delta_PO_PC` in `PO_PC_Master_YoubotArm.cpp`, "Teleoperation System for Mobile Manipulators",
Sapientia University, 2015, which was read; no paper of it was found). Without delta, as in Hannaford and Ryu 2002
(doi:10.1109/70.988969), it grows without bound as the motion comes to rest.

Departures: one port instead of the two of a teleoperator; D is that of the torque applied, the controller's share
included, where the source keeps that share at zero by an oversight; z counts the force of the hold before;
there is no force without motion, where sign(0) of the source is 1. It promises nothing.
"""

from dataclasses import dataclass, field
from math import copysign, inf
from typing import Annotated, ClassVar

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
from canhaptic.control.running_sum import RunningSum, add
from canhaptic.control.velocity import DamperVelocity
from canhaptic.kernels import Kernel, new
from canhaptic.units import Parameters, quantity


class BoundedObserverParameters(DamperVelocity):
    """Bounds of the passivity controller; the defaults are those of the source."""

    speed_offset: Annotated[float, quantity("m/s", "rad/s", gt=0.0, le=10.0)] = 0.01
    """delta: keeps the force bounded where the motion comes to rest."""
    integral_holds: Annotated[float, quantity("count", ge=1.0, le=1e6)] = 10.0
    """n: holds over which what was not won back is added to the force."""
    force_limit: Annotated[float, quantity("N", "N*m", gt=0.0, le=1e6)] | None = None
    """Largest force of the passivity controller; without it only the drive's limit holds."""


@dataclass(frozen=True, slots=True)
class _BoundedObserverSettings:
    """Constants of a run."""

    speed_offset: float  # [m/s or rad/s]
    integral_holds: float
    force_limit: float  # [N or N*m]
    hold: HoldSettings


@dataclass(slots=True)
class _BoundedObserverState:
    """State kept from SYNC to SYNC."""

    axis: Axis = field(default_factory=Axis)
    model: SampledModel = field(default_factory=SampledModel)
    observed: RunningSum = field(default_factory=RunningSum)  # sum(h_i) [J]
    integral: float = 0.0  # z [W]
    force: float = 0.0  # of the passivity controller, in the last command [N or N*m]


def settings_of(
    environment: Environment, parameters: BoundedObserverParameters, loop: LoopProperties
) -> _BoundedObserverSettings:
    """Returns what is fixed for a run."""
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
    """Accounts for the hold that ended; see `Controller.step`."""
    axis, model = state.axis, state.model
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
    """Returns the force of the passivity controller in the next command [N or N*m].

    Args:
        settings: Of the run.
        state: Of the run; its integral changes.
        observed: Energy that came in so far [J].
        hold: That ended.
        wanted: Force of the model in the next command [N or N*m].
    """
    force = 0.0
    if observed < 0.0:
        velocity, power = hold.displacement / hold.elapsed, -observed / hold.elapsed
        if velocity != 0.0:
            force = (power + state.integral) / (velocity + copysign(settings.speed_offset, velocity))
        state.integral += (power - state.force * velocity) / settings.integral_holds
    else:
        state.integral = 0.0
    force = min(max(force, -settings.force_limit), settings.force_limit)
    return force if (wanted + force) * wanted > 0.0 else -wanted


class BoundedObserver(SteppedController):
    """Time-domain passivity control of bounded force around the sampled environment."""

    parameters_type: ClassVar[type[Parameters]] = BoundedObserverParameters
    kernel: ClassVar[Kernel] = Kernel(settings_of, _BoundedObserverState, hold_memory, step)
