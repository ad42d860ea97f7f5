"""`passivity_observer` of an admittance display: a series slip whenever the observed energy falls below zero.

The observer counts F u T, force times velocity commanded, as if the drive tracked perfectly: its known weakness.
The controller adds C F to the command, with C = -E / (F^2 T), so that the observed energy is zero after the hold.
Hannaford and Ryu, IEEE Trans. Robotics and Automation 18, 2002, in the form for a velocity output.
"""

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
    """Observe the energy of the command and add the slip that it lacks."""
    state, force, slip = run.state, hold.force, 0.0
    h_pas = force * state.slip * hold.elapsed
    state.energy += force * (hold.before + state.slip) * hold.elapsed
    if state.energy < 0.0 and force != 0.0:
        slip = -state.energy / (force * run.settings.port.sample_time)
    return new(AdmittanceReply, (hold.request, slip, h_pas))


class ObservedAdmittance(AdmittanceController):
    """A virtual mass with observer and series slip."""

    parameters_type = NothingToChoose
    kernel = display_kernel(respond)
