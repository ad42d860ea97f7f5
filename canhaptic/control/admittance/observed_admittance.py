"""`passivity_observer` of an admittance display: an added velocity (slip) while the observed energy is below zero.

The observer sums F u T, force times commanded velocity, as if the drive tracked perfectly: its known weakness.
The controller adds C F to the command, with C = -E / (F^2 T), so that the observed energy is zero after the hold.
Hannaford and Ryu, IEEE Trans. Robotics and Automation 18, 2002, in the form for a velocity output.
"""

from canhaptic.control.admittance.unprotected_admittance import SampledHold, UnprotectedAdmittance


class ObservedAdmittance(UnprotectedAdmittance):
    """A virtual mass with passivity observer and added slip."""

    def respond(self, hold: SampledHold) -> tuple[float, float, float]:
        """Add the energy of the last command to the sum, and return the slip that raises the sum to zero."""
        force, slip = hold.force, 0.0
        h_pas = force * self._slip * hold.elapsed
        self._energy += force * (hold.before + self._slip) * hold.elapsed
        if self._energy < 0.0 and force != 0.0:
            slip = -self._energy / (force * self._time)
        return hold.request, slip, h_pas
