"""`unprotected`: the sampled environment without protection, as most haptic loops run it: what sampling creates."""

from canhaptic.control.damping import DamperVelocity
from canhaptic.control.passivity.hold_account import Hold
from canhaptic.control.passivity.sampled_model import Asked, Reply, SampledRun, SampledState, sampled_kernel
from canhaptic.control.passivity.stepped import SteppedController
from canhaptic.kernels import new


class UnprotectedParameters(DamperVelocity):
    """Nothing to choose but the velocity of the damper."""


def respond(run: SampledRun[UnprotectedParameters, SampledState], hold: Hold, asked: Asked) -> Reply:
    """Render what the model asks for: torque = -effort(x) - d v with x and v straight from the position."""
    return new(Reply, (1.0, asked.spring, asked.damper, 0.0, asked.damping))


class Unprotected(SteppedController):
    """torque = -effort(x) - d v."""

    parameters_type = UnprotectedParameters
    kernel = sampled_kernel(respond)
