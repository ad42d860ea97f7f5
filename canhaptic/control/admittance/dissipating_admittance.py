"""`internal_dissipation` of an admittance display: the paper's algorithm with the port energy u J and the state m u.

Here u is the velocity held and J the impulse of the force: the energy that flows in is u J, and the damper takes
T b u u+. The next speed is the root of

    m u+^2 / 2 + T b u u+ - [m u^2 / 2 + u J - (U(x+) - U(x))] = 0

that keeps the sign. From rest the mass starts with J / m, which creates J^2 / 2m. If there is no root, more energy left
than was stored: the mass stops, and the shortfall is a deficit. A perfect drive is assumed, so that the algorithm
bounds the energy created by sampling, but not the energy created by the drive.
"""

from math import sqrt

from canhaptic.control.admittance.admittance_environment import AdmittanceMass
from canhaptic.control.admittance.port import AdmittanceProperties
from canhaptic.control.admittance.unprotected_admittance import NothingToChoose, SampledHold, UnprotectedAdmittance
from canhaptic.errors import ParameterError


def next_speed(environment: AdmittanceMass, time: float, speed: float, impulse: float, risen: float) -> float:
    """Return the next speed by the energy balance, without a reversal [m/s or rad/s]; 0 without a solution.

    Args:
        environment: Virtual mass and damper.
        time: T [s].
        speed: Speed of the hold that ended, not 0 [m/s or rad/s].
        impulse: J, the impulse of the force in it [N*s or N*m*s].
        risen: Increase of the potential in it [J].
    """
    share = time * environment.damping / environment.mass
    square = (1.0 + share * share) * speed * speed + 2.0 * (speed * impulse - risen) / environment.mass
    if square <= 0.0:
        return 0.0
    root = sqrt(square)
    found = -share * speed + (root if speed > 0.0 else -root)
    return found if found * speed > 0.0 else 0.0


class DissipatingAdmittance(UnprotectedAdmittance):
    """The paper's energy balance with force in and velocity out."""

    _environment: AdmittanceMass

    def __init__(
        self, environment: AdmittanceMass, parameters: NothingToChoose, properties: AdmittanceProperties
    ) -> None:
        if not isinstance(environment, AdmittanceMass):
            raise ParameterError(
                f"internal_dissipation: got {type(environment).__name__}, expected environment: virtual_mass; "
                "the balance is solved for a virtual mass only; use the algorithm `guarded`"
            )
        super().__init__(environment, parameters, properties)

    def first_energy(self, position: float) -> float:
        """Return the potential at the first position [J]."""
        return self._environment.potential(position)

    def respond(self, hold: SampledHold) -> tuple[float, float, float]:
        """Solve the energy balance for the next speed."""
        environment, time, position = self._environment, self._time, self._axis.position
        impulse, potential = hold.force * time, environment.potential(position)
        risen, self._energy = potential - self._energy, potential
        if hold.before == 0.0:
            return (impulse + time * environment.pull(position)) / environment.mass, 0.0, 0.0
        return next_speed(environment, time, hold.before, impulse, risen), 0.0, 0.0
