"""`passivity_observer` of admittance displays: an added velocity (slip) while the observed energy is below zero.

The observer sums F u T, force times commanded velocity, over all axes, as if the drives tracked perfectly: its known
weakness. The controller adds C F to the commands, with C = -E / (F^2 T), so that the observed energy is zero after the
hold. Hannaford and Ryu, IEEE Trans. Robotics and Automation 18, 2002, in the form for a velocity output.
"""

from canhaptic.control.admittance.admittance_controller import Vector
from canhaptic.control.admittance.unprotected_admittance import UnprotectedAdmittance


class ObservedAdmittance(UnprotectedAdmittance):
    """A virtual mass with passivity observer and added slip."""

    def _observe(self, energy: float, dissipated: float) -> None:
        self._energy += energy

    def _protected(self, request: Vector, forces: Vector) -> tuple[Vector, Vector]:
        square = sum(force * force for force in forces)
        if self._energy >= 0.0 or square == 0.0:
            return request, [0.0] * self.axes
        part = -self._energy / (square * self._time)
        return request, [part * force for force in forces]
