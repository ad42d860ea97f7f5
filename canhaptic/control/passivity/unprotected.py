"""`unprotected`: the sampled environment without protection, as most haptic loops run it; sampling creates energy."""

from canhaptic.control.damping import DamperVelocity
from canhaptic.control.passivity.hold_account import Hold
from canhaptic.control.passivity.sampled_model import Asked, Reply, SampledRun, SampledState, sampled_kernel
from canhaptic.control.passivity.stepped import SteppedController
from canhaptic.kernels import new


class UnprotectedParameters(DamperVelocity):
    """Parameters of `unprotected`: the velocity of its damper."""


def respond(run: SampledRun[UnprotectedParameters, SampledState], hold: Hold, asked: Asked) -> Reply:
    """Render the model directly: torque = -effort(x) - d v with x and v straight from the position."""
    return new(Reply, (1.0, asked.spring, asked.damper, 0.0, asked.damping))


class Unprotected(SteppedController):
    """torque = -effort(x) - d v."""

    parameters_type = UnprotectedParameters
    kernel = sampled_kernel(respond)
