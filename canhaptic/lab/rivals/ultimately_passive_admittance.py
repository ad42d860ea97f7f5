"""`ultimately_passive` of an admittance display: created energy is dissipated gradually, as by eq. 19 of the paper.

Energy that the hold created goes into a surplus H. A series slip u_pas = C F with C = alpha H takes F u_pas T of it in
each hold, so that the sum becomes passive in the end, not at each instant. C is capped by the
stability of the slip against the stiffest hand declared (C K T <= 0.5).
"""

from typing import Annotated

from canhaptic.control.admittance.admittance_controller import AdmittanceController
from canhaptic.control.admittance.admittance_environment import AdmittanceEnvironment
from canhaptic.control.admittance.sampled_mass import AdmittanceReply, AdmittanceRun, SampledHold, display_kernel
from canhaptic.kernels import new
from canhaptic.units import Parameters, quantity

_STABLE = 0.5
"""Largest C K T of a series slip against a spring, with a whole hold of delay to spare."""


class UltimatelyPassiveAdmittanceParameters(Parameters):
    """Parameters of an admittance display: how fast the surplus is dissipated."""

    alpha: Annotated[float, quantity("m/N/s/J", "rad/N/m/s/J", ge=0.0, le=1e6)] = 1.0
    """Slip per force and per joule of surplus."""
    hand_stiffness: Annotated[float, quantity("N/m", "N*m/rad", gt=0.0, le=1e8)] = 5000.0
    """Stiffest hand, an over-estimate: bounds the slip."""


def respond(
    environment: AdmittanceEnvironment, run: AdmittanceRun[UltimatelyPassiveAdmittanceParameters], hold: SampledHold
) -> AdmittanceReply:
    """Dissipate part of the surplus."""
    state, given = run.state, run.settings.given
    h_pas = hold.force * state.slip * hold.elapsed
    state.energy = max(0.0, max(0.0, state.energy + state.created) - h_pas)
    most = _STABLE / (given.hand_stiffness * run.settings.port.sample_time)
    return new(AdmittanceReply, (hold.request, min(given.alpha * state.energy, most) * hold.force, h_pas))


class UltimatelyPassiveAdmittance(AdmittanceController):
    """A virtual mass whose surplus is dissipated gradually."""

    parameters_type = UltimatelyPassiveAdmittanceParameters
    kernel = display_kernel(respond)
