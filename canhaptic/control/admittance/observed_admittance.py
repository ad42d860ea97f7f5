"""`passivity_observer` of an admittance display: a series slip whenever the observed energy falls below zero.

The observer counts F u T, force times velocity commanded, as if the drive tracked perfectly: its known weakness.
The controller adds C F to the command, with C = -E / (F^2 T), so that the observed energy is zero after the hold.
Hannaford and Ryu, IEEE Trans. Robotics and Automation 18, 2002, in the form for a velocity output.
"""

from canhaptic.control.admittance.unprotected_admittance import SampledHold, UnprotectedAdmittance


class ObservedAdmittance(UnprotectedAdmittance):
    """A virtual mass with observer and series slip."""

    def respond(self, hold: SampledHold) -> tuple[float, float, float]:
        """Observe the energy of the command and add the slip that it lacks."""
        force, slip = hold.force, 0.0
        h_pas = force * self._slip * hold.elapsed
        self._energy += force * (hold.before + self._slip) * hold.elapsed
        if self._energy < 0.0 and force != 0.0:
            slip = -self._energy / (force * self._time)
        return hold.request, slip, h_pas
