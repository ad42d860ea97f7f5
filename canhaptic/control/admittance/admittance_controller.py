"""A controller of an admittance display in the cycle; see `canhaptic.control.passivity.stepped`.

It has the interface of an impedance display: `torque_applied` is the force of the display on the hand (minus the
sensor's reading), and the `torque` of its balance is the commanded velocity [m/s or rad/s].
"""

from typing import ClassVar

from canhaptic.control.admittance.admittance_environment import AdmittanceEnvironment, send
from canhaptic.control.passivity.stepped import SteppedController, Wording


class AdmittanceController(SteppedController):
    """An admittance kernel with the state of one axis."""

    _environment: AdmittanceEnvironment
    wording: ClassVar[Wording] = Wording(
        "applied force", "velocity", "encoder, force sensor and their scaling", "mass and damping against the forces"
    )

    @property
    def energy_resolution(self) -> float:
        """Uncertainty of the sum of h_i [J]; the account books its lower end."""
        doubt: float = self._axis.doubt
        return 2.0 * doubt

    def lasted(self, periods: float) -> None:
        """Count skipped SYNCs as lost samples, during which the command kept acting."""
        state, skipped = self._state, round(periods) - 1
        if self._axis.started:
            self._axis.missed += skipped
            own = state.motion.speed - state.slip
            for _ in range(skipped):
                self._environment.go_along(self._memory.inner, own, own, self._settings.motion.sample_time)

    def _command_unseen(self) -> float:
        """Command for a SYNC without a sample [m/s or rad/s]: 0, unless an algorithm overrides this."""
        state, memory = self._state, self._memory
        before, state.slip = state.motion.speed - state.slip, 0.0
        send(state.motion, memory.commands, 0.0)
        self._environment.go_along(memory.inner, before, 0.0, self._settings.motion.sample_time)
        self._axis.missed += 1
        return 0.0
