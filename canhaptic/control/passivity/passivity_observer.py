"""`passivity_observer`: passivity observer and controller (PO/PC) of ref. [9] in exact sampled form.

The observer sums the interaction energy (eq. 2), which is exact for a held torque and needs no velocity estimate.
While the sum is negative, so that more energy came out than went in, the passivity controller adds a damper that
recovers the shortfall if the next displacement equals the last. It enforces eq. 3, but not the dissipation of the model
(eq. 4): as sec. II of the paper says, a spring and damper that creates energy may feel like a spring alone before the
controller acts.
"""

from dataclasses import dataclass, field
from functools import partial
from typing import Annotated, Any

from canhaptic.control.balance import RunningSum, add
from canhaptic.control.damping import DamperVelocity, damping_cap
from canhaptic.control.environments import Environment
from canhaptic.control.passivity import LoopProperties, unprotected
from canhaptic.control.passivity.stepped import Hold, SteppedController
from canhaptic.control.passivity.unprotected import Asked, Reply
from canhaptic.errors import ParameterError
from canhaptic.kernels import new
from canhaptic.units import quantity


class PassivityObserverParameters(DamperVelocity):
    """Velocity estimate of the model's damper, and largest damping of the passivity controller."""

    damping_limit: Annotated[float, quantity("N*s/m", "N*m*s/rad", gt=0.0)] | None = None
    """Largest damping of the passivity controller. None: the cap by moving mass, delay and sample time. One of the two
    must be known, because the damping that recovers the shortfall grows without bound as the motion comes to rest."""


@dataclass(slots=True)
class ObserverState(unprotected.SampledState):
    """State of the sampled environment and the observer, kept from SYNC to SYNC."""

    observed: RunningSum = field(default_factory=RunningSum)  # sum(h_i) [J]


def observer_settings(
    algorithm: str, environment: Environment, parameters: PassivityObserverParameters, loop: LoopProperties
) -> unprotected.SampledSettings[Any]:
    """Return the constants of an algorithm with a passivity controller, the limit of its damping included.

    Raises:
        ParameterError: Neither `damping_limit` nor the moving mass is known.
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
    return unprotected.sampled_settings(environment, parameters, loop, limit)


def respond(run: unprotected.SampledRun[PassivityObserverParameters, ObserverState], hold: Hold, asked: Asked) -> Reply:
    """Return the model's efforts, with a damper added while more energy came out than went in."""
    observed = add(run.state.observed, hold.h_i)
    extra = controlling_damping(run.settings.limit, observed, hold) if asked.touches else 0.0
    effort = extra * hold.displacement / hold.elapsed
    return new(Reply, (1.0, asked.spring, asked.damper, effort, asked.damping + extra))


def controlling_damping(limit: float, missing: float, hold: Hold) -> float:
    """Return the damping [N*s/m or N*m*s/rad] that recovers a negative energy sum in one more hold like the last."""
    displacement = hold.displacement
    if missing >= 0.0 or displacement == 0.0:
        return 0.0
    return min(limit, -missing * hold.elapsed / displacement / displacement)


class PassivityObserver(SteppedController):
    """Controller that adds time-domain passivity control to the sampled environment."""

    parameters_type = PassivityObserverParameters
    kernel = unprotected.sampled_kernel(respond, ObserverState, partial(observer_settings, "passivity_observer"))
