"""`force_gradient`: the force follows the change of the model's force, not its value.

While the motion goes deeper, the force changes by as much as the model's force; while it goes back, the force falls by
the size of that change. It never changes sign, and is zero where the model's force is zero. A passivity controller adds
its force, which stays in the total force, so that the next sample does not jump back. The equations are those of
`OBGImpedancePOPC_NonVMS` ("observer based gradient controller") in `KTBioLabLib.cpp` of the Biorobotics Laboratory of
KOREATECH, version 0.1, which was read; the passivity controller is that of Hannaford and Ryu 2002,
doi:10.1109/70.988969.

Departures: the port is that of the environment, so that the position error is the depth in it; the previous force is
that of the last sample, which the source fails to store; the passivity controller is a damper of bounded size for the
next hold, whereas the source changes the force of this hold without bound. It promises nothing.
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


class ForceGradientParameters(passivity_observer.PassivityObserverParameters):
    """Limits of the passivity controller, and the model's force below which no force is rendered."""

    least_force: Annotated[float, quantity("N", "N*m", ge=0.0, le=1e3)] = 0.001
    """Force of the model below which no force is rendered; the default is that of the source."""


@dataclass(slots=True)
class _ForceGradientState(passivity_observer.ObserverState):
    """State kept from SYNC to SYNC."""

    wanted: float = 0.0  # force of the model in the last command [N or N*m]
    force: float = 0.0  # of the last command [N or N*m]
    depth: float = 0.0  # state of the model then, signed [m or rad]


def respond(run: SampledRun[ForceGradientParameters, _ForceGradientState], hold: Hold, asked: Asked) -> Reply:
    """Send the last force plus the change of the model's force, and the damping of the passivity controller."""
    state, settings, wanted = run.state, run.settings, asked.spring + asked.damper
    observed, depth = add(state.observed, hold.h_i), state.model.true
    force = gradient_force(settings.given.least_force, state, wanted, depth)
    share = force / wanted if force != 0.0 else 0.0
    extra = controlling_damping(settings.limit, observed, hold) if asked.touches else 0.0
    effort = extra * hold.displacement / hold.elapsed
    state.wanted, state.force, state.depth = wanted, force + effort, depth
    return new(Reply, (1.0, asked.spring * share, asked.damper * share, effort, asked.damping * share + extra))


def gradient_force(least_force: float, state: _ForceGradientState, wanted: float, depth: float) -> float:
    """Return the next force by the force-gradient rule, before the passivity controller adds damping [N or N*m].

    Args:
        least_force: Model force below which no force is rendered [N or N*m].
        state: Force, model force and depth of the last command.
        wanted: Present force of the model [N or N*m].
        depth: Present penetration, with the sign of the model force [m or rad].
    """
    if abs(wanted) <= least_force:
        return 0.0
    side = 1.0 if wanted > 0.0 else -1.0
    change = side * (wanted - state.wanted)
    if side * (depth - state.depth) < 0.0:
        change = -abs(abs(wanted) - abs(state.wanted))
    return side * max(0.0, side * state.force + change)


class ForceGradient(SteppedController):
    """Controller that renders the environment by changes of its force, with a passivity controller."""

    parameters_type = ForceGradientParameters
    kernel = sampled_kernel(respond, _ForceGradientState, partial(observer_settings, "force_gradient"))
