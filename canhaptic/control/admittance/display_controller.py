"""A controller of an admittance display in the cycle; see `canhaptic.control.passivity.stepped`.

It is stepped as one of an impedance display: `torque_applied` is the force of the display on the hand (minus what the
sensor shows), and the `torque` of its balance is the velocity commanded [m/s or rad/s].
"""

from math import isfinite
from typing import Any

from canhaptic.control.admittance.display_mass import DisplayMass
from canhaptic.control.admittance.properties import DisplayProperties
from canhaptic.control.balance import Branch, EnergyBalance
from canhaptic.control.passivity.stepped import SteppedController
from canhaptic.errors import ControlError

_HELD = Branch.HELD.value


class DisplayController(SteppedController):
    """A kernel with the state of one axis."""

    def __init__(self, environment: DisplayMass, parameters: Any, loop: DisplayProperties) -> None:
        """Prepares a run; `parameters` is of `parameters_type`.

        Raises:
            ParameterError: The algorithm cannot do without something that is not known.
        """
        self._environment: Any = environment
        self._settings = self.kernel.settings(environment, parameters, loop)
        self._step = self.kernel.step
        self.reset()

    @property
    def energy_resolution(self) -> float:
        """Sum of what was unsure in the energy, which the account has taken off [J]."""
        doubt: float = self._axis.doubt
        return doubt

    def hold(self) -> EnergyBalance:
        """Answers a SYNC whose sample was lost; nothing is booked."""
        speed = self._command_unseen() if self._axis.started else 0.0
        return self._last._replace(
            torque=speed, branch=_HELD, h_i=0.0, h_pas=0.0, h_m=0.0, h_r=0.0, gen=0.0, deficit=0.0, leak=0.0, paid=0.0
        )

    def lasted(self, periods: float) -> None:
        """Counts the SYNCs that were skipped as samples that were lost; a run with one is not certified."""
        if self._axis.started:
            for _ in range(round(periods) - 1):
                self._command_unseen()

    def _command_unseen(self) -> float:
        """Returns the command of a SYNC without a sample [m/s or rad/s]: 0, unless an algorithm can do better."""
        self._axis.missed += 1
        return 0.0

    def step(self, position: float, torque_applied: float) -> EnergyBalance:
        """Accounts for the hold that ended; see `Controller.step`."""
        if not isfinite(position - self._axis.position + torque_applied):
            self.reset()
            raise ControlError(
                f"controller: got position {position!r} and force {-torque_applied!r}, expected finite numbers; the "
                "velocity is zero and the controller is to be reset, check encoder, force sensor and their scaling"
            )
        balance: EnergyBalance = self._step(
            self._environment, self._settings, self._state, self._memory, position, torque_applied
        )
        if not isfinite(balance[0]):
            self.reset()
            raise ControlError(
                f"controller: computed velocity {balance.torque!r}, expected a finite number; the velocity is zero and "
                "the controller is to be reset, check mass and damping against the forces"
            )
        self._last = balance
        return balance
