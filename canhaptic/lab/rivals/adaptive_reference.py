"""`adaptive_reference`: a passivity controller that follows its own reference energy.

The received energy E is compared with E_ref = k x^2, with x the depth in the environment. While E rises, k is fitted to
it, k = max(0, E / x^2); while E falls, a damper recovers its shortfall below E_ref. So the damper acts early and
gently, whereas the observer of Hannaford and Ryu (doi:10.1109/70.988969) waits until more energy was drawn than was
ever put in. The equations are those of the public implementation `AdaptivTDPA.cpp` of
github.com/nafi3rad/PassivityControlOfHapticRobot, which was read; no paper about it was found.

Departures: the energy is that of the torque applied, exact for each hold, whereas the source multiplies filtered
velocities; one axis instead of two; the damper has a limit. It promises nothing.
"""

from dataclasses import dataclass
from functools import partial
from typing import Annotated

from canhaptic.control.balance import add
from canhaptic.control.passivity import passivity_observer
from canhaptic.control.passivity.passivity_observer import controlling_damping, observer_settings
from canhaptic.control.passivity.stepped import Hold, SteppedController
from canhaptic.control.passivity.unprotected import Asked, Reply, SampledRun, sampled_kernel
from canhaptic.kernels import new
from canhaptic.units import quantity


class AdaptiveReferenceParameters(passivity_observer.PassivityObserverParameters):
    """Limits of the controller's damping, and the speed above which it acts."""

    least_speed: Annotated[float, quantity("m/s", "rad/s", ge=0.0, le=10.0)] = 0.002
    """Speed below which the damper is off; the default is that of the source."""


@dataclass(slots=True)
class _AdaptiveReferenceState(passivity_observer.ObserverState):
    """State kept from SYNC to SYNC."""

    coefficient: float = 0.0  # k of E_ref = k x^2 [J/m^2 or J/rad^2]


def respond(run: SampledRun[AdaptiveReferenceParameters, _AdaptiveReferenceState], hold: Hold, asked: Asked) -> Reply:
    """Add damping to the next command while the observed energy is below its reference and the axis moves."""
    state, settings, extra = run.state, run.settings, 0.0
    below = below_reference(state, add(state.observed, hold.h_i), hold.h_i)
    if asked.touches and abs(hold.velocity) > settings.given.least_speed:
        extra = controlling_damping(settings.limit, below, hold)
    effort = extra * hold.displacement / hold.elapsed
    return new(Reply, (1.0, asked.spring, asked.damper, effort, asked.damping + extra))


def below_reference(state: _AdaptiveReferenceState, observed: float, h_i: float) -> float:
    """Return the observed energy minus its reference [J]; while the energy rises, fit the reference and return 0.

    Args:
        state: State of the axis; its coefficient is updated.
        observed: Energy received so far [J].
        h_i: Energy received in this hold [J].
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

    parameters_type = AdaptiveReferenceParameters
    kernel = sampled_kernel(respond, _AdaptiveReferenceState, partial(observer_settings, "adaptive_reference"))
