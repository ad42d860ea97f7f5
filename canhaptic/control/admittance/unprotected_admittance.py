"""`unprotected` of an admittance display: the virtual mass without protection."""

from canhaptic.control.admittance.admittance_controller import AdmittanceController
from canhaptic.control.admittance.admittance_environment import AdmittanceEnvironment
from canhaptic.control.admittance.sampled_mass import (
    AdmittanceReply,
    AdmittanceRun,
    NothingToChoose,
    SampledHold,
    display_kernel,
)
from canhaptic.kernels import new


def respond(
    environment: AdmittanceEnvironment, run: AdmittanceRun[NothingToChoose], hold: SampledHold
) -> AdmittanceReply:
    """Advance the virtual mass under the last force."""
    return new(AdmittanceReply, (hold.request, 0.0, 0.0))


class UnprotectedAdmittance(AdmittanceController):
    """The virtual mass without protection."""

    parameters_type = NothingToChoose
    kernel = display_kernel(respond)
