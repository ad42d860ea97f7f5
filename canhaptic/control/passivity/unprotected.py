"""`unprotected`: the sampled environment without protection, as most haptic loops run it: what sampling creates."""

from typing import ClassVar

from canhaptic.control.passivity.hold_account import Hold
from canhaptic.control.passivity.sampled_kernel import Reply, SampledRun, SampledState, sampled_kernel
from canhaptic.control.passivity.sampled_model import Asked
from canhaptic.control.passivity.stepped import SteppedController
from canhaptic.control.velocity import DamperVelocity
from canhaptic.kernels import Kernel, new
from canhaptic.units import Parameters


class UnprotectedParameters(DamperVelocity):
    """Nothing to choose but the velocity of the damper."""


def respond(run: SampledRun[UnprotectedParameters, SampledState], hold: Hold, asked: Asked) -> Reply:
    """Renders what the model asks for: torque = -effort(x) - d v with x and v straight from the position."""
    return new(Reply, (1.0, asked.spring, asked.damper, 0.0, asked.damping))


class Unprotected(SteppedController):
    """torque = -effort(x) - d v."""

    parameters_type: ClassVar[type[Parameters]] = UnprotectedParameters
    kernel: ClassVar[Kernel] = sampled_kernel(respond)
