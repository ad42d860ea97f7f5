"""A controller of an admittance display in the cycle; see `canhaptic.control.passivity.stepped`.

It has the interface of an impedance display: `torque_applied` is the force of the display on the hand (minus the
sensor's reading), and the `torque` of its balance is the commanded velocity [m/s or rad/s].
"""

from typing import ClassVar

from canhaptic.control.admittance.admittance_environment import AdmittanceAxis, AdmittanceEnvironment
from canhaptic.control.admittance.port import AdmittanceProperties
from canhaptic.control.balance import AT_REST, EnergyBalance
from canhaptic.control.environments.environment import plain
from canhaptic.control.passivity.stepped import SteppedController, Wording
from canhaptic.units import Parameters


class AdmittanceController(SteppedController):
    """An admittance algorithm on one axis; `_account` is its own."""

    _environment: AdmittanceEnvironment
    _display: AdmittanceAxis
    wording: ClassVar[Wording] = Wording(
        "applied force", "velocity", "encoder, force sensor and their scaling", "mass and damping against the forces"
    )

    def __init__(
        self, environment: AdmittanceEnvironment, parameters: Parameters, properties: AdmittanceProperties
    ) -> None:
        """Prepare a run; `parameters` is of `parameters_type`.

        Raises:
            ParameterError: A property that the algorithm needs is unknown.
        """
        self._environment, self._given = plain(environment), plain(parameters)
        self._properties, self._time = properties, properties.sample_time
        self.reset()

    def reset(self) -> None:
        """Clear the state: no energy, no queued command, no last position."""
        self._display = self._begun()
        self._axis, self._commands = self._display.port, self._display.commands
        self._inner = [0.0] * self._environment.states
        self._memory, self._last, self._advance = None, AT_REST, self._account

    def _begun(self) -> AdmittanceAxis:
        """Return the axis at rest."""
        return AdmittanceAxis(self._environment, self._properties, self._properties.delay + 1)

    def _account(self, position: float, torque_applied: float) -> EnergyBalance:
        """Account for the hold that ended; see `Controller.step`. `torque_applied` is minus the force of the sensor."""
        raise NotImplementedError

    @property
    def energy_resolution(self) -> float:
        """Uncertainty of the sum of h_i [J]; the account books its lower end."""
        return 2.0 * self._display.port.doubt
