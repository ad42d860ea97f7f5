"""`bounded_observer`: a passivity controller whose force stays bounded at rest and never reverses the model's force.

With D the energy drawn beyond the energy put in, the passivity controller adds the force

    (D / T + z) / (v + sign(v) delta),   z <- z + (D / T - (that force) v) / n,

with n a number of holds, and z = 0 while D <= 0. This force is limited to `force_limit`, and the total force is zero
where it would change sign. Without delta, as in Hannaford and Ryu 2002 (doi:10.1109/70.988969), it grows without bound
as the motion comes to rest. The equations are those of `Delta_PO_PC` in `PO_PC_Master_YoubotArm.cpp`, "Teleoperation
System for Mobile Manipulators", Sapientia University, 2015, which was read; no paper about it was found.

Departures: one port instead of the two of a teleoperator; D is the energy of the torque applied and includes the
controller's share, which the source by an oversight keeps at zero; z uses the force of the previous hold; there is no
force without motion, whereas sign(0) of the source is 1. It promises nothing.
"""

from dataclasses import dataclass
from math import copysign, inf
from typing import Annotated, Any

from canhaptic.control.balance import add
from canhaptic.control.damping import DamperVelocity
from canhaptic.control.environments import Environment
from canhaptic.control.passivity import LoopProperties, unprotected
from canhaptic.control.passivity.passivity_observer import ObserverState
from canhaptic.control.passivity.stepped import Hold, SteppedController
from canhaptic.control.passivity.unprotected import Asked, Reply, SampledRun
from canhaptic.kernels import new
from canhaptic.units import quantity


class BoundedObserverParameters(DamperVelocity):
    """Bounds of the passivity controller; the defaults come from the source."""

    speed_offset: Annotated[float, quantity("m/s", "rad/s", gt=0.0, le=10.0)] = 0.01
    """Speed delta, which keeps the force bounded as the motion comes to rest."""
    integral_holds: Annotated[float, quantity("count", ge=1.0, le=1e6)] = 10.0
    """Number n of holds over which z, the part of the force for energy not yet dissipated, is built up."""
    force_limit: Annotated[float, quantity("N", "N*m", gt=0.0, le=1e6)] | None = None
    """Largest force of the passivity controller; None: only the drive's limit applies."""


@dataclass(slots=True)
class _BoundedObserverState(ObserverState):
    """State kept from SYNC to SYNC."""

    integral: float = 0.0  # z [W]
    force: float = 0.0  # of the passivity controller, in the last command [N or N*m]


def settings_of(
    environment: Environment, parameters: BoundedObserverParameters, loop: LoopProperties
) -> unprotected.SampledSettings[Any]:
    """Return the constants of a run; their limit is the largest force of the passivity controller [N or N*m]."""
    limit = inf if parameters.force_limit is None else parameters.force_limit
    return unprotected.sampled_settings(environment, parameters, loop, limit)


def respond(run: SampledRun[BoundedObserverParameters, _BoundedObserverState], hold: Hold, asked: Asked) -> Reply:
    """Add the force of the passivity controller to the next command."""
    state, velocity, damping = run.state, hold.displacement / hold.elapsed, asked.damping
    observed, wanted = add(state.observed, hold.h_i), asked.spring + asked.damper
    state.force = force = controlling_force(run.settings, state, observed, hold, wanted) if asked.touches else 0.0
    if velocity * force > 0.0:
        damping += force / velocity
    return new(Reply, (1.0, asked.spring, asked.damper, force, damping))


def controlling_force(
    settings: unprotected.SampledSettings[BoundedObserverParameters],
    state: _BoundedObserverState,
    observed: float,
    hold: Hold,
    wanted: float,
) -> float:
    """Return the force of the passivity controller in the next command [N or N*m].

    Args:
        settings: Constants of the run.
        state: State of the axis; its integral is updated.
        observed: Energy received so far [J].
        hold: The hold that ended.
        wanted: Force of the model in the next command [N or N*m].
    """
    given, limit, force = settings.given, settings.limit, 0.0
    if observed < 0.0:
        velocity, power = hold.displacement / hold.elapsed, -observed / hold.elapsed
        if velocity != 0.0:
            force = (power + state.integral) / (velocity + copysign(given.speed_offset, velocity))
        state.integral += (power - state.force * velocity) / given.integral_holds
    else:
        state.integral = 0.0
    force = min(max(force, -limit), limit)
    return force if (wanted + force) * wanted > 0.0 else -wanted


class BoundedObserver(SteppedController):
    """Time-domain passivity control with bounded force around the sampled environment."""

    parameters_type = BoundedObserverParameters
    kernel = unprotected.sampled_kernel(respond, _BoundedObserverState, settings_of)
