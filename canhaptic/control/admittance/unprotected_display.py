"""`unprotected` of an admittance display: the virtual mass without protection."""

from canhaptic.control.admittance.display_controller import DisplayController
from canhaptic.control.admittance.display_environment import DisplayEnvironment
from canhaptic.control.admittance.sampled_mass import (
    DisplayReply,
    DisplayRun,
    NothingToChoose,
    SampledHold,
    display_kernel,
)
from canhaptic.kernels import new


def respond(environment: DisplayEnvironment, run: DisplayRun[NothingToChoose], hold: SampledHold) -> DisplayReply:
    """Advance the virtual mass under the last force."""
    return new(DisplayReply, (hold.wish, 0.0, 0.0))


class UnprotectedDisplay(DisplayController):
    """The virtual mass without protection."""

    parameters_type = NothingToChoose
    kernel = display_kernel(respond)
