"""`ultimately_passive` of an admittance display: generated energy is dissipated gradually, as in eq. 19 of the paper.

Energy that a hold generates is added to a surplus H. A series slip u_pas = C F with C = alpha H dissipates F u_pas T of
it in each hold, so that the sum becomes passive in the end, not at each instant. C is limited by the stability of the
slip against the stiffest declared hand (C K T <= 0.5).
"""

from typing import Annotated

from canhaptic.control.admittance.admittance_controller import Vector
from canhaptic.control.admittance.unprotected_admittance import UnprotectedAdmittance
from canhaptic.units import Parameters, quantity


class UltimatelyPassiveAdmittanceParameters(Parameters):
    """Parameters of `ultimately_passive`: how fast generated energy is dissipated."""

    alpha: Annotated[float, quantity("m/N/s/J", "rad/N/m/s/J", ge=0.0, le=1e6)] = 1.0
    """Slip (added velocity) per force and per joule of generated energy."""
    hand_stiffness: Annotated[float, quantity("N/m", "N*m/rad", gt=0.0, le=1e8)] = 5000.0
    """Upper bound of the hand's stiffness, which limits the slip."""


class UltimatelyPassiveAdmittance(UnprotectedAdmittance):
    """Controller of a virtual mass that dissipates generated energy gradually, from one sum for all axes."""

    parameters_type = UltimatelyPassiveAdmittanceParameters
    _given: UltimatelyPassiveAdmittanceParameters

    def _observe(self, energy: float, dissipated: float) -> None:
        self._energy = max(0.0, max(0.0, self._energy + self._created) - dissipated)

    def _protected(self, request: Vector, forces: Vector) -> tuple[Vector, Vector]:
        part = min(self._given.alpha * self._energy, 0.5 / (self._given.hand_stiffness * self._time))
        return request, [part * force for force in forces]
